"""Longest priced paths where agents are copies of one another: the mathematics of `GroupPaths`.

The state belongs to a real agent: a pair pays nothing if *some* copy of its agent held the task. A price of every task
at every step takes the real agents apart. What is left of one of them is still a problem of sets of tasks; a second
price makes paths of it. Let a real agent have B copies, and charge nu[k, r] for the place of its r-th copy at step k.
Every place is taken exactly once, so for any numbers nu and any way to hold tasks j_1..j_B,

    sum_r benefit_k[r, j_r]  <=  sum_r max_q (benefit_k[q, j_r] - nu[k, q])  +  sum_q nu[k, q].

On the right-hand side the copies are alike. Copies that are alike may be renamed at every step, so that each task that
the agent keeps stays on one copy; then a copy pays exactly where its agent does, and what is left is B paths, each for
itself. With charges that depend on the benefit the maximum is taken apart for pairs that pay and for pairs that do not.
So, with mu the prices of tasks,

    optimum <= sum over copies of (their longest path) + sum mu + sum nu        for all mu >= 0 and all nu.

To add one number to all nu of an agent and step changes nothing: nu >= 0 can be asked for. Hence nu is nothing but a
price of n further columns, of which every copy takes one besides its task: the prices of an oracle here are (T, m + n).

Two more relaxations, both for what the built-in problems do not have. Where tasks are copies too, an agent that holds
one of them enters the others without paying, and renaming does not say by which copy; there a group of several copies
never pays for such tasks. Where a task counts as held only while its benefit is positive, it counts as soon as it is
positive for one of the copies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray, root_mean_square
from sapopt.dynamics.copies import groups_kernels as kernels
from sapopt.dynamics.copies.groups_soft import soft_paths
from sapopt.dynamics.paths.window import checked_prices, coldest_temperature, flat_benefits
from sapopt.kernels.blocks import in_blocks

if TYPE_CHECKING:
    from sapopt.dynamics.copies.model import SyntheticSwitching

_DAMPING = 0.3
"""At 1 the descent of `multi-beam` stands still 2 % above what it comes to at 0.2 to 0.5."""

_PARTS = 4
"""Usages that are added up at the end: threads that may soften paths at the same time."""


@dataclass(frozen=True, eq=False)
class GroupPaths:
    """Path oracle (`sapopt.dynamics.paths.oracles.SoftPathOracle`, `FirstValueOracle`, `SteppingOracle`) of copies.

    Its prices are those of the tasks, and then of the agents' places, (T, m + n).

    Attributes
    ----------
    benefits : Benefits
        The window's.
    dynamics : SyntheticSwitching
    state : (n,) int array or None
        Real tasks held before the first step, -1 for none; None makes the first step free.
    groups : sapopt.dynamics.copies.groups_kernels.Groups
        Both as the kernels read them.
    group : (n,) int array
        Number of every agent's group.
    """

    benefits: Benefits
    dynamics: SyntheticSwitching
    state: IntArray | None
    groups: kernels.Groups
    group: IntArray

    @classmethod
    def of(cls, benefits: Any, dynamics: SyntheticSwitching, state: IntArray | None) -> GroupPaths:
        """The oracle of a window."""
        window = Benefits(benefits)
        indptr, indices, data, (T, n, m) = flat_benefits(window)
        _, group = np.unique(dynamics.real_agents(n), return_inverse=True)
        G, size = int(group.max()) + 1, np.bincount(group)
        order = np.argsort(group, kind="stable")
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n) - np.repeat(np.cumsum(size) - size, size)
        members = np.full((G, int(size.max())), -1, dtype=np.int64)
        members[group, rank] = np.arange(n)
        row = np.repeat(np.arange(T * n), np.diff(indptr))
        step, agent = np.divmod(row, n)
        key, entry = np.unique((step * G + group[agent]) * m + indices, return_inverse=True)
        values = np.zeros((len(key), int(size.max())))
        values[entry, rank[agent]] = data
        bounds = np.searchsorted(key, np.arange(T * G + 1) * m)
        real = np.ascontiguousarray(dynamics.real_tasks(m), dtype=np.int64)
        made = kernels.Groups(
            size.astype(np.int64), members, bounds.astype(np.int64), (key % m).astype(np.int32), values, real,
            int(real.max()) + 1, np.bincount(real)[real] > 1, float(dynamics.cost), float(dynamics.forfeit),
            bool(dynamics.idle_is_free), bool(dynamics.needs_sight), _start(state, n, int(real.max()) + 1),
        )  # fmt: skip
        return cls(window, dynamics, state, made, group.astype(np.int64))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m + n) of the window: tasks and places."""
        T, n, m = self.benefits.shape
        return T, n, m + n

    @property
    def scale(self) -> float:
        """Typical size of a benefit: root mean square of the finite entries that are not 0 (1 if there are none)."""
        data = self.groups.data
        return root_mean_square(data[data != 0.0])

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`: below it the weight of two moves leaves the range of floats."""
        data = self.groups.data
        highest = float(np.max(data[np.isfinite(data)], initial=0.0))
        return coldest_temperature(self.groups.cost + max(self.groups.forfeit, 1e-2) * highest)

    @property
    def damping(self) -> float:
        """Of the smooth descent: a copy pays for its task and its place, and its fellows pay the same."""
        return _DAMPING

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan of all agents: (T, 2 n), first their tasks, then the columns of the places they take."""
        T, n, columns = self.shape
        values, plan = np.empty(n), np.empty((T, 2 * n), dtype=np.int64)
        self._in_blocks(kernels.paths, self._prices(prices), values, plan)
        return values, plan

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and tasks (T,) of one agent; a price of +inf forbids a task at a step."""
        out = np.empty(self.shape[0], dtype=np.int64)
        value = kernels.path(np.int64(agent), self.group[agent], self.groups, self._prices(prices), out)
        return float(value), out

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count.

        The first step is the rule's own, with the agent's own benefit.
        """
        onward = np.empty((len(self.groups.size), self.groups.real_count + 2))
        self._in_blocks(kernels.second_values, self._prices(prices), onward)
        first = dense_step(self.benefits.step(0))
        real, none = self.groups.real, self.groups.real_count
        later = onward[:, real][self.group]
        if self.groups.needs_sight:
            later = np.where(first > 0, later, onward[self.group, none][:, None])
        return np.asarray(first + self.dynamics.charges(first, self.state) + later)

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m + n) at `prices`, which must be finite.

        Not numbers where the weights of all that a group may hold vanish beside those of forbidden pairs.
        """
        T, n, columns = self.shape
        p = self._prices(prices)
        m = columns - n
        # Every agent holds one task at every step, so what all tasks of a step cost alike changes no choice.
        alike = p[:, :m].min(axis=1)
        p = p.copy()
        p[:, :m] -= alike[:, None]
        parts = min(_PARTS, len(self.groups.size))
        values, usages = np.empty(n), np.zeros((parts, *p.shape))
        weight, pairs = np.exp(-p[:, :m] / temperature), np.empty((2, *self.groups.data.shape))
        in_blocks(
            soft_paths, parts, parts, self.groups, p, weight, float(temperature), pairs, values, usages,
            turns=5.0 * len(self.groups.size) * p.size,
        )  # fmt: skip
        return values - alike.sum(), usages.sum(axis=0)

    def after(self, assignment: IntArray) -> GroupPaths:
        """Paths of the later steps, once the agents held `assignment` (n,) at the first one."""
        T, n, _ = self.benefits.shape
        state = self.dynamics.held_after(self.benefits, assignment)
        groups = self.groups._replace(
            indptr=self.groups.indptr[len(self.groups.size) :], start=_start(state, n, self.groups.real_count)
        )
        return replace(self, benefits=self.benefits.slice(1, T), state=state, groups=groups)

    def _in_blocks(self, kernel: Any, prices: FloatArray, *out: Any) -> None:
        count = len(self.groups.size)
        in_blocks(kernel, count, self.groups, prices, *out, turns=2.0 * count * prices.size)

    def _prices(self, prices: FloatArray) -> FloatArray:
        return checked_prices(prices, self.shape, " (tasks, then places)")


def _start(state: IntArray | None, n: int, none: int) -> IntArray:
    if state is None:
        return np.full(n, none + 1, dtype=np.int64)
    return np.where(state < 0, none, state).astype(np.int64)
