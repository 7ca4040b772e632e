"""The two programmes that plans are improved in: over the arcs of the time-expanded network, or over stays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations import network, stays
from sapopt.formulations.highs import Programme
from sapopt.formulations.network import Network
from sapopt.formulations.stays import Stays


class Form(Protocol):
    """A programme whose columns can be picked."""

    @property
    def regret(self) -> FloatArray:
        """A plan that uses a column (columns,) is worth at most the bound less this."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m)."""

    def follow(self, plan: IntArray) -> np.ndarray:
        """Mask of the columns that a plan (T, n) uses."""

    def around(self, plan: IntArray, free: np.ndarray) -> np.ndarray:
        """Mask of the columns by which other plans differ from this one only where (T, n) `free` is True."""

    def programme(self, keep: np.ndarray) -> Programme:
        """The programme over the columns of a mask."""

    def recover(self, x: FloatArray, keep: np.ndarray) -> IntArray:
        """The plan that a point of the programme stands for."""


@dataclass(frozen=True, eq=False)
class NetworkForm:
    """Arcs of the time-expanded network."""

    network: Network
    regret: FloatArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m)."""
        return self.network.shape

    def follow(self, plan: IntArray) -> np.ndarray:
        """Arcs on the agents' paths."""
        return self.network.follow(plan) > 0.5

    def around(self, plan: IntArray, free: np.ndarray) -> np.ndarray:
        """Arcs of free cells into slots that the others leave."""
        net = self.network
        T, _, m = net.shape
        taken = np.zeros(T * m, dtype=bool)
        taken[(np.arange(T)[:, None] * m + plan)[~free]] = True
        mask: np.ndarray = (net.slot < 0) | (free[net.step, net.agent] & ~taken[net.slot])
        return mask | self.follow(plan)

    def programme(self, keep: np.ndarray) -> Programme:
        """Flow conservation and capacities."""
        return self.network.programme(keep)

    def recover(self, x: FloatArray, keep: np.ndarray) -> IntArray:
        """Plan of the paths."""
        return network.recover(self.network, x, keep)


@dataclass(frozen=True, eq=False)
class StaysForm:
    """Stays of agents on tasks."""

    stays: Stays
    regret: FloatArray

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m)."""
        return self.stays.shape

    def follow(self, plan: IntArray) -> np.ndarray:
        """Stays of the plan."""
        return self.stays.follow(plan)

    def around(self, plan: IntArray, free: np.ndarray) -> np.ndarray:
        """Stays that keep the fixed cells."""
        return self.stays.compatible(plan, free)

    def programme(self, keep: np.ndarray) -> Programme:
        """Every agent's steps once, every task's at most once."""
        return self.stays.programme(keep)

    def recover(self, x: FloatArray, keep: np.ndarray) -> IntArray:
        """Plan of the stays."""
        return stays.recover(self.stays, x, keep)
