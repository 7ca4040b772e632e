"""What can happen to satellites on batteries: failures, and sunlight that is not the same at every step.

Both are the random part of a transition (`sapopt.running.chance.Chance`) for problems whose state model is a `Battery`,
such as the instance ``power``. The numbers are ours: the thesis names stochastic problems (sections 5.1 and 7.3), and
has none.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import IntArray
from sapopt.dynamics.base import Units
from sapopt.dynamics.battery.model import BatteryState
from sapopt.problem.sap import SAP
from sapopt.running.chance import Chance, Seed, step_generator


@dataclass(frozen=True)
class Failures:
    """At the end of a step a satellite fails for good, each with the same probability and independently.

    One that failed is what an empty one is: it collects nothing any more and pays nothing.

    Parameters
    ----------
    probability : float
        Of a failure in one step, 0 to 1.

    Raises
    ------
    ValueError
        If the probability is none.
    """

    probability: float = 0.005

    def __post_init__(self) -> None:
        if not 0 <= self.probability <= 1:
            raise ValueError(f"probability must lie between 0 and 1, got {self.probability!r}")

    def transition(
        self, problem: SAP, k: int, state: Any, assignment: IntArray, rng: np.random.Generator
    ) -> BatteryState:
        """The nominal state, with the charge of those that fail at 0."""
        after = _battery(problem.transition(k, state, assignment))
        return replace(after, levels=np.where(self._strikes(problem.n, rng), 0, after.levels))

    def in_hindsight(self, problem: SAP, seed: Seed) -> SAP:
        """The problem of one run for somebody who knew all failures: a satellite that failed has no benefits any more.

        Any policy's value in that run is that of its plan in this problem. So `sapopt.bound` of it is proven to be
        above every policy in the run, and the mean over many runs bounds the mean of the best policy.
        """
        if not problem.is_plain:
            raise ValueError("problem: failures know no capacities, idleness or limits; leave them out")
        failed = np.zeros(problem.n, dtype=bool)
        steps: list[Any] = []
        for k in range(problem.T):
            benefit = problem.benefits.step(k)
            if isinstance(benefit, np.ndarray):
                steps.append(np.where(failed[:, None], np.minimum(benefit, 0.0), benefit))
            else:
                rows = np.repeat(failed, np.diff(benefit.indptr))
                data = np.where(rows, np.minimum(benefit.data, 0.0), benefit.data)
                steps.append(sp.csr_array((data, benefit.indices, benefit.indptr), shape=benefit.shape))
            failed = failed | self._strikes(problem.n, step_generator(seed, k))
        dense = all(isinstance(step, np.ndarray) for step in steps)
        return SAP(
            np.array(steps) if dense else steps, problem.dynamics, problem.initial_assignment,
            agents=problem.agents, tasks=problem.tasks, times=problem.times,
        )  # fmt: skip

    def _strikes(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return rng.random(n) < self.probability


@dataclass(frozen=True)
class RandomIncome:
    """A step without work charges a battery by a random amount, on the mean by what is reckoned with.

    In whole levels, uniform on 0 to twice `Battery.charge`; each satellite and each step for itself.
    """

    def transition(
        self, problem: SAP, k: int, state: Any, assignment: IntArray, rng: np.random.Generator
    ) -> BatteryState:
        """The nominal state, with a random charge of those that are alive and do not work."""
        before, after = _battery(state), _battery(problem.transition(k, state, assignment))
        units = _units(problem)
        income = rng.integers(0, 2 * units.charge, problem.n, endpoint=True)
        charged: IntArray = np.minimum(before.levels + income, units.capacity)
        idle = (before.levels > 0) & ~after.working
        return replace(after, levels=np.where(idle, charged, after.levels))


STOCHASTIC: dict[str, tuple[str, Chance]] = {
    "power-failing": ("power", Failures()),
    "power-cloudy": ("power", RandomIncome()),
}
"""Name -> instance whose transition is reckoned with, and what happens in truth."""


def stochastic_instance(name: str, seed: int = 0, **options: Any) -> tuple[SAP, Chance]:
    """A built-in stochastic instance.

    Parameters
    ----------
    name : {"power-failing", "power-cloudy"}
    seed : int
        Of the problem, see `sapopt.domains.instances.instance`.
    **options
        Options of the instance ``power``.

    Returns
    -------
    problem : SAP
    chance : Chance

    Raises
    ------
    ValueError
        If there is no such instance, or it has no such option.

    Examples
    --------
    >>> from sapopt.running.chance import over_runs
    >>> from sapopt.solvers import AssignmentPolicy, energy_price, power_constrained
    >>> problem, chance = stochastic_instance("power-failing", steps=10)
    >>> policies = [AssignmentPolicy(power_constrained), AssignmentPolicy(energy_price)]
    >>> greedy, price = over_runs(problem, policies, chance, runs=3)
    >>> bool(price.mean > 0)
    True
    """
    from sapopt.domains.instances import instance

    if name not in STOCHASTIC:
        raise ValueError(f"unknown stochastic instance {name!r}; known: {', '.join(STOCHASTIC)}")
    nominal, chance = STOCHASTIC[name]
    return instance(nominal, seed, **options), chance


def _units(problem: SAP) -> Units:
    batteries = problem.model.batteries()
    if batteries is None:
        raise ValueError(f"this chance is for dynamics Battery, not for {problem.model.called}")
    return batteries.units


def _battery(state: Any) -> BatteryState:
    if not isinstance(state, BatteryState):
        raise ValueError(
            f"this chance is for satellites on batteries (dynamics Battery), not for a state of {type(state).__name__}"
        )
    return state
