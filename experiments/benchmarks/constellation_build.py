"""Time and memory to build a large constellation, as JSON.

Usage: python -m experiments.benchmarks.constellation_build [INSTANCE] [--seed SEED]

The instance is built once, in this process; compilation is done before on a small one
and reported by itself. The memory is the highest resident size of the process, Python and libraries included.
"""

from __future__ import annotations

import argparse
import json
import platform
import resource
import sys
import time

from sapopt.domains.instances import find_instance, scenario


def peak_mib() -> float:
    """Highest resident memory of this process so far, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def measure(name: str, seed: int) -> dict[str, object]:
    """Build one instance and describe what that took."""
    start = time.perf_counter()
    scenario("constellation-toy").problem()
    compiled = time.perf_counter()
    before = peak_mib()
    built = scenario(name, seed)
    built_at = time.perf_counter()
    problem = built.problem()
    end = time.perf_counter()
    flat = problem.benefits.flat()
    nbytes = flat.indptr.nbytes + flat.indices.nbytes + flat.data.nbytes
    return {
        "instance": name,
        "seed": seed,
        "shape": [problem.T, problem.n, problem.m],
        "nonzeros": len(flat.data),
        "csr_mib": round(nbytes / 2**20, 1),
        "dense_gib": round(problem.T * problem.n * problem.m * 8 / 2**30, 2),
        "compile_s": round(compiled - start, 2),
        "build_s": round(built_at - compiled, 2),
        "problem_s": round(end - built_at, 2),
        "peak_mib_before": round(before, 1),
        "peak_mib": round(peak_mib(), 1),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def main() -> None:
    """Read the arguments, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("instance", nargs="?", default="constellation-shells")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    try:
        find_instance(arguments.instance)
    except ValueError as error:
        parser.error(str(error))
    print(json.dumps(measure(arguments.instance, arguments.seed), indent=1))


if __name__ == "__main__":
    main()
