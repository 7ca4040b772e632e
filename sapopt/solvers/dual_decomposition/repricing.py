"""Better prices for the part of a problem that lies ahead, from the state that was really reached."""

from __future__ import annotations

from collections.abc import Callable

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.oracles import PathOracle, SoftPathOracle
from sapopt.formulations.dual import dual_value
from sapopt.formulations.dual.lagrangian import lowered
from sapopt.formulations.dual.smooth import SmoothDescent
from sapopt.kernels import clock

_HEAT = 0.01
"""Temperature of the repricing of all that is left, in typical benefits."""

_HOT, _COLD, _RATE = 0.05, 0.02, 0.2
"""Temperatures and step length of the repricing of a window, as in `SmoothDescent`."""


def repriced(oracle: PathOracle, prices: FloatArray, iterations: int, stop: Callable[[], bool]) -> FloatArray:
    """The best of some prices (T, m) on the way of a descent at one low temperature; they never get worse."""
    if not isinstance(oracle, SoftPathOracle):
        return prices
    descent = SmoothDescent(iterations=1, hot=_HEAT)
    walk = descent.begin(prices)
    bound = dual_value(oracle, prices).bound
    while walk.iteration < iterations:
        walk = descent.step(oracle, walk)
        if stop():
            break
        if walk.iteration % 10 == 0:
            found = dual_value(oracle, walk.prices).bound
            if found < bound:
                bound, prices = found, walk.prices
    return prices


def repriced_window(oracle: PathOracle, prices: FloatArray, iterations: int, seconds: float) -> FloatArray:
    """The last prices (T, m) of a descent that cools and leaves out what no good path uses."""
    if not isinstance(oracle, SoftPathOracle):
        return prices
    until = clock.now() + seconds
    descent = SmoothDescent(iterations, hot=_HOT, cold=_COLD, rate=_RATE)
    walk = descent.begin(prices)
    cheaper = None
    while walk.iteration < iterations and clock.now() < until:
        if walk.iteration % 10 == 0:
            cheaper, walk = descent.cheaper(oracle, walk)
        walk = descent.step(oracle, walk, cheaper)
    return lowered(walk.prices)
