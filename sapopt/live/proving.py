"""The proven bound of a window, from the state that there is."""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations.bounds import cancellation
from sapopt.formulations.dual import ascend, dual_value
from sapopt.formulations.limited.ascent import Ascent
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.dual import dual_value as limited_value
from sapopt.kernels import clock
from sapopt.live.course import Course

_ITERATIONS = 30
"""Of the ascent, where the policy leaves no prices of this very window."""
_LIMITED_ITERATIONS = 10


def window_bound(
    course: Course, memory: Any, start: FloatArray | None, seconds: float
) -> tuple[float | None, FloatArray | None]:
    """A bound of every plan of a window that begins like a course, and the prices that prove it.

    Parameters
    ----------
    course : Course
        The steps that are fixed.
    memory : object
        What the policy remembers: prices of the steps that follow, or anything else.
    start : ndarray, shape (steps, m), or None
        Prices to begin with where it has none.
    seconds : float
        Time for an ascent.

    Returns
    -------
    bound : float or None
        None if nothing can be proven.
    prices : ndarray or None
    """
    window, k = course.window, course.length
    core = window.core
    if not core.model.is_agent_local:
        return None, None
    left = (core.T - k, core.m)
    if not left[0]:
        return course.value, None
    promised = course.change_cost * int((window.kept.step >= k).sum())
    if not core.is_plain:
        found = _limited(course, memory, seconds)
        return (None, None) if found is None else (found - promised, None)
    oracle = path_oracle(core.model, core.benefits.slice(k, core.T), course.state)
    if isinstance(memory, np.ndarray) and memory.shape == left and np.isfinite(memory).all():
        bound, prices = dual_value(oracle, memory).bound, memory
    else:
        known = np.zeros(left)
        if (
            isinstance(memory, np.ndarray)
            and memory.ndim == 2
            and memory.shape[1] == core.m
            and (memory >= 0).all()
        ):
            start = memory  # of a policy that looks at another number of steps
        if start is not None:
            rows = min(left[0], len(start))
            known[:rows] = start[:rows]
        ascent = ascend(
            oracle, known, max_iterations=_ITERATIONS, time_limit=None if np.isinf(seconds) else seconds
        )
        bound, prices = ascent.bound, ascent.prices
    return course.value + bound + cancellation(window.blank) - promised, prices


def _limited(course: Course, memory: Any, seconds: float) -> float | None:
    """The bound with capacities, idleness and limits; none where a part of the window is fixed."""
    core = course.window.core
    if course.length:
        return None
    try:
        graph = path_graph(core, course.state)
    except ValueError:  # too many arcs
        return None
    if isinstance(memory, Prices) and memory.tasks.shape == (core.T, core.m):
        found = limited_value(graph, memory)
    else:
        ascent = Ascent(graph, clock.now() + seconds, iterations=_LIMITED_ITERATIONS, polish=False)
        found = ascent.run(None, (0.1,))
    return found.bound + cancellation(course.window.blank) if np.isfinite(found.bound) else None
