"""What the experiments share: the command line (`--seeds`, `--quick`, `--out`), and results with their environment.

A script looks like this::

    \"\"\"One line that says what is measured (thesis, section).

        python -m experiments.fig_x [--seeds 5] [--seed 0] [--quick] [--out results/fig_x]
    \"\"\"

    def main(argv=None):
        run = common.begin(__doc__, "fig_x", argv, seeds=5, quick_seeds=2)
        values = [measure(seed) for seed in run.seeds]
        run.write_json({"values": values})       # DIR/fig_x.json, with environment, seeds, options and seconds
        figure, axes = common.new_figure(7.2, 3.6)
        axes.plot(values)
        run.write_figure(figure)                 # DIR/fig_x.png

Results that are there already are never overwritten without ``--force``, but for those that a script goes on with.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sapopt.cli.show import environment
from sapopt.data.files import write_figure, write_text
from sapopt.problem.sap import SAP
from sapopt.solvers.base import Solver
from sapopt.warming import warm_up


@dataclass(frozen=True)
class Run:
    """One run of an experiment.

    Attributes
    ----------
    name : str
        Name of the script; its files are called ``name.json`` and ``name.png``.
    options : argparse.Namespace
        All options, also those that the script added.
    seeds : tuple of int
        The seeds to go through: 0, 1, ... unless ``--seed`` names another first one.
    """

    name: str
    options: argparse.Namespace
    seeds: tuple[int, ...]
    began: float = field(default_factory=time.perf_counter)

    @property
    def quick(self) -> bool:
        """Whether a short run was asked for."""
        return bool(self.options.quick)

    @property
    def out(self) -> Path:
        """Folder of the results; it exists."""
        return Path(self.options.out)

    def say(self, text: str) -> None:
        """Print a line with the seconds since the start, at once."""
        print(f"[{time.perf_counter() - self.began:6.1f} s] {text}", flush=True)

    def chosen(self, option: str, names: str, known: Collection[str]) -> list[str]:
        """The names of an option, separated by commas; the script ends with one line at a name that is not known."""
        asked = names.split(",")
        for name in asked:
            if name not in known:
                raise SystemExit(f"{self.name}: --{option}: unknown {name!r}; known: {', '.join(known)}")
        return asked

    def write_json(self, report: dict[str, Any], name: str | None = None) -> Path:
        """Write a report with everything that one needs to get it again.

        Parameters
        ----------
        report : dict
            Plain values, numpy numbers and arrays.
        name : str, optional
            Name of the file without its suffix; the script's if omitted.
        """
        head = {
            "experiment": self.name,
            "command": " ".join(["python", "-m", f"experiments.{self.name}", *sys.argv[1:]]),
            "options": _told(self.options),
            "seeds": list(self.seeds),
            "environment": {**environment(), "cores": os.cpu_count(), "load": list(os.getloadavg())},
            "seconds": round(time.perf_counter() - self.began, 2),
        }
        path = self.out / f"{name or self.name}.json"
        write_text(path, json.dumps(head | report, indent=1, default=_plain) + "\n")
        print(f"wrote {path}")
        return path

    def write_figure(self, figure: Figure, name: str | None = None, dpi: int = 150) -> Path:
        """Write a figure as PNG beside the report."""
        path = self.out / f"{name or self.name}.png"
        write_figure(path, figure, dpi)
        print(f"wrote {path}")
        return path


def add_seeds(parser: argparse.ArgumentParser, count: int = 1, quick_count: int | None = None) -> None:
    """The two options that say which random draws are run: how many, and from which seed on."""
    few = count if quick_count is None else quick_count
    parser.add_argument(
        "--seeds", type=int, metavar="N", help=f"number of seeds (default {count}, quick {few})"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="the first of them (default 0)")
    parser.set_defaults(seed_counts=(count, few))


def seeds_of(parser: argparse.ArgumentParser, options: argparse.Namespace) -> tuple[int, ...]:
    """The seeds that were asked for: S, S + 1, ... (`--seed S --seeds N`)."""
    count, few = options.__dict__.pop("seed_counts")
    if options.seeds is None:
        options.seeds = few if getattr(options, "quick", False) else count
    if options.seeds < 1:
        parser.error(f"--seeds must be at least 1, got {options.seeds}")
    if options.seed < 0:
        parser.error(f"--seed must not be negative, got {options.seed}")
    return tuple(range(options.seed, options.seed + options.seeds))


def begin(
    doc: str | None,
    name: str,
    argv: Sequence[str] | None = None,
    *,
    seeds: int = 1,
    quick_seeds: int | None = None,
    add: Callable[[argparse.ArgumentParser], object] | None = None,
    resumes: bool = False,
) -> Run:
    """Read the command line of an experiment.

    Parameters
    ----------
    doc : str
        The module's docstring; it is the help text.
    name : str
        Name of the script.
    argv : sequence of str, optional
        The arguments; those of the process if omitted.
    seeds, quick_seeds : int
        How many seeds are run unless `--seeds` says otherwise, in full and with `--quick`; `--seed` names the first.
    add : callable, optional
        Adds the script's own options to the parser.
    resumes : bool
        The script goes on where an earlier run ended, so results of the same options, on as many seeds or fewer, need
        not be protected.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_seeds(parser, seeds, quick_seeds)
    parser.add_argument("--quick", action="store_true", help="a short run, under five minutes")
    parser.add_argument("--out", type=Path, default=Path("results") / name, metavar="DIR")
    parser.add_argument("--force", action="store_true", help="overwrite earlier results")
    if add is not None:
        add(parser)
    options = parser.parse_args(argv)
    asked = seeds_of(parser, options)
    earlier = options.out / f"{name}.json"
    if earlier.exists() and not (options.force or (resumes and _is_continued(earlier, options))):
        parser.error(f"{earlier} exists already; give --force to overwrite it, or another --out")
    options.out.mkdir(parents=True, exist_ok=True)
    return Run(name, options, asked)


def _is_continued(report: Path, options: argparse.Namespace) -> bool:
    """Whether a finished report is of the same options, and of no seed that would not be run again."""
    try:
        theirs = json.loads(report.read_text(encoding="utf-8"))["options"]
        fewer = theirs["seed"] == options.seed and theirs["seeds"] <= options.seeds
    except (OSError, ValueError, KeyError, TypeError):
        return False
    ours = json.loads(json.dumps(_told(options)))
    free = ("seed", "seeds", "out", "force")
    return bool(fewer) and all(ours.get(k) == theirs.get(k) for k in ours | theirs if k not in free)


def _told(options: argparse.Namespace) -> dict[str, Any]:
    """Options as a report names them."""
    return {key: str(v) if isinstance(v, Path) else v for key, v in vars(options).items()}


def warm(problem: SAP, solver: Solver) -> None:
    """Compile on the first steps of a problem, so that no time contains it."""
    warm_up(problem, solver)


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, Any]:
    """A figure in inches and its axes, drawn without a window system; `options` are those of ``Figure.subplots``."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, **options)


def mean_and_error(values: Any) -> tuple[float, float]:
    """Mean and its standard error (0 for a single value)."""
    numbers = np.asarray(values, dtype=np.float64)
    error = float(numbers.std(ddof=1) / np.sqrt(len(numbers))) if len(numbers) > 1 else 0.0
    return float(numbers.mean()), error


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} cannot be written to JSON")
