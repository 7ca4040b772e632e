"""The commands that train: ``sapopt train reda``."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from sapopt.cli import show, work
from sapopt.cli.app import EXIT_INTERRUPTED, AsJson, Force, TimeLimit, app, check_time
from sapopt.cli.grouping import grouped
from sapopt.cli.progress import Reporter
from sapopt.running.control import Run
from sapopt.solvers.names import nearest

train_app = typer.Typer(help="Train a learned policy.", no_args_is_help=True)
app.add_typer(train_app, name="train")

_PRE = "Default: the preset's."

GUIDES = ("auto", "myopic", "power_constrained", "energy_price")


@dataclass(frozen=True)
class TrainFlags:
    """Options of `sapopt.learning.TrainOptions`, by their names there; None leaves one to the preset."""

    choose: Annotated[
        Literal["alpha", "self"],
        typer.Option(help="Who chooses: alpha of the values (REDA), or agents (IQL)."),
    ] = "alpha"
    episodes: Annotated[int | None, typer.Option(help=f"Episodes to play. {_PRE}")] = None
    gradient_steps: Annotated[
        int | None, typer.Option(help=f"Gradient steps after an episode (or step). {_PRE}")
    ] = None
    stretches: Annotated[int | None, typer.Option(help=f"Stretches of episodes in a batch. {_PRE}")] = None
    stretch: Annotated[int | None, typer.Option(help=f"Steps, of all agents, in a stretch. {_PRE}")] = None
    trace: Annotated[
        float | None, typer.Option(help=f"Lambda of the returns along a stretch; 0: one step. {_PRE}")
    ] = None
    learning_rate: Annotated[float | None, typer.Option(help=f"Learning rate. {_PRE}")] = None
    soft_target: Annotated[
        float | None, typer.Option(help=f"Share of the weights that the target takes over. {_PRE}")
    ] = None
    discount: Annotated[float | None, typer.Option(help=f"Discount of later rewards. {_PRE}")] = None
    memory: Annotated[int | None, typer.Option(help=f"Episodes remembered. {_PRE}")] = None
    explore: Annotated[
        float | None, typer.Option(help=f"Share of the episodes over which exploration falls to 0. {_PRE}")
    ] = None
    noise: Annotated[
        float | None, typer.Option(help=f"Perturbation of the values, in parts of epsilon. {_PRE}")
    ] = None
    standardise: Annotated[
        Literal["agent", "common", "none"] | None,
        typer.Option(help=f"How rewards are brought to one scale. {_PRE}"),
    ] = None
    hidden: Annotated[
        str | None,
        typer.Option(help="Sizes of the hidden layers, as 64,64; none: values linear in what is seen."),
    ] = None
    per_task: Annotated[
        bool | None, typer.Option(help=f"One function values every task (observation of the thesis). {_PRE}")
    ] = None
    evaluate_every: Annotated[int | None, typer.Option(help=f"Episodes between evaluations. {_PRE}")] = None
    evaluations: Annotated[int, typer.Option(help="Fresh episodes in every evaluation.")] = 2
    checkpoint_every: Annotated[int | None, typer.Option(help=f"Episodes between checkpoints. {_PRE}")] = None
    threads: Annotated[
        int, typer.Option(min=1, help="Threads of torch; 1 gives the same weights anywhere.")
    ] = 1
    seed: Annotated[int, typer.Option(min=0, help="Seed of the run.")] = 0


@train_app.command(name="reda")
@grouped
def train_reda(
    *,
    instance: Annotated[
        str, typer.Argument(metavar="INSTANCE", help="A built-in name; every episode has a seed of its own.")
    ] = "power",
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Folder for checkpoint, log and weights; an ended run continues from it.",
        ),
    ] = Path("reda"),
    preset: Annotated[
        Literal["default", "thesis", "per-task"],
        typer.Option(
            help="Options to start from: the library's, those of Algorithm 4 of the thesis, or those with one "
            "function that values every task."
        ),
    ] = "default",
    observation: Annotated[
        Literal["auto", "published", "thesis", "state"],
        typer.Option(
            help="What agents see: as in the published code, as in the thesis, or beta_hat in their state; auto: "
            "by the preset, or the last where the state does not show the previous tasks."
        ),
    ] = "auto",
    see: Annotated[
        int | None,
        typer.Option(min=1, help="Steps whose benefits agents see; default 3, with the preset per-task 5."),
    ] = None,
    flags: TrainFlags,
    guide: Annotated[
        str, typer.Option(help=f"Policy that guides exploration: {', '.join(GUIDES)}.")
    ] = "auto",
    time_limit: TimeLimit = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Train REDA (Algorithm 4 of Holder 2024) on fresh episodes of a built-in instance."""
    from sapopt import solvers
    from sapopt.domains.instances import find_instance
    from sapopt.domains.instances import instance as build

    find_instance(instance)
    check_time(time_limit)
    if guide not in GUIDES:
        raise ValueError(nearest(guide, GUIDES, "guide"))
    from sapopt import learning  # an ImportError here says which extra is missing
    from sapopt.learning.observation import shows_assignment

    weights = out / "weights.safetensors"
    if weights.exists() and not force:
        raise ValueError(f"{weights} exists already; give --force to train on, or another --out")
    first = build(instance, flags.seed)
    has_charge = first.model.charge_of(first.initial_state()) is not None
    if guide == "auto":
        guide = "power_constrained" if has_charge and preset != "thesis" else "myopic"
    given = {name: value for name, value in asdict(flags).items() if value is not None}
    if flags.hidden is not None:
        given["hidden"] = _sizes(flags.hidden)
    by_text = observation == "thesis" or (observation == "auto" and preset != "default")
    seen: Any = learning.ThesisObservation if by_text else learning.ObservationSpec
    options_of: Any = {
        "default": learning.TrainOptions,
        "thesis": learning.TrainOptions.thesis,
        "per-task": learning.TrainOptions.per_task_values,
    }
    steps = see or (5 if preset == "per-task" else 3)
    if observation == "state" or (observation == "auto" and not shows_assignment(first.initial_state())):
        spec: Any = learning.StateObservation.of(first, steps=steps)
    else:
        spec = seen(steps=steps, charge=has_charge)
    options = options_of[preset](spec=spec, **given)
    policy = solvers.AssignmentPolicy(getattr(solvers, guide))
    with Reporter() as reporter, work.watched(f"training REDA on {instance}", reporter) as (phase, callback):
        run = Run(time_limit=time_limit, callback=callback)
        training = learning.train(lambda s: build(instance, s), policy, options, out, run)
        phase.note = f"{training.episodes} episodes, best evaluation {training.value:,.1f}"
    report: dict[str, Any] = {
        "instance": instance,
        "options": asdict(options),
        "guide": guide,
        "episodes": training.episodes,
        "value": training.value,
        "seconds": run.seconds,
        "environment": show.environment(),
        "command": " ".join(["sapopt", *sys.argv[1:]]),
    }
    learning.save_network(training.network, weights, report)
    report["weights"] = str(weights)
    if as_json:
        show.print_json(report)
    else:
        print(f"{weights}: best of the evaluations {training.value:,.1f}, after {training.episodes} episodes")
    if run.stopped:
        raise typer.Exit(EXIT_INTERRUPTED)


def _sizes(text: str) -> tuple[int, ...]:
    """Sizes of hidden layers from ``"64,64"`` or ``"none"``."""
    if text.strip().lower() == "none":
        return ()
    sizes = [part.strip() for part in text.split(",")]
    if not all(part.isdigit() and int(part) > 0 for part in sizes):
        raise ValueError(f"--hidden must be whole numbers such as 64,64, or none; got {text!r}")
    return tuple(map(int, sizes))
