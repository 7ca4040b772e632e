"""The dual of a folded problem, prices and multipliers together: both follow one temperature as it falls.

The dual has kinks. By turns, prices first and then multipliers at those prices, a descent comes to rest on one of them,
far above the minimum: no change of the prices alone lowers the dual there, and none of the multipliers alone. Softened
paths have no kinks, and on them turns lead to the minimum. So the multipliers take a step of Newton's after every few
steps of the prices, at the temperature that the prices are at.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.switching.many_costs import ManyCosts
from sapopt.formulations.dual import ascend
from sapopt.formulations.dual.ascent import DualState
from sapopt.formulations.dual.smooth import SmoothDescent
from sapopt.formulations.limited.folded import Folded
from sapopt.formulations.limited.folded_dual import FoldedDual, FoldedPaths, Watch
from sapopt.kernels import clock

_STEPS = 200
"""Steps of the prices while the temperature falls."""
_EVERY = 10
"""Steps of the prices between two of the multipliers."""
_FAR = 8
"""Most that a multiplier changes at a step, on its grid."""
_APART = 2
"""Distance on the grid of the three multipliers at which the dual is asked for, to tell its slope and curvature."""
_PLANNED = 0.9
"""Share of the time left that steps are planned for; they get dearer on the way."""
_CHANGE = 0.15
"""Relative change of the number of steps left, below which the cooling goes on as it was planned."""
_KEPT = 15.0
"""Reduced cost, in temperatures, up to which entries count where the multipliers' step is computed."""


def descend(
    folded: Folded,
    paths: FoldedPaths,
    stop_at: float,
    watch: Watch = lambda iterations, bound: False,
    prices: FloatArray | None = None,
) -> FoldedDual:
    """Minimise the dual until `stop_at`, a time of `sapopt.kernels.clock.now`, or until it no longer falls.

    Parameters
    ----------
    watch : callable
        ``watch(iterations, bound) -> stop?``
    prices : ndarray, shape (T, m), optional
        To begin from.
    """
    dearer = np.zeros(folded.problem.n)
    if folded.is_plain:
        seconds = max(stop_at - clock.now(), 0.0) if math.isfinite(stop_at) else None
        only = ascend(
            paths.at(dearer), prices, time_limit=seconds,
            callback=lambda steps, bound, _: watch(steps, paths.whole(bound, dearer)),
        )  # fmt: skip
        return FoldedDual(paths.whole(only.bound, dearer), only.prices, dearer)
    best: FoldedDual | None = None
    prices = np.zeros(paths.plain.shape[::2]) if prices is None else prices
    descent = SmoothDescent(iterations=_STEPS)
    state, done = DualState(descent.begin(prices), descent, None), 0
    while True:
        began = clock.now()

        def told(
            steps: int,
            bound: float,
            _: FloatArray,
            at: FloatArray = dearer,
            least: float = math.inf if best is None else best.bound,
            past: int = done,
        ) -> bool:
            return watch(past + steps, min(least, paths.whole(bound, at))) or clock.now() >= stop_at

        here = ascend(paths.at(dearer), prices, state=state, max_iterations=_EVERY, callback=told)
        done += here.iterations
        prices, state = here.prices, here.state
        found = FoldedDual(paths.whole(here.bound, dearer), prices, dearer)
        if best is None or found.bound < best.bound:
            best = found
        if state.smooth is None or clock.now() >= stop_at or watch(done, best.bound):
            return best
        temperature = state.descent.temperature(paths.at(dearer), state.smooth.iteration)
        dearer = _stepped(folded, paths, dearer, state.smooth.prices, temperature)
        pace = (clock.now() - began) / _EVERY
        state = replace(state, descent=_replanned(state.descent, state.smooth.iteration, pace, stop_at))


def _replanned(descent: SmoothDescent, done: int, pace: float, stop_at: float) -> SmoothDescent:
    """The rest of the fall in as many steps as there is time for, if so many as planned there is not."""
    left = descent.iterations - done
    affordable = _PLANNED * (stop_at - clock.now()) / max(pace, 1e-9)
    if left - affordable <= _CHANGE * left:
        return descent
    return descent.replanned(done, max(int(affordable), 1))


def _stepped(
    folded: Folded, paths: FoldedPaths, dearer: FloatArray, prices: FloatArray, temperature: float
) -> FloatArray:
    """The multipliers (n,) after one of Newton's steps each, on the softened dual; on the grid."""
    grid = paths.grid
    apart = _APART * grid
    middle = np.maximum(dearer, apart)
    near = paths.at(middle).narrowed(prices, _KEPT * temperature)
    low, here, high = (
        _softened(near, change, prices, temperature) + folded.most * (middle + change)
        for change in (-apart, 0.0, apart)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (high - low) / (2.0 * apart)
        wanted = middle - slope / (np.maximum(high - 2.0 * here + low, 0.0) / apart**2)
    # where an agent has no path, or what it takes up depends on no multiplier, nothing is told
    wanted = np.where(np.isnan(wanted), dearer, wanted)
    wanted = np.clip(wanted, np.maximum(dearer - _FAR * grid, 0.0), dearer + _FAR * grid)
    return np.where(folded.row >= 0, grid * np.rint(wanted / grid), 0.0)


def _softened(near: ManyCosts, change: float, prices: FloatArray, temperature: float) -> FloatArray:
    """Soft values (n,) of all paths where every move costs so much more."""
    parts = [(agents, part.alone(np.arange(len(agents)), part.cost + change)) for agents, part in near.parts]
    values, _ = ManyCosts(near.whole, parts).soft_paths(prices, temperature)
    return values
