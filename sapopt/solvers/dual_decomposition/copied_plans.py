"""Plans for agents that are copies of one another: those of single agents, near the best plan so far.

At any plan there are prices of the copies' places at which no two copies of a group would swap their tasks. With them
the copies may be taken for alike (see `sapopt.dynamics.copies.groups`): a plan is then worth at least what it really
is, and this plan exactly that. So sweeps and networks of windows, which know of single agents only, move from there;
what they find is put into its best order, and scored by the rule.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.copies.groups import GroupPaths
from sapopt.solvers.dual_decomposition.network_plans.arrays import Arrays
from sapopt.solvers.dual_decomposition.network_plans.path_sweeps import sweep_by_arrays
from sapopt.solvers.dual_decomposition.network_plans.window_search import Effort, improved
from sapopt.solvers.dual_decomposition.oracle_plans import OraclePlans
from sapopt.solvers.dual_decomposition.plans import Found, Search, path_sweeps

_EFFORT = Effort(10, 8_000)
"""Windows of a round; on longer ones the plan leaves the place where the copies' prices hold."""


@dataclass(frozen=True, eq=False)
class CopiedPlans(OraclePlans):
    """Plans by the paths of groups (a `PlanBuilder`).

    Attributes
    ----------
    threads : int
        Windows solved at the same time.
    """

    threads: int = 1

    def rolling(self, search: Search) -> Iterator[Found]:
        """A rolling assignment, in the best order. Another one with repricing gains less than sweeps in that time."""
        for phase, plan in super().rolling(search):
            yield phase, self.tidied(plan)
            return

    def sweep(
        self,
        plan: IntArray,
        prices: FloatArray,
        rng: np.random.Generator,
        seconds_left: Callable[[], float] = lambda: math.inf,
    ) -> IntArray:
        """See `PlanBuilder`."""
        if not self._can_be_alike:
            return self.tidied(super().sweep(plan, prices, rng, seconds_left))
        moved = sweep_by_arrays(
            self.alike(plan), self.kept(plan), prices[:, : self.problem.m], rng, seconds_left
        )
        return self.tidied(moved)

    def improve(self, search: Search, turn: int) -> Iterator[Found]:
        """Sweeps and networks of windows by turns."""
        if turn % 2 == 0 or not self._can_be_alike:
            yield from path_sweeps(search, self)
            return
        plans = improved(
            self.alike(search.best), self.kept(search.best), search.settled_prices[:, : self.problem.m], _EFFORT,
            turn // 2 % 2 * _EFFORT.length // 2, search.rng, threads=self.threads,
            seconds_left=lambda: search.seconds_left,
        )  # fmt: skip
        for plan in plans:
            yield f"windows of {_EFFORT.length} steps", self.tidied(plan)

    @property
    def _paths(self) -> GroupPaths:
        assert isinstance(self.oracle, GroupPaths)
        return self.oracle

    @property
    def _can_be_alike(self) -> bool:
        """Whether copies that are alike would be charged by a plain switching cost."""
        rule = self._paths.groups
        return rule.forfeit == 0.0 and not rule.needs_sight and not rule.shared.any()

    def alike(self, plan: IntArray) -> Arrays:
        """Single agents whose plans are worth at least what they are really worth, and `plan` (T, n) exactly that.

        Less the sum of the prices of places, and what idle copies are worth then.
        """
        groups, problem = self._paths.groups, self.problem
        T, n, G = problem.T, problem.n, len(groups.size)
        places = self._place_prices(plan)  # (T, G, most), +inf beyond the group's size
        row = np.repeat(np.arange(T * G), np.diff(groups.indptr[: T * G + 1]))
        flat = places.reshape(T * G, -1)
        worth = (groups.data - flat[row]).max(axis=1) + flat.min(axis=1)[row]
        rows = (np.arange(T)[:, None] * G + self._paths.group).ravel()
        length = (groups.indptr[1:] - groups.indptr[:-1])[rows]
        indptr = np.concatenate([[0], np.cumsum(length)])
        entry = np.repeat(groups.indptr[rows] - indptr[:-1], length) + np.arange(indptr[-1])
        start = problem.initial_assignment
        return Arrays(
            indptr.astype(np.int64), groups.indices[entry], worth[entry], T, n, problem.m, groups.cost,
            np.zeros((0, 0)), groups.idle_is_free, np.full(n, -1) if start is None else np.asarray(start, np.int64),
        )  # fmt: skip

    def kept(self, plan: IntArray) -> IntArray:
        """The same sets of tasks, in an order in which a task that a group keeps stays on its copy."""
        group, out = self._paths.group, plan.copy()
        before = self.problem.initial_assignment
        for k in range(len(plan)):
            if before is not None:
                holder = np.full(self.problem.m, -1)
                holder[before] = np.arange(len(before))
                copy = holder[plan[k]]
                stays = (copy >= 0) & (group[copy] == group)
                out[k, copy[stays]] = plan[k, stays]
                vacant = np.ones(len(group), dtype=bool)
                vacant[copy[stays]] = False
                places, movers = np.flatnonzero(vacant), np.flatnonzero(~stays)
                places = places[np.argsort(group[places], kind="stable")]
                movers = movers[np.argsort(group[movers], kind="stable")]
                out[k, places] = plan[k, movers]
            before = out[k]
        return out

    def tidied(self, plan: IntArray) -> IntArray:
        """The same sets of tasks, each at every step on the copies for which they are worth most together."""
        groups, out = self._paths.groups, plan.copy()
        worth = self._worth(plan)
        own = np.einsum("tgrr->tgr", worth)
        # Ranks that fall where the benefits do are in order already; the rest is few small assignments.
        for k, g in np.argwhere(self._swaps(worth, own)):
            size = groups.size[g]
            members = groups.members[g, :size]
            values = worth[k, g, :size, :size]
            if np.isfinite(values).all():
                copies, tasks = linear_sum_assignment(values, maximize=True)
                out[k, members[copies]] = plan[k, members[tasks]]
        return out

    def _worth(self, plan: IntArray) -> FloatArray:
        """Benefit [k, g, r, s] for the r-th copy of group g of the task of the s-th one, -inf beyond its size."""
        groups = self._paths.groups
        G, most = groups.members.shape
        out = np.full((len(plan), G, most, most), -np.inf)
        order = np.arange(plan.shape[1])
        rank = np.empty(plan.shape[1], dtype=np.int64)
        for r in range(most):
            rank[groups.members[groups.size > r, r]] = r
        size = groups.size[self._paths.group]
        for shift in range(most):
            other = groups.members[self._paths.group, (rank + shift) % size]
            values = self.problem.benefits.at(plan[:, other])
            fits = shift < size
            out[:, self._paths.group[fits], rank[fits], rank[other[fits]]] = values[:, order[fits]]
        return out

    def _swaps(self, worth: FloatArray, own: FloatArray) -> np.ndarray:
        """Whether some two copies (T, G) of a group would gain by a swap."""
        with np.errstate(invalid="ignore"):
            gain = worth + worth.swapaxes(2, 3) - own[..., :, None] - own[..., None, :]
        return np.asarray((np.nan_to_num(gain, nan=-1.0) > 1e-12).any(axis=(2, 3)))

    def _place_prices(self, plan: IntArray) -> FloatArray:
        """Prices (T, G, most) at which no copy wants the task of a fellow, +inf beyond the size of a group.

        Longest paths in the graph whose arc from r to q is what q would gain over r by the task of r: the least prices
        and the greatest, and their mean.
        """
        worth = self._worth(plan)
        own = np.einsum("tgrr->tgr", worth)
        with np.errstate(invalid="ignore"):
            gain = np.nan_to_num(worth.swapaxes(2, 3) - own[..., :, None], nan=-np.inf, neginf=-np.inf)
        low = np.zeros(own.shape)
        high = np.zeros(own.shape)
        for _ in range(own.shape[2]):
            low = np.maximum(low, (low[..., :, None] + gain).max(axis=2))
            high = np.minimum(high, (high[..., None, :] - gain).min(axis=3))
        beyond = np.arange(own.shape[2]) >= self._paths.groups.size[:, None]
        return np.where(beyond, np.inf, 0.5 * (low + high))
