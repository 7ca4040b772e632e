"""Transitions that hold a random part, and policies compared over runs (Holder 2024, equation 2.2 and section 7.3).

A `SAP` stays deterministic: its transition is what planners and policies reckon with, and what bounds are proven for.
The world in which a policy is played may be another: a `Chance` draws the state that really follows. A policy sees that
state before its next decision; it never sees what is still to be drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.data.windows import WindowSums
from sapopt.problem.sap import SAP
from sapopt.running.outlook import Outlook, Policy

Seed = int | Sequence[int]
"""What numpy takes for a seed: a whole number of at least 0, or several."""


@runtime_checkable
class Chance(Protocol):
    """The random part of a transition."""

    def transition(
        self, problem: SAP, k: int, state: Any, assignment: IntArray, rng: np.random.Generator
    ) -> Any:
        """A draw of the state after `assignment` was held at step k; ``problem.transition`` is the one reckoned with.

        `rng` belongs to the step alone, so the same seed brings the same luck whatever was decided before: policies
        are compared on equal draws. Draw for all agents, and not only for those whom it concerns, to keep that true.
        """


@dataclass(frozen=True, eq=False)
class Played:
    """What a policy did in one run, and what came of it.

    Attributes
    ----------
    plan : ndarray of int64, shape (T, n)
    rewards : ndarray of float64, shape (T, n)
        Benefit and handover of every agent, in the states that were drawn.
    """

    plan: IntArray
    rewards: FloatArray

    @property
    def value(self) -> float:
        """The sum of all rewards."""
        return float(self.rewards.sum())


@dataclass(frozen=True, eq=False)
class Runs:
    """The values that a policy earned in several runs.

    Attributes
    ----------
    name : str
    values : ndarray of float64, shape (runs,)
    """

    name: str
    values: FloatArray

    @property
    def mean(self) -> float:
        """Mean value of a run."""
        return float(self.values.mean())

    @property
    def error(self) -> float:
        """Standard error of the mean."""
        return _error(self.values)

    def less(self, other: Runs) -> tuple[float, float]:
        """By how much the mean exceeds that of another policy in the same runs, and the standard error of that.

        Runs are paired: both met the same luck, so the error is usually far smaller than those of the means.

        Raises
        ------
        ValueError
            If the other has not as many runs.
        """
        if len(other.values) != len(self.values):
            raise ValueError(f"other has {len(other.values)} runs, this one {len(self.values)}")
        difference = self.values - other.values
        return float(difference.mean()), _error(difference)


def follow(problem: SAP, chance: Chance | None, seed: Seed, k: int, state: Any, assignment: IntArray) -> Any:
    """The state after a step: drawn by `chance` with the generator of `seed` and `k`, or the problem's own if None."""
    if chance is None:
        return problem.transition(k, state, assignment)
    return chance.transition(problem, k, state, assignment, step_generator(seed, k))


def step_generator(seed: Seed, k: int) -> np.random.Generator:
    """The generator of step k in the run of a seed."""
    parts = [seed] if isinstance(seed, (int, np.integer)) else list(seed)
    return np.random.default_rng([*parts, k])


def play(problem: SAP, decide: Policy | IntArray, chance: Chance | None = None, seed: Seed = 0) -> Played:
    """Play a policy, or a plan made beforehand, in one run.

    Parameters
    ----------
    problem : SAP
        What the policy reckons with.
    decide : Policy or array_like of int, shape (T, n)
        A plan is executed whatever happens.
    chance : Chance, optional
        What draws the states; without it nothing is random.
    seed : int or sequence of int
        Of the draws. The policy has a generator of its own, so its random numbers change nobody's luck.

    Returns
    -------
    Played
        Without `chance`, ``problem.evaluate(played.plan).value`` is its value.

    Raises
    ------
    ValueError
        If a plan does not fit the problem, or a pair is forbidden in the state that was drawn; or if the problem has
        capacities, idleness or limits.
    """
    if not problem.is_plain:
        raise ValueError("problem: runs by chance know no capacities, idleness or limits; leave them out")
    policy = decide if isinstance(decide, Policy) else None
    plan = np.empty((problem.T, problem.n), dtype=np.int64) if policy else problem.check_plan(decide)
    rewards = np.empty((problem.T, problem.n))
    parts = [seed] if isinstance(seed, (int, np.integer)) else list(seed)
    memory = policy.begin(problem, np.random.default_rng([*parts, problem.T])) if policy else None
    windows, parking = WindowSums(problem.benefits), np.arange(problem.m)
    state = problem.initial_state()
    for k in range(problem.T):
        if policy:
            windows.forget(before=k)
            tasks, memory = policy.act(Outlook(k, problem.T, state, problem, windows, parking), memory)
            plan[k] = problem.check_assignment(tasks, k)
        held = problem.benefits.slice(k, k + 1).at(plan[k : k + 1])[0]
        rewards[k] = held + problem.model.handover_at(k, state, plan[k])
        if not np.isfinite(rewards[k]).all():
            i = int(np.flatnonzero(~np.isfinite(rewards[k]))[0])
            names = problem.naming
            raise ValueError(
                f"{names.agent(i)} may not take {names.task(plan[k, i])} at {names.step(k)} (the pair is forbidden)"
            )
        state = follow(problem, chance, seed, k, state, plan[k])
    return Played(plan, rewards)


def over_runs(
    problems: SAP | Callable[[int], SAP],
    policies: Iterable[Policy],
    chance: Chance | None,
    runs: int = 20,
    seed: int = 0,
) -> list[Runs]:
    """Compare policies over runs, all of them with the same luck in each run.

    Parameters
    ----------
    problems : SAP, or callable
        One problem, or ``problems(run)``: a problem for each run.
    policies : iterable of Policy
    chance : Chance or None
    runs : int
        At least 2, for a standard error needs two.
    seed : int

    Returns
    -------
    list of Runs
        One for each policy.

    Raises
    ------
    ValueError
        If there are fewer than two runs, or no policies.
    """
    compared = list(policies)
    if runs < 2:
        raise ValueError(f"runs must be at least 2, got {runs}: a standard error needs two")
    if not compared:
        raise ValueError("policies: there is none to compare")
    values = np.empty((len(compared), runs))
    for run in range(runs):
        problem = problems if isinstance(problems, SAP) else problems(run)
        for p, policy in enumerate(compared):
            values[p, run] = play(problem, policy, chance, (seed, run)).value
    return [Runs(policy.name, values[p]) for p, policy in enumerate(compared)]


def _error(values: FloatArray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else float("nan")
