"""The planner `Exact`."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations import milp, network, qap
from sapopt.formulations.highs import Ending, SolverError, maximise
from sapopt.formulations.limited.disturbed import needs_limits
from sapopt.formulations.reduction import Formulation
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.solvers.base import EXTRAS, Outcome, gap_unit
from sapopt.solvers.dual_decomposition import DualDecomposition
from sapopt.solvers.exact import dp, infeasible, search, warm
from sapopt.solvers.limited.planner import plan_limited

log = logging.getLogger(__name__)

_MOST_PLACES = 15_000_000
"""Steps x agents x tasks up to which the network is built: some 400 bytes each, 6 GiB in all."""
_PLACES_A_SECOND = 1_000_000
"""Places whose arcs are built in a second, at least."""
_BUILDING_SHARE = 0.3
"""Share of a time limit that building the network may take."""

Method = Literal["network", "milp", "qap", "dp"]

_FORMULATIONS: dict[str, Formulation[Any]] = {"network": network, "milp": milp, "qap": qap}


@dataclass(frozen=True)
class Exact:
    """An optimal plan, or the best one found in the time with a proven bound.

    Parameters
    ----------
    method : {"network", "milp", "qap", "dp"}
        "network": for agent-local dynamics, and by far the fastest. With one cost for every move and up to a million
        stays (``n m T (T + 1) / 2``) it is branch and price over stays, with as many threads as numba uses; else a
        mixed-integer programme over the time-expanded network, from which prices have removed the arcs that no better
        plan can use. "milp": the `cvxpy` programme, solved by HiGHS. "qap": the Koopmans-Beckmann problem of eq. 1.4,
        linearised; `SwitchingCost` only, tiny problems. "dp": brute force over joint states; any dynamics, tiny ones.
    tolerance : float
        Relative gap at which a plan counts as optimal.
    reduced_costs : bool
        Whether "network" uses prices. If not, it is one mixed-integer programme over the whole network.

    Raises
    ------
    ValueError
        If the method does not take the problem.
    InfeasibleError
        If no plan exists; says at which step it fails, and which agents are short of tasks.
    SolverError
        If the solver fails.

    Notes
    -----
    The result is OPTIMAL when proven, else TIME_LIMIT or INTERRUPTED with the incumbent and a bound, or FEASIBLE where
    the solver stopped for another reason. Without a time limit it runs until it has a proof.

    References
    ----------
    J. Holder, MSc thesis, University of Washington, 2024, section 1.4 (the quadratic assignment problem, eq. 1.4).
    """

    method: Method = "network"
    tolerance: float = 1e-7
    reduced_costs: bool = True

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ValueError(f"method must be one of {', '.join(get_args(Method))}, got {self.method!r}")
        if not 0 <= self.tolerance < 1:
            raise ValueError(f"tolerance must be a relative gap in [0, 1), got {self.tolerance!r}")

    @property
    def name(self) -> str:
        """Name with the method."""
        return f"Exact({self.method})"

    def refusal(self, problem: SAP) -> str | None:
        """None, or the reason why the method does not take the problem."""
        return dp.refusal(problem) if self.method == "dp" else _FORMULATIONS[self.method].refusal(problem)

    @property
    def takes(self) -> frozenset[str]:
        """Everything, by the network; the other methods are for the plain problem."""
        return EXTRAS if self.method == "network" else frozenset()

    def plan(self, problem: SAP, run: Run) -> Outcome:
        """Solve the problem."""
        if not problem.is_plain or (self.method == "network" and needs_limits(problem)):
            return plan_limited(problem, run, self.tolerance, self.name)
        reason = self.refusal(problem)
        if reason:
            raise ValueError(f"Exact(method={self.method!r}): {reason}")
        methods = {"network": self._network, "dp": self._dp}
        return methods.get(self.method, self._programme)(problem, run)

    def _network(self, problem: SAP, run: Run) -> Outcome:
        size = problem.T * problem.n * problem.m
        slow = size / _PLACES_A_SECOND > _BUILDING_SHARE * run.seconds_left
        if (size > _MOST_PLACES or slow) and problem.model.switching() is not None:
            log.warning(
                "Exact: the network of %d places is too large to build; planning with prices instead", size
            )
            return DualDecomposition(tolerance=max(self.tolerance, 1e-9)).plan(problem, run)
        state = search.solve(problem, run, self.tolerance, self.reduced_costs)
        found = self._outcome(problem, run, state.best, state.bound, state.trace, state.prices)
        if found.status is Status.FEASIBLE and run.time_limit is not None:
            # Nothing is begun that takes longer to write down than there is time: that ends the search too.
            return replace(found, status=Status.TIME_LIMIT)
        return found

    def _programme(self, problem: SAP, run: Run) -> Outcome:
        """One mixed-integer programme, handed to HiGHS as it is."""
        formulation = _FORMULATIONS[self.method]
        best = warm.incumbent(problem, run, 0.1 * run.seconds_left)
        form = formulation.formulate(problem)
        answer = maximise(
            form.programme(), seconds=run.seconds_left, tolerance=self.tolerance,
            watch=lambda value, bound: run.report(
                run.seconds, run.time_limit or 0.0, max(value, best.value), bound, self.method
            ),
        )  # fmt: skip
        if answer.ending is Ending.INFEASIBLE:
            raise InfeasibleError(infeasible.explain(problem, network.formulate(problem)))
        if answer.x is not None:
            best = best.better(problem, formulation.recover(form, answer.x))
        return self._outcome(problem, run, best, answer.bound)

    def _dp(self, problem: SAP, run: Run) -> Outcome:
        plan = dp.best_plan(problem, run)
        if plan is not None:
            best = warm.Incumbent().better(problem, plan)
            return self._outcome(problem, run, best, best.value)
        return self._outcome(problem, run, warm.incumbent(problem, Run(run.seed), 10.0), np.inf)

    def _outcome(
        self,
        problem: SAP,
        run: Run,
        best: warm.Incumbent,
        bound: float,
        trace: list[dict[str, Any]] | None = None,
        prices: FloatArray | None = None,
    ) -> Outcome:
        if best.plan is None and run.expired:
            best = warm.last_resort(problem, run)
        slack = self.tolerance * max(gap_unit(problem), abs(best.value))
        if best.plan is not None and bound - best.value <= slack:
            status = Status.OPTIMAL
        elif run.stopped:
            status = Status.INTERRUPTED
        elif run.expired:
            status = Status.TIME_LIMIT
        else:
            status = Status.FEASIBLE
        plan: IntArray | None = best.plan
        if plan is None:
            raise SolverError(f"{self.name} found no plan in {run.seconds:.3g} s; give it more time")
        # The solver's own rounding may put its bound a hair below the value of the plan.
        limit = max(bound, best.value) if np.isfinite(bound) else None
        return Outcome(plan, status, limit, prices, trace or [])
