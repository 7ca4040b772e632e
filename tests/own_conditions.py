"""A user's dynamics for the tests of the theorem's conditions."""

from __future__ import annotations

import numpy as np

from sapopt import SAP


class Tired:
    """Every agent loses 1 from its second step on the same task, and the state counts the steps."""

    handover_limit = 0.0

    def __init__(self, tiring: bool) -> None:
        self.tiring = tiring

    def initial_state(self, problem: SAP) -> tuple:
        return ((), 0)

    def handover(self, k: int, state: tuple) -> np.ndarray:
        eta = np.full((2, 3), 0.0 if not state[0] else -2.0)
        for i, j in enumerate(state[0]):
            eta[i, j] = -1.0 * self.tiring
        return eta

    def transition(self, k: int, state: tuple, assignment: np.ndarray) -> tuple:
        return (tuple(int(j) for j in assignment), (state[1] + 1) * self.tiring)

    def key(self, state: tuple) -> tuple:
        return state
