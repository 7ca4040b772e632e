"""What the experiments of chapter 6 share: play any policy, assignment or not, and measure what it did."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sapopt import SAP, solve
from sapopt.learning import Environment, Network, load_network
from sapopt.learning.learner import own_choice
from sapopt.learning.observation import charge_of
from sapopt.learning.sampling import sample_episode
from sapopt.solvers import AssignmentPolicy

Player = Callable[[SAP], "Played"]


@dataclass(frozen=True)
class Played:
    """One episode.

    Attributes
    ----------
    value : float
        Sum of all rewards, conflicts shared.
    conflicts : float
        Share of the working agents whose task has another holder.
    charge : float
        Mean charge of all agents before all steps; 1 without batteries.
    alive : float
        Share of the agents that have charge at the end.
    duration : float
        Mean number of steps that an agent works on a task without a break.
    """

    value: float
    conflicts: float
    charge: float
    alive: float
    duration: float


def measure(problem: SAP, plan: np.ndarray) -> Played:
    """Score joint choices (T, n), which need not be assignments."""
    env = Environment(problem, conflicts_shared=True)
    value = 0.0
    shared, works, charges, alive = 0, 0, [], 1.0
    worked = np.zeros(plan.shape, bool)
    for k, tasks in enumerate(plan):
        level = _charge(problem, env.state)
        worked[k] = (problem.benefits.slice(k, k + 1).at(tasks[None])[0] > 0) & (level > 0)
        holders = np.bincount(tasks[worked[k]], minlength=problem.m)[tasks]
        shared += int((holders[worked[k]] > 1).sum())
        works += int(worked[k].sum())
        charges.append(level.mean())
        value += float(env.step(tasks).sum())
    alive = float((_charge(problem, env.state) > 0).mean())
    starts = worked.copy()
    starts[1:] &= ~(worked[:-1] & (plan[1:] == plan[:-1]))
    return Played(
        value, shared / max(works, 1), float(np.mean(charges)), alive, works / max(int(starts.sum()), 1)
    )


def _charge(problem: SAP, state: Any) -> np.ndarray:
    charge = charge_of(problem.model, state)
    return np.ones(problem.n) if charge is None else charge


def by_policy(policy: Any) -> Player:
    """A player that solves with a policy."""
    return lambda problem: measure(problem, solve(problem, policy).plan)


def by_generator(generator: Any) -> Player:
    """A player of alpha(generator)."""
    return by_policy(AssignmentPolicy(generator))


def by_iql(network: Network) -> Player:
    """Every agent takes what it values most."""

    def play(problem: SAP) -> Played:
        env = Environment(problem, conflicts_shared=True)
        plan = np.empty((problem.T, problem.n), np.int64)
        while not env.done:
            k = env.k
            seen, listed = env.observe(network.spec)
            plan[k] = own_choice(network.values(seen), listed, problem.m)
            env.step(plan[k])
        return measure(problem, plan)

    return play


def by_ippo(network: Network) -> Player:
    """Every agent draws from its policy."""
    return lambda problem: measure(problem, sample_episode(problem, network, np.random.default_rng(0)).plan)


def network_of(path: str | Path) -> Network:
    """Weights from a file."""
    return load_network(path)[0]


def curve(path: Path) -> tuple[list[int], list[float]]:
    """Environment steps and evaluations of a training log."""
    with path.open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["evaluation"]]
    return [int(row["steps"]) for row in rows], [float(row["evaluation"]) for row in rows]
