"""The dictator: a small problem with a global state, on which greed never pays (Holder 2024, section 6.1).

The thesis describes it in outline: three agents, three tasks, three states, and the state is in the hands of the first
agent; the best plan earns 60 in ten steps and alpha(beta_hat) stays with what is best for the dictator now. The numbers
below are our reading of that outline, not the thesis' table.

States 0 and 1 are poor, state 2 is rich. Task 0 is the dictator's own, its best choice of the moment in every state:
whenever it holds task 0 the state falls to 0, whenever it holds another the state rises by one.

=====  =======================================  ===================
state  value of the best assignment in which    state after that
       the dictator holds task 0 / 1 / 2
=====  =======================================  ===================
0      3 / 2 / 1                                0 / 1 / 1
1      3 / 1 / 1                                0 / 2 / 2
2      8 / 5 / 7                                0 / 2 / 2
=====  =======================================  ===================

Staying selfish earns 3 a step, 30 in all. The best plan gives up 1 and 2 in the first two steps, earns 7 in each of the
next seven, and takes the 8 at the end: 2 + 1 + 7 * 7 + 8 = 60.

The dictator itself earns most by staying selfish: 3 a step, against 1 where everybody is rich. Left to itself it never
moves. Whoever holds task 0 in the dictator's place sees the state rise, and with it what it will earn;
in an assignment of everybody's values that outweighs the dictator's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP

_POOR = [[3.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
_POORER = [[3.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
_RICH = [[4.0, 0.0, 1.0], [3.0, 2.0, 1.0], [3.0, 3.0, 2.0]]
VALUES = np.array([_POOR, _POORER, _RICH])
"""beta_hat of each state, shape (3 states, 3 agents, 3 tasks)."""
LEADS_TO = np.array([[0, 1, 1], [0, 2, 2], [0, 2, 2]])
"""Next state, by state and task of the dictator."""


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
