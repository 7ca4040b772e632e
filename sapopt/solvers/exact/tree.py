"""Branch and price over stays: a proof for dense problems that a general solver does not get through.

Every node of the search tree closes some stays: those that start or end with an agent's step (the agent does not
change task there) or those that bridge it (it does); those that use a cell (step, agent, task), or that keep another
agent or task in it. The relaxation of a node begins from the last one solved. The node of the greatest bound comes
first, so the greatest bound in the queue is that of the whole problem. Branches are chosen by trying some.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.stays import Stays
from sapopt.solvers.exact.cuts import coefficients
from sapopt.solvers.exact.dive import dive
from sapopt.solvers.exact.master import Master, Relaxed

_TRIED = (24, 16, 8)
"""Branches that are tried at a node: near the root, where a good choice pays most, in the middle, and deeper down."""
_DIVES = 40
"""Nodes between two dives."""
_TRIAL = 60
"""Steps of the simplex method in a trial."""

Branch = tuple[str, int, int, int, bool]
"""("change", step, agent, -1, yes) or ("cell", step, agent, task, yes)."""


@dataclass(order=True)
class Node:
    """Part of the plans: those that keep to the branches. Sorted by falling bound."""

    rank: tuple[float, int]
    branches: tuple[Branch, ...] = field(compare=False)

    @property
    def bound(self) -> float:
        """No plan of this part is worth more."""
        return -self.rank[0]


class Tree:
    """A search that can be stopped at any time.

    Parameters
    ----------
    stays : Stays
        All that a plan better than the incumbent may use.
    begin : ndarray of int64
        Stays the relaxation begins with.
    bound : float
        Bound known already.
    found : callable
        ``found(plan) -> value of the incumbent``, told of every plan.
    target : callable
        ``target() -> value``: parts that cannot be worth more need no search.
    watch : callable
        ``watch(bound, nodes) -> stop?``, called after every node.
    polish : callable, optional
        ``polish(plan)``, given a plan now and then; `found` if omitted.
    expired : callable
        Whether the run is over; asked in the middle of a node.
    unit : float
        What stands for 1 in tolerances, see `sapopt.solvers.base.gap_unit`.
    """

    def __init__(
        self,
        stays: Stays,
        begin: IntArray,
        bound: float,
        found: Callable[[IntArray], float],
        target: Callable[[], float],
        watch: Callable[[float, int], bool],
        polish: Callable[[IntArray], object] | None = None,
        expired: Callable[[], bool] = lambda: False,
        unit: float = 1.0,
    ) -> None:
        self.stays = stays
        self.begin = begin
        self.found = found
        self.target = target
        self.watch = watch
        self.polish = polish or found
        self.expired = expired
        self.unit = unit
        self.cuts, self.right = coefficients(stays, [])
        self.count = itertools.count()
        self.queue = [Node((-bound, next(self.count)), ())]
        self.working: dict[int, float] = {}
        self.pruned = -np.inf
        self.nodes = 0
        self.next_dive = _DIVES
        self.rng = np.random.default_rng(0)
        self.stop = False
        self.change = threading.Condition()
        self.failure: BaseException | None = None

    @property
    def bound(self) -> float:
        """No plan over the stays is worth more, unless it is no better than the target."""
        with self.change:
            return self._bound()

    def _bound(self) -> float:
        waiting = [self.queue[0].bound] if self.queue else []
        return max([self.pruned, *waiting, *self.working.values()])

    def search(self, threads: int) -> float:
        """Search until nothing is left or `watch` says stop; returns the bound."""
        if threads == 1:
            self._work(0)
        else:
            helpers = [
                threading.Thread(target=self._work, args=(number,), daemon=True)
                for number in range(1, threads)
            ]
            for helper in helpers:
                helper.start()
            try:
                self._work(0)
            finally:
                self.stop = True
                with self.change:
                    self.change.notify_all()
                for helper in helpers:
                    helper.join()
        if self.failure is not None:
            raise self.failure
        return self.bound

    def _work(self, number: int) -> None:
        try:
            master = Master(self.stays, self.begin, self._over, self.unit)
            if len(self.right):
                master.cut(self.cuts, self.right)
            while True:
                node = self._next(number)
                if node is None:
                    return
                children = self._expand(master, node, number)
                with self.change:
                    for child in children:
                        heapq.heappush(self.queue, child)
                    del self.working[number]
                    self.nodes += 1
                    bound = self._bound()
                    self.change.notify_all()
                if number == 0 and self.watch(bound, self.nodes):
                    self.stop = True
        except BaseException as error:
            self.failure, self.stop = error, True

    def _over(self) -> bool:
        return self.stop or self.expired()

    def _next(self, number: int) -> Node | None:
        with self.change:
            while not self.stop:
                while self.queue and self.queue[0].bound <= self.target():
                    self.pruned = max(self.pruned, heapq.heappop(self.queue).bound)
                if self.queue:
                    node = heapq.heappop(self.queue)
                    self.working[number] = node.bound
                    return node
                if not self.working:
                    return None
                self.change.wait(0.1)
                if number == 0 and self.watch(self._bound(), self.nodes):
                    self.stop = True
        return None

    def _expand(self, master: Master, node: Node, number: int) -> list[Node]:
        """The two parts of a node; none if it is settled."""
        closed = self.closed(node.branches)
        relaxed = master.solve(closed, self.target())
        bound = min(node.bound, relaxed.bound)
        if relaxed.bound > self.target() and relaxed.whole:
            self.found(self.stays.plan_of(relaxed.stays[relaxed.x > 0.5]))
        if bound <= self.target() or relaxed.whole:
            with self.change:
                self.pruned = max(self.pruned, bound)
            return []
        if number == 0 and self.nodes >= self.next_dive:
            self.next_dive = self.nodes + _DIVES
            plan = dive(master, closed, lambda: -np.inf, self.rng, 0.2, self._over)
            if plan is not None:
                self.polish(plan)
            relaxed = master.solve(closed, self.target())
            if relaxed.bound <= self.target() or relaxed.whole:
                with self.change:
                    self.pruned = max(self.pruned, min(bound, relaxed.bound))
                return []
        tries = _TRIED[min(len(node.branches) // 4, len(_TRIED) - 1)]
        candidates = self._candidates(relaxed, tries)
        if not candidates:  # no plan, though the prices do not show it
            with self.change:
                self.pruned = max(self.pruned, bound)
            return []
        branch, bounds = self._choose(master, closed, relaxed, candidates)
        return [
            Node((-min(bound, limit), next(self.count)), (*node.branches, (*branch, yes)))
            for yes, limit in zip((True, False), bounds, strict=True)
        ]

    def closed(self, branches: tuple[Branch, ...]) -> np.ndarray:
        """Mask of the stays that the branches close."""
        out = np.zeros(len(self.stays), dtype=bool)
        for branch in branches:
            out |= self._closes(branch)
        return out

    def _closes(self, branch: Branch) -> np.ndarray:
        kind, k, i, j, yes = branch
        stays = self.stays
        mine = stays.agent == i
        if kind == "change":
            if yes:
                mask = mine & (stays.first < k) & (stays.stop > k)
            else:
                mask = mine & ((stays.first == k) | (stays.stop == k))
        else:
            there = (stays.first <= k) & (stays.stop > k)
            task = stays.task == j
            mask = there & (mine ^ task) if yes else there & mine & task
        out: np.ndarray = mask
        return out

    def _choose(
        self,
        master: Master,
        closed: np.ndarray,
        relaxed: Relaxed,
        candidates: list[tuple[str, int, int, int]],
    ) -> tuple[tuple[str, int, int, int], tuple[float, float]]:
        """The branch that lowers the bound most, and the bounds of its two parts."""
        basis = master.programme.basis
        best, best_score = None, -1.0
        limits = (relaxed.bound, relaxed.bound)
        size = max(self.unit, abs(relaxed.bound))
        for branch in candidates:
            parts = []
            for yes in (True, False):
                parts.append(
                    min(relaxed.bound, master.probe(closed | self._closes((*branch, yes)), basis, _TRIAL))
                )
            # By the size of the bound, so that no product under- or overflows.
            drop = [max(relaxed.bound - part, 1e-6 * self.unit) / size for part in parts]
            score = drop[0] * drop[1]
            if score > best_score:
                best, best_score, limits = branch, score, (parts[0], parts[1])
            if min(parts) <= self.target() or self._over():
                break  # one part is settled, and nothing is better; or there is no time to look on
        assert best is not None
        return best, limits

    def _candidates(self, relaxed: Relaxed, tries: int) -> list[tuple[str, int, int, int]]:
        """Changes and cells nearest to one half."""
        T, n, m = self.stays.shape
        used = relaxed.x > 1e-7
        chosen, x = relaxed.stays[used], relaxed.x[used]
        stays = self.stays
        first, agent = stays.first[chosen], stays.agent[chosen]
        change: FloatArray = np.bincount(first * n + agent, x, T * n).astype(np.float64)
        change[:n] = 0.0
        cell: FloatArray = np.zeros((T, n, m))
        for c, share in zip(chosen, x, strict=True):
            cell[stays.first[c] : stays.stop[c], stays.agent[c], stays.task[c]] += share
        out: list[tuple[str, int, int, int]] = []
        for k in _middle(change, 2 * tries // 3):
            out.append(("change", int(k) // n, int(k) % n, -1))
        for c in _middle(cell.ravel(), tries - len(out)):
            out.append(("cell", *(int(v) for v in np.unravel_index(c, cell.shape))))  # type: ignore[arg-type]
        return out


def _middle(share: FloatArray, count: int) -> IntArray:
    """Positions of the shares nearest to one half, whole ones left out."""
    near = np.minimum(share, 1.0 - share)
    order: IntArray = np.argsort(-near, kind="stable")[:count]
    return order[near[order] > 1e-6]
