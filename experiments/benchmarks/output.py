"""The report of a benchmark: one JSON on stdout, and in a file if one is named."""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sapopt.data.files import write_text

HERE = Path(__file__).resolve().parents[2]


def checkouts(parser: argparse.ArgumentParser, against: Path | None) -> dict[str, Path]:
    """This checkout and, if there is one, another to compare with."""
    if against is None:
        return {"here": HERE}
    if not (against / "sapopt").is_dir():
        parser.error(f"--against {against}: there is no folder sapopt in it")
    return {"here": HERE, "against": against.resolve()}


def finish(figures: Mapping[str, Any], out: str | None) -> None:
    """Print the figures with the machine that they are of, and write them to `out`."""
    machine = {
        "machine": platform.machine(), "python": platform.python_version(),
        "cores": len(os.sched_getaffinity(0)), "load": os.getloadavg(),
    }  # fmt: skip
    figures = machine | dict(figures)
    print(json.dumps(figures, indent=1))
    if out:
        keep(figures, out)


def keep(figures: Mapping[str, Any], out: str | Path) -> None:
    """Write figures to a file, whose folder is made if need be: nobody runs a benchmark twice for a folder."""
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    write_text(out, json.dumps(figures, indent=1) + "\n")
