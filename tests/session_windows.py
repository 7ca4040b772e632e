"""What the tests of sessions share: random windows, and problems played call by call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt import SAP, Decision, Session
from sapopt.dynamics import Battery, SwitchingCost, SyntheticSwitching
from sapopt.dynamics.base import Model

RULES: dict[str, Callable[[], Model]] = {
    "switching": lambda: SwitchingCost(0.3),
    "idle is free": lambda: SwitchingCost(0.3, idle_is_free=True),
    "battery": lambda: Battery(0.2, 0.5, 0.25),
    "copies": lambda: SyntheticSwitching(0.3, forfeit=0.2),
}


def benefits_of(seed: int, shape: tuple[int, int, int], sparse: bool = False) -> Any:
    """Random benefits, many of them zero."""
    rng = np.random.default_rng(seed)
    dense = rng.random(shape) * (rng.random(shape) < 0.6)
    return [sp.csr_array(step) for step in dense] if sparse else dense


def windows(benefits: np.ndarray, length: int) -> Iterator[tuple[np.ndarray, bool]]:
    """The window at every step, and whether nothing follows it."""
    steps = len(benefits)
    for k in range(steps):
        stop = min(k + length, steps)
        yield benefits[k:stop], stop == steps


def played(session: Session, benefits: np.ndarray, length: int, **options: Any) -> list[Decision]:
    """A session through all steps of some benefits, with windows of a length."""
    return [session.step(window, ends=ends, **options) for window, ends in windows(benefits, length)]


def as_plan(decisions: list[Decision]) -> np.ndarray:
    """Decisions of agents and tasks that are called 0, 1, ... as a plan, -1 for nothing."""
    n = len(decisions[0].assignment)
    return np.array(
        [[-1 if d.assignment[i] is None else d.assignment[i] for i in range(n)] for d in decisions]
    )


def earned(problem: SAP, decisions: list[Decision]) -> tuple[float, float]:
    """What the decisions say that they gain, and what the plan is worth."""
    return sum(d.gained for d in decisions), problem.evaluate(as_plan(decisions)).value
