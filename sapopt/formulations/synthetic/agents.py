"""Agents that do several tasks at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray, index_array
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.dynamics.switching.model import SwitchingCost
from sapopt.formulations.bounds import largest_benefits
from sapopt.formulations.dual import ascend
from sapopt.formulations.synthetic.copies import (
    Forecast,
    check_decay,
    copied_agents,
    copied_labels,
    counts,
    ranks,
    repeated,
)
from sapopt.formulations.synthetic.repeated import RepeatedPaths
from sapopt.problem.result import Evaluation
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Bound


@dataclass(frozen=True, eq=False)
class SyntheticAgents:
    """A SAP whose agents are copies; made by `synthetic_agents`.

    Attributes
    ----------
    base : SAP
        The problem of the real agents.
    problem : SAP
        The plain problem of their copies: solve this one. Its first ``base.m`` tasks are those of `base`, the rest
        idle tasks of no benefit.
    copies : ndarray of int, shape (base.n,)
        Number of copies of every agent; they are adjacent.
    decay : float
        The r-th copy (from 0) earns ``decay ** r`` of the benefit.
    """

    base: SAP
    problem: SAP
    copies: IntArray
    decay: float

    @property
    def agent_of(self) -> IntArray:
        """Real agent of every copy, shape ``(problem.n,)``."""
        return np.repeat(np.arange(self.base.n), self.copies)

    @property
    def weights(self) -> FloatArray:
        """Share of the benefit that every copy earns, shape ``(problem.n,)``."""
        return np.asarray(self.decay ** ranks(self.copies), dtype=np.float64)

    def original(self, plan: Any) -> IntArray:
        """Real agent of every task at every step, shape ``(T, problem.m)``, -1 for none: the way back."""
        tasks = self.problem.check_plan(plan)
        owners = np.full((self.problem.T, self.problem.m), -1, dtype=np.int64)
        np.put_along_axis(owners, tasks, np.broadcast_to(self.agent_of, tasks.shape), axis=1)
        return owners

    def tasks_of(self, plan: Any) -> list[list[tuple[int, ...]]]:
        """Tasks of `base` that every real agent holds at every step: ``tasks_of(plan)[k][i]``."""
        owners = self.original(plan)[:, : self.base.m]
        return [[tuple(np.flatnonzero(row == i).tolist()) for i in range(self.base.n)] for row in owners]

    def plan(self, owners: Any) -> IntArray:
        """A plan of the copies in which every agent holds the given tasks, ordered so that the value is greatest.

        The first copy, which earns most, takes the task that is worth most, and so on; no other order is worth more,
        because handovers do not depend on it.

        Parameters
        ----------
        owners : array_like of int, shape (T, problem.m) or (T, base.m)
            Real agent of every task, -1 for none. Copies that are left over wait on idle tasks, if possible on those
            that their agent held before.

        Raises
        ------
        ValueError
            If an agent has more tasks than copies, or a copy finds no idle task.
        """
        real = index_array(owners, "owners")
        T, m = self.problem.T, self.problem.m
        if real.shape not in ((T, m), (T, self.base.m)):
            raise ValueError(f"owners must have shape {(T, m)} or {(T, self.base.m)}, got {real.shape}")
        if real.min() < -1 or real.max() >= self.base.n:
            raise ValueError(f"owners must hold agents 0..{self.base.n - 1}, or -1 for none")
        full = np.full((T, m), -1, dtype=np.int64)
        full[:, : real.shape[1]] = real
        first = np.concatenate([[0], np.cumsum(self.copies)])
        out = np.empty((T, self.problem.n), dtype=np.int64)
        idle_before = np.full(m, -1, dtype=np.int64)
        for k in range(T):
            owner = self._with_idle(full[k], idle_before, k)
            worth = self._worth(k, owner)
            order = np.lexsort((np.arange(m), -worth, owner))
            held = order[owner[order] >= 0]  # agent by agent, best task first
            out[k] = held
            assert len(held) == first[-1]
            idle_before = owner
        return out

    def tidied(self, plan: Any) -> IntArray:
        """The same sets of tasks in the best order; never worth less."""
        return self.plan(self.original(plan))

    def evaluate(self, owners: Any) -> Evaluation:
        """Value of the real agents' sets of tasks, scored by `SAP.evaluate` in the best order (see `plan`)."""
        return self.problem.evaluate(self.plan(owners))

    def handovers(self, plan: Any) -> int:
        """How often a real agent takes up a task that it did not hold before (idle tasks do not count)."""
        owners = self.original(plan)[:, : self.base.m]
        return int(((owners[1:] >= 0) & (owners[1:] != owners[:-1])).sum())

    def forecast(self, forecast: Forecast) -> Forecast:
        """A forecast of the base problem's benefits as one of this problem's."""
        extra = self.problem.m - self.base.m

        def copied(k: int, steps: int) -> Benefits:
            return copied_agents(Benefits(forecast(k, steps)), self.copies, self.decay, extra)

        return copied

    def alike(self, reference: Any = None) -> tuple[SAP, float]:
        """A problem of identical copies that is worth at least as much, agent-local, and so open to every method.

        Returns
        -------
        problem : SAP
            Every copy has the same benefits, and is charged for its own changes of task (`SwitchingCost`).
        constant : float
            For every plan of the copies, its value here is at most the value of the same sets of tasks in the returned
            problem, copies suitably ordered, plus `constant`. Hence ``bound(problem).value + constant`` is an upper
            bound of this problem, and plans of either problem are plans of the other.

        Parameters
        ----------
        reference : array_like of int, shape (T, problem.n), optional
            A plan near which the bound is to be tight. Without it, every copy earns the full benefit.

        Notes
        -----
        Two facts. (1) Identical copies may be renamed at will: keep every task that an agent holds twice in a row on
        the same copy, and the copies' own changes are as many as the agent's, so the two charges agree. (2) Price the
        rank r of agent i at step k by any nu: as every rank is taken exactly once,
        ``sum_r decay^r b_(r) <= sum_j max_r(decay^r b_j - nu_r) + sum_r nu_r``, with equality where the prices support
        the order of the reference plan.
        """
        base = self.base
        extra = self.problem.m - base.m
        initial = self.problem.initial_assignment
        rule = self.base.model.switching()
        assert rule is not None
        dynamics = SwitchingCost(rule.cost, idle_is_free=rule.idle_is_free)
        if reference is None or self.decay == 1.0:
            return SAP(copied_agents(base.benefits, self.copies, 1.0, extra), dynamics, initial), 0.0
        held = np.sort(-self._held(reference), axis=2)  # (T, n, most copies), best first
        steps: list[Any] = []
        constant = 0.0
        for k in range(base.T):
            values, total = self._rank_priced(base.benefits.step(k), -held[k])
            constant += total
            steps.append(sp.csr_array(repeated(values, self.copies, extra)))
        return SAP(steps, dynamics, initial), constant

    def bound(self, reference: Any = None, *, time_limit: float | None = None) -> Bound:
        """A proven upper bound of this problem, through `alike`; identical copies share their path recursions.

        Parameters
        ----------
        reference : array_like of int, shape (T, problem.n), optional
            See `alike`: the best plan known makes the tightest bound.
        time_limit : float, optional
            Seconds; the best bound so far is returned, and it is as valid as any.

        Returns
        -------
        Bound
            Without prices: they would prove the bound of the problem of identical copies, not of this one.
        """
        problem, constant = self.alike(reference)
        count = int(self.copies[0])
        start = problem.initial_state()
        if start is None and (self.copies == count).all():
            first = np.cumsum(self.copies) - self.copies
            one = Benefits([_rows(problem.benefits.step(k), first) for k in range(problem.T)])
            single = path_oracle(problem.model.bind(one), one, None)
            oracle: Any = RepeatedPaths(single, count)
        else:
            oracle = path_oracle(problem.model, problem.benefits, start)
        found = ascend(oracle, time_limit=time_limit)
        value = float(found.bound) + constant
        padding = 1e-12 * max(sum(largest_benefits(problem)), abs(value), abs(constant))
        return Bound(value + padding, None, "Lagrangian dual of identical copies with priced ranks")

    def _held(self, reference: Any) -> FloatArray:
        """Benefits of the tasks of every real agent, padded with 0 to the greatest number of copies, (T, n, most)."""
        plan = self.tidied(reference)
        inside = plan < self.base.m
        out = np.zeros((self.problem.T, self.base.n, int(self.copies.max())))
        agent, rank = self.agent_of, ranks(self.copies)
        for k in range(self.problem.T):
            step = dense_step(self.base.benefits.step(k))
            here = inside[k]
            out[k, agent[here], rank[here]] = step[agent[here], plan[k][here]]
        return out

    def _rank_priced(self, step: Any, held: FloatArray) -> tuple[Any, float]:
        """Benefits (n, m) in the place of all ranks, sparse, and the sum of the rank prices."""
        values = sp.csr_array(step, dtype=np.float64, copy=True)
        most = held.shape[1]
        weight = self.decay ** np.arange(most)
        # Two neighbouring ranks are worth the same at a benefit between those that hold them in the reference.
        middle = np.maximum(0.5 * (held[:, :-1] + held[:, 1:]), 0.0)
        drop = middle * (weight[:-1] - weight[1:])  # nu_r - nu_{r+1}
        valid = np.arange(1, most)[None, :] < self.copies[:, None]
        drop = np.where(valid, drop, 0.0)
        nu = np.concatenate([np.cumsum(drop[:, ::-1], axis=1)[:, ::-1], np.zeros((len(drop), 1))], axis=1)
        usable = np.arange(most)[None, :] < self.copies[:, None]
        rows = np.repeat(np.arange(len(held)), np.diff(values.indptr))
        ranked = values.data[:, None] * weight[None, :] - nu[rows]
        values.data = np.where(usable[rows], ranked, -np.inf).max(axis=1)
        # A pair of no benefit is worth max_r(-nu_r) = 0: the price of the last rank is 0, and none is negative.
        return values, float(np.where(usable, nu, 0.0).sum())

    def _with_idle(self, owner: IntArray, before: IntArray, k: int) -> IntArray:
        """Owners with idle tasks for the copies that have none."""
        missing = self.copies - np.bincount(owner[owner >= 0], minlength=self.base.n)
        if (missing < 0).any():
            i = int(np.argmin(missing))
            raise ValueError(
                f"owners: {self.base.naming.agent(i)} has {self.copies[i] - missing[i]} tasks at "
                f"{self.base.naming.step(k)} and {self.copies[i]} copies"
            )
        if not missing.any():
            return owner
        out = owner.copy()
        idle = np.arange(self.base.m, self.problem.m)
        for j in idle[(out[idle] < 0) & (before[idle] >= 0)]:
            if missing[before[j]] > 0:
                out[j] = before[j]
                missing[before[j]] -= 1
        free = idle[out[idle] < 0]
        if len(free) < missing.sum():
            raise ValueError(
                f"owners: {missing.sum()} copies have no task at step {k}; there are too few idle ones"
            )
        out[free[: missing.sum()]] = np.repeat(np.arange(self.base.n), missing)
        return out

    def _worth(self, k: int, owner: IntArray) -> FloatArray:
        """Benefit of every task for its owner, shape (m,)."""
        out = np.zeros(self.problem.m)
        busy = np.flatnonzero(owner[: self.base.m] >= 0)
        out[busy] = dense_step(self.base.benefits.step(k))[owner[busy], busy]
        return out


def synthetic_agents(
    problem: SAP, copies: Any, decay: float = 1.0, *, idle_tasks: int | None = None
) -> SyntheticAgents:
    """Let every agent do several tasks at once.

    Parameters
    ----------
    problem : SAP
        With a `SwitchingCost` of one number, charged for every task that a real agent takes up.
    copies : int or array_like of int, shape (n,)
        How many tasks an agent does at most.
    decay : float
        The r-th task of an agent (from 0, best first) earns ``decay ** r`` of its benefit; above 0, at most 1.
    idle_tasks : int, optional
        Tasks of zero benefit that are appended; by default one per copy, so that each of them can idle.

    Raises
    ------
    ValueError
        If the problem has another dynamics, or an argument is out of range.

    Notes
    -----
    Every copy holds exactly one task, so idle tasks count as tasks: under the strict rule taking one up is charged like
    any other. An initial assignment is that of the first copies; the others start on the first idle tasks.
    """
    rule = problem.model.switching()
    if rule is None or rule.uniform_cost is None:
        raise ValueError("problem: synthetic_agents takes a SwitchingCost of one number as dynamics")
    count = counts(copies, problem.n, "agent")
    check_decay(decay)
    total = int(count.sum())
    extra = total if idle_tasks is None else int(idle_tasks)
    if extra < 0 or problem.m + extra < total:
        raise ValueError(
            f"idle_tasks: {total} copies of agents need as many tasks, there are {problem.m}; append at least "
            f"{max(0, total - problem.m)}"
        )
    initial = None
    if problem.initial_assignment is not None:
        others = np.flatnonzero(ranks(count) > 0)
        if len(others) > extra:
            raise ValueError(f"idle_tasks: {len(others)} copies start on idle tasks, there are {extra}")
        initial = np.repeat(problem.initial_assignment, count)
        initial[others] = problem.m + np.arange(len(others))
    owner = np.repeat(np.arange(problem.n), count)
    copied = SAP(
        copied_agents(problem.benefits, count, decay, extra),
        SyntheticSwitching(rule.uniform_cost, agent_of=owner, idle_is_free=rule.idle_is_free),
        initial,
        agents=copied_labels(problem.agents, count),
        tasks=None if problem.tasks is None else [*problem.tasks, *(f"idle {i}" for i in range(extra))],
        times=problem.times,
    )
    return SyntheticAgents(problem, copied, count, float(decay))


def _rows(step: Any, rows: IntArray) -> Any:
    """Some rows of a step, sparse or dense as it is."""
    return step[rows] if isinstance(step, np.ndarray) else sp.csr_array(sp.csr_array(step)[rows])
