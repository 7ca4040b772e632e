"""Rollouts of a policy: try several first assignments, continue each with one policy, and execute the best.

A policy without a lookahead gets one in this way. A policy with a lookahead (HAAL, the dual lookahead) gets a future
after its window: what the base policy would earn from the state in which the window ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook, Policy
from sapopt.solvers.base import EXTRAS, Extended, check_lookahead


@dataclass(frozen=True)
class RolloutPolicy:
    """At every step ask all policies, continue each answer with `base`, and execute the answer that earned most.

    Parameters
    ----------
    base : Policy
        Continues every answer; its own is among those tried. In a rollout it has no memory of earlier steps.
    candidates : sequence of Policy
        The other policies that are asked, for example ``HAAL(3)`` or ``DualLookahead(3)``.
    steps : int, optional
        Length of a rollout; all steps that are known if omitted. It takes so many steps of `base` for every
        distinct answer.

    Notes
    -----
    If the benefits are known, `base` is deterministic and decides from the outlook alone, and rollouts go to the end,
    the plan is worth at least that of `base`: the best rollout so far is tried again at every step (Bertsekas,
    *Rollout, Policy Iteration, and Distributed Reinforcement Learning*, 2020, section 2.3). Short rollouts guarantee
    nothing. Limits are kept in rollouts too; penalties and the rewards of teams are not seen there.

    Examples
    --------
    >>> from sapopt import solve
    >>> from sapopt.domains.instances import instance
    >>> from sapopt.solvers import HAAL, AssignmentPolicy, RolloutPolicy, energy_price
    >>> problem = instance("power", seed=1, steps=5)
    >>> base = AssignmentPolicy(energy_price)
    >>> bool(solve(problem, RolloutPolicy(base, [HAAL(3)])).value >= solve(problem, base).value)
    True
    """

    base: Policy
    candidates: Sequence[Policy] = ()
    steps: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "candidates", tuple(self.candidates))
        for policy in (self.base, *self.candidates):
            if not isinstance(policy, Policy):
                raise ValueError(
                    f"RolloutPolicy is made of policies, which decide step by step, not {policy!r}"
                )
        if self.steps is not None:
            check_lookahead(self.steps, "steps")

    @property
    def takes(self) -> frozenset[str]:
        """What all its policies take."""
        return EXTRAS.intersection(
            *(
                policy.takes if isinstance(policy, Extended) else ()
                for policy in (self.base, *self.candidates)
            )
        )

    @property
    def name(self) -> str:
        """Name with options."""
        asked = "".join(f", {policy.name}" for policy in self.candidates)
        far = "" if self.steps is None else f", steps={self.steps}"
        return f"RolloutPolicy({self.base.name}{asked}{far})"

    def begin(self, problem: SAP, rng: np.random.Generator) -> list[Any]:
        """The memories of all policies."""
        return [policy.begin(problem, rng) for policy in (self.base, *self.candidates)]

    def act(self, outlook: Outlook, memory: list[Any]) -> tuple[IntArray, list[Any]]:
        """The answer whose rollout earns most; the first among equals, the base policy's before all."""
        answers: list[IntArray] = []
        after = []
        for policy, remembered in zip((self.base, *self.candidates), memory, strict=True):
            tasks, remembered = policy.act(outlook, remembered)
            after.append(remembered)
            if not any(np.array_equal(tasks, other) for other in answers):
                answers.append(tasks)
        if len(answers) == 1:
            return answers[0], after
        return answers[int(np.argmax([self._worth(outlook, tasks) for tasks in answers]))], after

    def _worth(self, outlook: Outlook, tasks: IntArray) -> float:
        """Value of an assignment and of what the base policy makes of the steps after it; -inf at a dead end."""
        problem = outlook.problem
        stop = outlook.end if self.steps is None else min(outlook.k + 1 + self.steps, outlook.end)
        memory = self.base.begin(problem, np.random.default_rng(0))
        total = 0.0
        while True:
            outlook.check()
            total += _value(outlook, tasks)
            k = outlook.k + 1
            if k >= stop or total == -np.inf:
                return total
            if outlook.rules is not None:
                outlook = replace(outlook, rules=outlook.rules.ledger.after(k - 1, tasks).rules(k))
            outlook = replace(outlook, k=k, state=problem.transition(k - 1, outlook.state, tasks))
            try:
                tasks, memory = self.base.act(outlook, memory)
            except InfeasibleError:
                return -np.inf


def _value(outlook: Outlook, tasks: IntArray) -> float:
    """What an assignment earns at the outlook's step, by the benefits known or forecast."""
    held = outlook.benefits(1).at(tasks[None])[0]
    return float((held + outlook.model.handover_at(outlook.k, outlook.state, tasks)).sum())
