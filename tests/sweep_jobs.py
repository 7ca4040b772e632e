"""Jobs for the tests of sweeps: importable by name on the workers."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any


def log_line(path: str, text: str) -> None:
    """Append a line in one piece."""
    with Path(path).open("a", encoding="utf-8") as file:
        file.write(text + "\n")


def square(spec: dict[str, Any]) -> dict[str, Any]:
    """Square a number slowly, and tell the log who did it."""
    log_line(spec["log"], f"start {spec['x']} {os.getpid()}")
    time.sleep(spec["seconds"])
    log_line(spec["log"], f"end {spec['x']} {os.getpid()}")
    return {"square": spec["x"] ** 2}


def fails(spec: dict[str, Any]) -> dict[str, Any]:
    """Fail for odd numbers."""
    if spec["x"] % 2:
        raise ValueError(f"{spec['x']} is odd")
    return {"half": spec["x"] // 2}


def dies_once(spec: dict[str, Any]) -> dict[str, Any]:
    """Kill the own process, as a machine that runs out of memory would, unless it was done before."""
    mark = Path(spec["log"] + f".{spec['x']}")
    if spec["x"] == 3 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    log_line(spec["log"], f"end {spec['x']} {os.getpid()}")
    return {"x": spec["x"]}


def always_dies(spec: dict[str, Any]) -> dict[str, Any]:
    """Kill the own process."""
    os.kill(os.getpid(), signal.SIGKILL)
    return {}
