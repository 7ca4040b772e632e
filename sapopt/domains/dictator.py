"""The dictator: a small problem with a global state, on which greed does not pay (Holder 2024, section 6.1).

Three agents, three tasks, three states. The first agent dictates the state: ``s_k = x^1_{k-1}``, the task that it held
at the step before. State, agent and task are counted from 0 here and from 1 in the thesis. The table of values is that
of the thesis; it does not name the state before the first step, but its 60 for ten steps needs state 0 (its 1).

=====  ========================================================  ===================
state  value of the best assignment in which the dictator holds  state after that
       task 0 / 1 / 2
=====  ========================================================  ===================
0      6 / 9 / 5                                                 0 / 1 / 2
1      0.1 / 3.2 / 0.1                                           0 / 1 / 2
2      0.1 / 0.1 / 3.2                                           0 / 1 / 2
=====  ========================================================  ===================

The dictator's own best task is task 1: it earns 3 with it in states 0 and 1, against the 2 of task 0. Greed, and with
it ``alpha(beta_hat)``, takes it at once and stays: 9 + 9 * 3.2 = 37.8 in ten steps. Holding (0, 1, 2) for ever earns
60, which the thesis calls the optimum; the best plan of ten steps earns 63, for it takes the bait of 9 at the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP

_FIRST = [[2.0, 3.0, 0.0], [0.0, 2.0, 3.0], [3.0, 0.0, 2.0]]
_SECOND = [[0.0, 3.0, 0.0], [0.0, 0.0, 0.1], [0.1, 0.0, 0.0]]
_THIRD = [[0.0, 0.0, 3.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]
VALUES = np.array([_FIRST, _SECOND, _THIRD])
"""beta_hat of each state, shape (3 states, 3 agents, 3 tasks)."""
LEADS_TO = np.array([[0, 1, 2], [0, 1, 2], [0, 1, 2]])
"""Next state, by state and task of the dictator: the task itself, whatever the state."""


@dataclass(frozen=True)
class DictatorScenario:
    """The dictator's problem.

    Attributes
    ----------
    steps : int
        Number of steps T.
    """

    steps: int = 10

    def __post_init__(self) -> None:
        if int(self.steps) != self.steps or self.steps < 1:
            raise ValueError(f"steps must be a whole number of at least 1, got {self.steps!r}")

    def problem(self, cost: Any = 0.0, *, idle_is_free: bool = False) -> SAP:
        """The sequential assignment problem: the benefits are those of state 0, and the other states add to them.

        Raises
        ------
        ValueError
            If a cost is asked for: nothing but the state matters here.
        """
        from sapopt.dynamics import Dictator
        from sapopt.problem.sap import SAP

        if np.ndim(cost) != 0 or cost != 0 or idle_is_free:
            raise ValueError(
                "cost: the dictator's problem charges no handovers; leave cost and idle_is_free out"
            )
        return SAP(
            np.repeat(VALUES[:1], self.steps, axis=0),
            Dictator(VALUES - VALUES[0], LEADS_TO),
            agents=("dictator", "agent 1", "agent 2"),
        )
