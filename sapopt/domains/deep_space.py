"""Antennas that talk with spacecraft far away: tracks of so many hours, some by several antennas at once.

An agent is an antenna, a task a request, a step half an hour. To hold a request is to begin its *track*: the set-up,
the hours that are wanted, and the tear-down, during which the antenna is busy. A request is served once. One that wants
several antennas earns, as a `sapopt.Team`, its hours when so many begin it at the same step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP

_ALONE = 1e-4
"""What a track by one antenna is worth that several are needed for, as a share of its hours: it must not be nothing."""


@dataclass(frozen=True, eq=False)
class DeepSpace:
    """Requests and the antennas that could serve them.

    Attributes
    ----------
    begins : ndarray of bool, shape (T, n, m)
        Whether an antenna may begin a track at a step: its spacecraft is in view for all hours that are wanted.
    hours : ndarray, shape (m,)
        Wanted by every request.
    length : ndarray of int64, shape (m,)
        Steps for which an antenna is busy with the track, set-up and tear-down included.
    needs : ndarray of int64, shape (m,)
        Antennas that a request wants at once.
    antennas, requests : tuple of str
        Labels.
    alike : ndarray of int64, shape (m,), or None
        Tasks of equal number here are ways to serve one request: by one antenna or by several, at full length or
        shortened. None: each is a request of its own.
    """

    begins: np.ndarray
    hours: FloatArray
    length: IntArray
    needs: IntArray
    antennas: tuple[str, ...] = ()
    requests: tuple[str, ...] = ()
    alike: IntArray | None = None

    def __post_init__(self) -> None:
        if self.begins.ndim != 3 or self.begins.dtype != bool:
            raise ValueError(f"begins must be a mask of shape (T, n, m), got {self.begins.shape}")
        _, n, m = self.begins.shape
        for name, least, most in (("hours", 0, np.inf), ("length", 1, np.inf), ("needs", 1, n)):
            values = np.asarray(getattr(self, name))
            if values.shape != (m,) or (values < least).any() or (values > most).any():
                raise ValueError(f"{name} must be {m} numbers from {least} to {most}")

    def problem(self, cost: Any = 0.0, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem, whose value is the hours served.

        Parameters
        ----------
        cost : float
            Hours that a track costs besides the time that it takes.
        idle_is_free : bool, optional
            Refused: an antenna waits for free.
        """
        import scipy.sparse as sp

        from sapopt.dynamics import Jobs
        from sapopt.problem.limit import Limit, Team
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "an antenna waits for free")
        T, _, m = self.begins.shape
        several = np.flatnonzero(self.needs > 1)
        worth = np.where(self.needs > 1, _ALONE * self.hours, self.hours)
        seers = self.begins.sum(axis=1)
        capacity = np.where(seers < self.needs, 0, self.needs)
        limits: list[Limit | Team] = []
        groups = np.arange(m) if self.alike is None else self.alike
        for group in np.unique(groups):
            tasks = np.flatnonzero(groups == group)
            weight = np.zeros(m)
            weight[tasks] = 1.0 / self.needs[tasks]
            limits.append(
                Limit(weight, 1.0, name=self.requests[tasks[0]] if self.requests else f"request {group}")
            )
        for j in several:
            steps = np.flatnonzero(capacity[:, j])
            if len(steps):
                reward = (1.0 - _ALONE * float(self.needs[j])) * float(self.hours[j])
                limits.append(Team(int(j), int(self.needs[j]), reward=reward, steps=steps))
        benefits = [sp.csr_array(np.where(self.begins[k], worth, -np.inf)) for k in range(T)]
        return SAP(
            benefits, Jobs(self.length, cost), idle=True, capacity=capacity, limits=limits,
            agents=self.antennas or None, tasks=self.requests or None,
        )  # fmt: skip

    def hours_served(self, plan: IntArray) -> float:
        """Hours of the tracks of a plan (T, n) that enough antennas begin together."""
        total = 0.0
        for row in plan:
            tasks, count = np.unique(row[row >= 0], return_counts=True)
            good = count >= self.needs[tasks]
            total += float(self.hours[tasks][good].sum())
        return total


def fitting_starts(view: np.ndarray, served: IntArray, before: int) -> np.ndarray:
    """Where a track may begin: mask (T, n, m).

    Parameters
    ----------
    view : ndarray of bool, shape (T, n, m)
        Whether a spacecraft is in view of an antenna.
    served : ndarray of int64, shape (m,)
        Steps for which it must be in view on end.
    before : int
        Steps of set-up, during which it need not be.
    """
    T = len(view)
    so_far = np.concatenate([np.zeros((1, *view.shape[1:]), dtype=np.int64), np.cumsum(view, axis=0)])
    out = np.zeros(view.shape, dtype=bool)
    for length in np.unique(served):
        tasks = np.flatnonzero(served == length)
        last = T - before - int(length)
        if last >= 0:
            first = np.arange(last + 1) + before
            seen = so_far[first + int(length)] - so_far[first]
            out[: last + 1, :, tasks] = seen[:, :, tasks] == length
    return out


def random_deep_space(
    antennas: int = 12, requests: int = 60, steps: int = 336, seed: int = 0, *, arrays: int = 6
) -> DeepSpace:
    """A made-up week of half hours: antennas at three sites, each of which sees a spacecraft for a third of a day.

    A track takes an hour of set-up and half an hour of tear-down besides the hours that are wanted, and must be over by
    the end.

    Parameters
    ----------
    antennas, requests, steps : int
        n, m and T.
    seed : int
    arrays : int
        Requests that want two antennas of one site at once.

    Raises
    ------
    ValueError
        If a number is too small.
    """
    for name, value, least in (
        ("antennas", antennas, 1), ("requests", requests, 1), ("steps", steps, 1), ("arrays", arrays, 0),
    ):  # fmt: skip
        if int(value) != value or value < least:
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    rng = np.random.default_rng(seed)
    site = np.arange(antennas) % 3
    rise = rng.uniform(0, 48, requests)  # at the first site; the others follow by a third of a day each
    length = rng.integers(16, 25, requests)
    span = max(1, steps // 2)  # a request may be served within half of the time
    first = rng.integers(0, steps - span + 1, requests)
    k = np.arange(steps)[:, None, None]
    since = (k - rise - 16.0 * site[:, None]) % 48
    suits = rng.random((antennas, requests)) < 0.6
    view = (since < length) & (first <= k) & (k < first + span) & suits
    needs = np.ones(requests, dtype=np.int64)
    needs[rng.permutation(requests)[: min(arrays, requests)]] = 2
    there = np.array([(suits & (site == s)[:, None]).sum(axis=0) for s in range(3)])
    needs[there.max(axis=0) < 2] = 1
    view[:, :, needs > 1] &= site[:, None] == there.argmax(axis=0)[needs > 1]
    wanted = rng.choice([2, 4, 8, 12, 16], requests)
    return DeepSpace(
        fitting_starts(view, wanted, before=2), 0.5 * wanted, wanted + 3, needs,
        antennas=tuple(f"antenna {i} at site {site[i]}" for i in range(antennas)),
        requests=tuple(f"request {j}" for j in range(requests)),
    )  # fmt: skip
