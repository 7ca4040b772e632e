"""Compare ways to minimise the Lagrangian dual of the task capacities.

    python -m experiments.benchmarks.dual_ascent constellation-mid constellation-large --seconds 60

Every method starts from zero prices and gets the same processor time (all threads together). Printed: the best value of
the dual after each quarter of it. Methods that lost live here, so that the comparison can be repeated.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator

import highspy
import numpy as np
from scipy.optimize import minimize

from sapopt import SAP
from sapopt.domains.instances import instance
from sapopt.dynamics.paths.oracles import SoftPathOracle
from sapopt.formulations.dual import dual_value
from sapopt.formulations.dual.lagrangian import lowered
from sapopt.formulations.dual.smooth import SmoothDescent
from sapopt.formulations.dual.subgradient import Subgradient

Prices = np.ndarray
Method = Callable[[SoftPathOracle, float], Iterator[float]]
"""Yields the best dual value so far, at least once every few seconds, for about the seconds given."""


def annealed(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """The two stages of `ascend`: annealed accelerated smoothing, then subgradient steps."""
    T, _, m = oracle.shape
    descent, best = SmoothDescent(), np.inf
    smooth = descent.begin(np.zeros((T, m)))
    while smooth.iteration < descent.iterations:
        smooth = descent.step(oracle, smooth)
        if smooth.iteration % 10 == 0:
            best = min(best, dual_value(oracle, smooth.prices).value)
        yield best
    polish = Subgradient()
    walk = polish.begin(smooth.prices, oracle.scale)
    while not polish.converged(walk, oracle.scale):
        walk, here = polish.step(oracle, walk)
        best = min(best, here.value)
        yield best


def momentum(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """Subgradient with momentum, halving on stall, restart from the best."""
    T, _, m = oracle.shape
    mu = best_mu = np.zeros((T, m))
    velocity = np.zeros_like(mu)
    best, stall, length = np.inf, 0, 0.12 * oracle.scale
    while True:
        here = dual_value(oracle, mu)
        stall = 0 if here.value < best - 1e-7 * abs(best) or not np.isfinite(best) else stall + 1
        if here.value < best:
            best, best_mu = here.value, here.prices
        yield best
        if stall >= 20:
            length, stall, mu, velocity = 0.5 * length, 0, best_mu, np.zeros_like(mu)
            continue
        velocity = 0.9 * velocity + (here.usage - 1.0)
        mu = np.maximum(here.prices + 0.1 * length * velocity, 0.0)


def polyak(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """Polyak's step to a target that is moved closer when it stalls."""
    T, _, m = oracle.shape
    mu = best_mu = np.zeros((T, m))
    best, gap, stall = np.inf, 0.05, 0
    while True:
        here = dual_value(oracle, mu)
        stall = 0 if here.value < best - 1e-6 * abs(best) or not np.isfinite(best) else stall + 1
        if here.value < best:
            best, best_mu = here.value, here.prices
        yield best
        if stall >= 20:
            gap, stall, mu = 0.5 * gap, 0, best_mu
            continue
        slope = np.where((here.prices <= 0.0) & (here.usage < 1), 0.0, 1.0 - here.usage)
        length = (here.value - (1.0 - gap) * best) / max(float(np.sum(slope * slope)), 1e-12)
        mu = np.maximum(here.prices - length * slope, 0.0)


def volume(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """Volume algorithm: steps from the best prices along the running average of the usage."""
    T, _, m = oracle.shape
    here = dual_value(oracle, np.zeros((T, m)))
    best, mean, factor, gap, stall = here, here.usage.astype(float), 1.0, 0.05, 0
    while True:
        yield best.value
        slope = 1.0 - mean
        slope[(best.prices <= 0.0) & (slope > 0.0)] = 0.0
        length = factor * gap * abs(best.value) / max(float(np.sum(slope * slope)), 1e-12)
        here = dual_value(oracle, np.maximum(best.prices - length * slope, 0.0))
        mean = 0.9 * mean + 0.1 * here.usage
        if here.value < best.value - 1e-7 * abs(best.value):
            best, stall, factor = here, 0, min(2.0, 1.1 * factor)
        else:
            stall += 1
            if stall >= 10:
                factor, stall = 0.66 * factor, 0


def stages(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """The accelerated smooth descent at fixed temperatures, 40 steps each."""
    T, _, m = oracle.shape
    mu, best, hot = np.zeros((T, m)), np.inf, 0.25
    while True:
        step = SmoothDescent(40, hot, hot)
        state = step.begin(mu)
        for turn in range(40):
            state = step.step(oracle, state)
            if turn % 10 == 9:
                best = min(best, dual_value(oracle, state.prices).value)
                yield best
        mu, hot = state.prices, max(0.5 * hot, 0.005)


def lbfgs(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """L-BFGS-B on the smoothed dual at fixed temperatures, 30 iterations each."""
    T, _, m = oracle.shape
    mu, best, hot = np.zeros((T, m)), np.inf, 0.25
    while True:
        eps = max(hot * oracle.scale, 1.05 * oracle.coldest)

        def smoothed(x: np.ndarray, eps: float = eps) -> tuple[float, np.ndarray]:
            values, usage = oracle.soft_paths(x.reshape(T, m), eps)
            return float(values.sum() + x.sum()), (1.0 - usage).ravel()

        found = minimize(
            smoothed, mu.ravel(), jac=True, method="L-BFGS-B", bounds=[(0.0, None)] * mu.size,
            options={"maxiter": 30},
        )  # fmt: skip
        mu = found.x.reshape(T, m)
        best = min(best, dual_value(oracle, lowered(mu)).value)
        yield best
        hot = max(0.5 * hot, 0.005)


def columns(oracle: SoftPathOracle, seconds: float) -> Iterator[float]:
    """Column generation from nothing: a HiGHS master over the paths found, priced by the oracle."""
    T, n, m = oracle.shape
    master = highspy.Highs()
    master.setOptionValue("output_flag", False)
    master.setOptionValue("threads", 1)
    inf = highspy.kHighsInf
    for _ in range(n):  # one path an agent, or an artificial column
        master.addRow(1.0, 1.0, 0, np.zeros(0, np.int32), np.zeros(0))
    row_of: dict[int, int] = {}
    for i in range(n):
        master.addCol(1e3, 0.0, inf, 1, np.array([i], np.int32), np.ones(1))
    mu, best = np.zeros((T, m)), np.inf
    while True:
        here = dual_value(oracle, mu)
        best = min(best, here.value)
        yield best
        worth = here.path_values + here.prices[np.arange(T)[:, None], here.plan].sum(axis=0)
        for i in range(n):
            cells = np.arange(T) * m + here.plan[:, i]
            for cell in cells.tolist():
                if cell not in row_of:  # capacity rows are added when a path first needs them
                    row_of[cell] = n + len(row_of)
                    master.addRow(-inf, 1.0, 0, np.zeros(0, np.int32), np.zeros(0))
            rows = np.array([i] + [row_of[c] for c in cells.tolist()], np.int32)
            master.addCol(-float(worth[i]), 0.0, inf, len(rows), rows, np.ones(len(rows)))
        master.setOptionValue("time_limit", 4.0 * seconds)
        master.run()
        duals = np.asarray(master.getSolution().row_dual)
        mu = np.zeros(T * m)
        for cell, row in row_of.items():
            mu[cell] = max(0.0, -duals[row])
        mu = mu.reshape(T, m)


METHODS: dict[str, Method] = {
    "annealed smoothing (ascend)": annealed,
    "smoothing, fixed temperatures": stages,
    "L-BFGS-B on the smoothed dual": lbfgs,
    "subgradient, momentum": momentum,
    "Polyak step": polyak,
    "volume": volume,
    "column generation": columns,
}


def run(method: Method, oracle: SoftPathOracle, seconds: float) -> list[float]:
    """Best dual value after each quarter of the time."""
    marks = [np.inf] * 4
    clock = time.process_time()
    for best in method(oracle, seconds):
        spent = time.process_time() - clock
        for q in range(4):
            if spent <= 0.25 * (q + 1) * seconds:
                marks[q] = best
        if spent > seconds:
            break
    for q in range(1, 4):
        marks[q] = min(marks[q], marks[q - 1])
    return marks


def main() -> None:
    """Print one table an instance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("instance", nargs="*", default=["constellation-mid"])
    parser.add_argument("--seconds", type=float, default=60.0, help="processor seconds for every method")
    parser.add_argument("--only", default="", help="run only the methods whose name contains this")
    options = parser.parse_args()
    for name in options.instance:
        problem = load(name)
        oracle = problem.model.path_oracle(problem.benefits, problem.initial_state())
        zero = np.zeros((problem.T, problem.m))
        oracle.soft_paths(zero, oracle.scale)  # compile
        dual_value(oracle, zero)
        print(f"{name}: {problem.T} steps, {problem.n} agents, {problem.m} tasks")
        header = "".join(f"{0.25 * (q + 1) * options.seconds:>11.0f} s" for q in range(4))
        print(f"{'best dual value after':32s}{header}")
        for label, method in METHODS.items():
            if options.only in label:
                marks = run(method, oracle, options.seconds)
                print(f"{label:32s}" + "".join(f"{value:13.2f}" for value in marks), flush=True)


def load(name: str) -> SAP:
    """A built-in instance, or a problem file."""
    return SAP.load(name) if name.endswith(".npz") else instance(name, seed=0)


if __name__ == "__main__":
    main()
