"""What an exact search starts from: the best plan of the heuristics, and the Lagrangian bound with its prices."""

from __future__ import annotations

import importlib
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.paths.oracles import path_oracle
from sapopt.formulations.dual import ascend, rigorous_bound
from sapopt.formulations.network import Network, NetworkOracle
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.outlook import Policy
from sapopt.running.rollout import rollout
from sapopt.solvers.greedy import MyopicGreedy
from sapopt.solvers.haal import HAAL

log = logging.getLogger(__name__)

_LOOKAHEADS = (2, 4)

_TINY = 1000
"""Steps x agents x tasks up to which better plans to start from take longer than the proof."""


@dataclass(frozen=True, eq=False)
class Incumbent:
    """A feasible plan and its value; no plan and -inf as long as none is known."""

    plan: IntArray | None = None
    value: float = -np.inf

    def better(self, problem: SAP, plan: IntArray | None) -> Incumbent:
        """This one, or `plan` if it is feasible and worth more."""
        if plan is None:
            return self
        try:
            value = problem.evaluate(plan).value
        except ValueError:
            return self
        return Incumbent(plan, value) if value > self.value else self


def incumbent(problem: SAP, run: Run, seconds: float) -> Incumbent:
    """The best of the start given to the run, HAAL and greedy."""
    best = Incumbent().better(problem, run.start)
    limit = run.seconds + seconds
    is_tiny = problem.T * problem.n * problem.m <= _TINY
    lookaheads = () if is_tiny else _LOOKAHEADS
    policies: list[Policy] = [HAAL(lookahead) for lookahead in lookaheads if lookahead <= max(problem.T, 2)]
    policies.append(MyopicGreedy())
    for policy in policies:
        left = limit - run.seconds
        if left <= 0 or run.expired:
            break
        try:
            played = rollout(problem, policy, run.part(left))
        except InfeasibleError:
            continue  # a policy may run into a dead end that a plan avoids
        if played.status is Status.INTERRUPTED:  # an exception, meant for the whole run
            run.stopped = True
        best = best.better(problem, played.plan)
    return best


def last_resort(problem: SAP, run: Run) -> Incumbent:
    """A plan that takes no time, for a run that is over before it found one: an assignment kept to the end."""
    try:
        return Incumbent().better(problem, rollout(problem, MyopicGreedy(), run.part()).plan)
    except InfeasibleError:
        return Incumbent()


def decomposition(problem: SAP, run: Run, seconds: float) -> IntArray | None:
    """A plan of `DualDecomposition`, if this version of sapopt has one and it takes the problem."""
    try:
        module = importlib.import_module("sapopt.solvers.dual_decomposition")
        solver: Any = module.DualDecomposition()
        outcome = solver.plan(problem, run.part(seconds))
    except (ImportError, AttributeError):
        return None
    except (ValueError, TypeError, NotImplementedError) as error:
        log.info("DualDecomposition gives no start: %s", error)
        return None
    if outcome.status is Status.INTERRUPTED:
        run.stopped = True
    plan: IntArray = outcome.plan
    return plan


@dataclass(frozen=True, eq=False)
class Prices:
    """Lagrangian prices (T, m), the bound they prove, and by how much the best path through each arc falls short.

    A plan that uses an arc is worth at most ``bound - regret[arc]``.
    """

    prices: FloatArray
    bound: float
    regret: FloatArray


def price(problem: SAP, network: Network, run: Run, value: float, seconds: float) -> Prices:
    """Minimise the Lagrangian dual for some seconds, and measure the arcs by the prices found."""
    oracle: Any = NetworkOracle(network)
    if problem.model.is_agent_local:
        oracle = path_oracle(problem.model, problem.benefits, problem.initial_state())
    found = ascend(
        oracle,
        time_limit=seconds,
        max_iterations=20_000,
        target=value if np.isfinite(value) else None,
        tolerance=1e-9,
        callback=lambda *_: run.expired,
    )
    # The network's own recursion, in numpy, proves the bound: it shares nothing with the compiled oracle.
    values, through = network.through(found.prices)
    return Prices(found.prices, rigorous_bound(values, found.prices), values[network.agent] - through)
