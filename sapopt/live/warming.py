"""A session's kernels compiled before the first decision is due."""

from __future__ import annotations

import numbers
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from sapopt.kernels.jit import compiled_always

if TYPE_CHECKING:
    from sapopt.live.session import Session

_STEPS = 6
_IN_SIGHT = 5
_CALLS = 3
"""The second call, which has a past, needs more than the first; the third tells how long a decision takes."""


def run_warm(session: Session, benefits: Any, agents: Any, tasks: Any, budget_s: float | None) -> None:
    """Take some decisions in a session that nobody needs.

    Parameters
    ----------
    session : Session
    benefits : object
        As for `Session.step`, or None.
    agents, tasks : sequence of ids, or int
    budget_s : float or None

    Raises
    ------
    ValueError
        If there is neither a window nor a number of agents and tasks.
    """
    if benefits is None:
        if agents is None or tasks is None:
            raise ValueError(
                "warm needs a window of benefits, or agents= and tasks=: the ids, or how many there will be"
            )
        benefits = _made_up(_count(agents, "agents"), _count(tasks, "tasks"))
    agents = None if isinstance(agents, numbers.Integral) else agents
    tasks = None if isinstance(tasks, numbers.Integral) else tasks
    with compiled_always():
        for _ in range(_CALLS):
            session.step(benefits, agents=agents, tasks=tasks)
        for _ in range(_CALLS if budget_s is not None else 0):
            session.step(benefits, agents=agents, tasks=tasks, budget_s=budget_s)


def _count(values: Any, name: str) -> int:
    if isinstance(values, numbers.Integral) and not isinstance(values, (bool, np.bool_)) and int(values) >= 1:
        return int(values)
    try:
        return len(values)
    except TypeError:
        raise ValueError(f"{name} must be ids, or how many there will be, got {values!r}") from None


def _made_up(n: int, m: int) -> list[sp.csr_array]:
    """Benefits with a few tasks in sight of every agent."""
    rng = np.random.default_rng(0)
    sight = min(_IN_SIGHT, m)
    rows = np.repeat(np.arange(n), sight)
    columns = (np.repeat(rng.integers(m, size=n), sight) + np.tile(np.arange(sight), n)) % m
    return [sp.csr_array((rng.random(len(rows)) + 0.1, (rows, columns)), shape=(n, m)) for _ in range(_STEPS)]
