"""What the first call on a machine costs: every run starts with an empty cache of compiled code.

    python -m experiments.benchmarks.first_call [--runs 5] [--against DIR] [--out FILE]

Processor seconds of the whole process, imports included, of HAA, HAAL(3), `bound` and DualDecomposition on
constellation-toy, and the seconds by the clock of ``sapopt compare constellation-mid``. `--against` names another
checkout, whose runs take turns with those of this one. Other work on the machine lengthens the seconds by the clock.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from experiments.benchmarks.output import checkouts, finish

CALLS = {
    "HAA": "sapopt.solve(instance('constellation-toy'), solvers.HAA())",
    "HAAL(3)": "sapopt.solve(instance('constellation-toy'), solvers.HAAL(3))",
    "bound": "sapopt.bound(instance('constellation-toy'))",
    "DualDecomposition": "sapopt.solve(instance('constellation-toy'), solvers.DualDecomposition())",
}
COMPARE = "compare constellation-mid"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=5, help="runs of every call, each on an empty cache")
    parser.add_argument("--against", type=Path, metavar="DIR", help="another checkout to compare with")
    parser.add_argument("--only", nargs="+", choices=[*CALLS, COMPARE], default=[*CALLS, COMPARE])
    parser.add_argument("--out", help="file for the JSON")
    options = parser.parse_args()
    folders = checkouts(parser, options.against)
    rows = []
    for call in options.only:
        seconds: dict[str, list[float]] = {name: [] for name in folders}
        for _ in range(options.runs):
            for name, folder in folders.items():
                seconds[name].append(first_call(folder, call))
        rows.append({"call": call, "clock": "wall" if call == COMPARE else "processor", **seconds})
        medians = {name: statistics.median(values) for name, values in seconds.items()}
        told = "   ".join(
            f"{name} {medians[name]:6.1f} ({min(v):.1f} to {max(v):.1f})" for name, v in seconds.items()
        )
        print(f"{call:28s} {rows[-1]['clock']:10s} {told}", file=sys.stderr)
    finish({"runs": options.runs, "rows": rows}, options.out)


def first_call(folder: Path, call: str) -> float:
    """Seconds of one call in a new process with an empty cache: processor time, but for a comparison by the clock."""
    if call == COMPARE:
        code = f"import sys; from sapopt.cli import main; sys.argv[1:] = {COMPARE.split()!r}; main()"
    else:
        code = (
            "import sapopt; from sapopt import solvers; from sapopt.domains.instances import instance; "
            f"{CALLS[call]}"
        )
    with tempfile.TemporaryDirectory() as cache:
        began, before = time.perf_counter(), _children()
        subprocess.run(
            [sys.executable, "-c", code], check=True, cwd=cache, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": cache},
        )  # fmt: skip
        return time.perf_counter() - began if call == COMPARE else _children() - before


def _children() -> float:
    """Processor seconds of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
