"""The report of a benchmark: one JSON on stdout, and in a file if one is named."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from typing import Any

from sapopt.data.files import write_text


def finish(figures: Mapping[str, Any], out: str | None) -> None:
    """Print the figures with the machine that they are of, and write them to `out`."""
    machine = {
        "machine": platform.machine(), "python": platform.python_version(),
        "cores": len(os.sched_getaffinity(0)), "load": os.getloadavg(),
    }  # fmt: skip
    text = json.dumps(machine | dict(figures), indent=1)
    print(text)
    if out:
        write_text(out, text + "\n")
