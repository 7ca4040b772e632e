"""What a solver returns, and how it is scored."""

from __future__ import annotations

import enum
import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sapopt.data.files import Entry, read_npz, write_npz
from sapopt.data.types import FloatArray, IntArray
from sapopt.problem.rows import LimitUse
from sapopt.problem.stays import Stay, stays

if TYPE_CHECKING:
    from pandas import DataFrame

    from sapopt.problem.sap import SAP

_FORMAT = "sapopt-result-1"
_ENTRIES = {
    "plan": Entry("iu", (None, None)),
    "benefit": Entry("f", (None,)),
    "handover": Entry("f", (None,)),
    "prices": Entry("f", (None, None), optional=True),
    "limit_prices": Entry("f", (None,), optional=True),
    "team_prices": Entry("f", (None,), optional=True),
}
_MOST_BYTES = 2**30  # of the arrays of a file: 4000 steps with 30 000 tasks, and more


class Status(enum.Enum):
    """How a solver ended. A result always holds a feasible plan, whatever its status."""

    OPTIMAL = "optimal"
    FEASIBLE = "feasible"
    TIME_LIMIT = "time limit"
    INTERRUPTED = "interrupted"

    @property
    def message(self) -> str:
        """What the status means, and what to do next."""
        return _MESSAGES[self]


_MESSAGES = {
    Status.OPTIMAL: "The plan is proven optimal within the tolerance.",
    Status.FEASIBLE: "The method ran to its end; bound(problem) tells how far its value is from optimal.",
    Status.TIME_LIMIT: "The time limit ended the run; the plan is the best found so far (HAA's steps may complete or "
    "replace those of a method that decides step by step), more time may improve it.",
    Status.INTERRUPTED: "The run was interrupted; the plan is the best found so far.",
}


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The score of a plan.

    Attributes
    ----------
    value : float
        Total benefit plus total handover, plus the rewards of teams, less the penalties of limits.
    benefit : ndarray, shape (T,)
        Benefit of every step.
    handover : ndarray, shape (T,)
        Sum of the handover matrix over the pairs held at every step; negative where it costs.
    handovers : int
        Changes of task, counted from the plan (from the initial assignment on, if there is one). Going idle is none.
    limits : tuple of LimitUse
        Use and slack of every limit.
    teams : float
        Rewards of teams.
    paid_handovers : int or None
        Steps of agents at which the handover matrix takes something away; None in results of older files.
    switches : int or None
        Steps at which an agent goes on from one task with a benefit to another: no idleness on either side, and not
        from copy to copy of one task. Of all handovers, what an operator would see as a change.
    """

    value: float
    benefit: FloatArray
    handover: FloatArray
    handovers: int
    limits: tuple[LimitUse, ...] = ()
    teams: float = 0.0
    paid_handovers: int | None = None
    switches: int | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """A plan with its score and what is known about the optimum.

    Attributes
    ----------
    plan : ndarray of int64, shape (T, n)
        Task of every agent at every step.
    value : float
        Total value, from `SAP.evaluate`.
    evaluation : Evaluation
        The score step by step.
    status : Status
    bound : float or None
        Proven upper bound of the optimal value, if the solver or the caller computed one.
    runtime : float
        Seconds.
    trace : list of dict
        One record per step of a policy or per iteration of a planner, with equal keys throughout.
    solver : str
        Name of the method with its options.
    seed : int
    prices : ndarray or None, shape (T, m)
        Task prices that prove the bound, if the solver found some; with copies of agents (T, m + n), see
        `sapopt.Bound`.
    problem : SAP or None
        The problem that was solved. Files and pickles leave it out, so that they stay small.
    limit_prices, team_prices : ndarray or None
        Multipliers of limits and teams that belong to the prices.
    """

    plan: IntArray
    evaluation: Evaluation
    status: Status
    runtime: float
    solver: str
    bound: float | None = None
    trace: list[dict[str, Any]] = field(default_factory=list, repr=False)
    seed: int = 0
    prices: FloatArray | None = field(default=None, repr=False)
    problem: SAP | None = field(default=None, repr=False)
    limit_prices: FloatArray | None = field(default=None, repr=False)
    team_prices: FloatArray | None = field(default=None, repr=False)

    @property
    def value(self) -> float:
        """Total value of the plan."""
        return self.evaluation.value

    @property
    def handovers(self) -> int:
        """Changes of task in the plan."""
        return self.evaluation.handovers

    @property
    def gap(self) -> float | None:
        """``(bound - value) / |bound|``, or None without a bound."""
        if self.bound is None:
            return None
        if self.bound == 0:
            return 0.0 if self.value == 0 else float("inf")
        return (self.bound - self.value) / abs(self.bound)

    def __repr__(self) -> str:
        proof = "" if self.bound is None else f", bound={self.bound:.6g}, gap={100 * (self.gap or 0):.3g} %"
        steps, n = self.plan.shape
        return (
            f"Result({self.solver}: value={self.value:.6g}{proof}, handovers={self.handovers}, "
            f"status={self.status.value}, T={steps}, n={n}, {self.runtime:.3g} s)"
        )

    def with_bound(self, bound: float, prices: FloatArray | None = None) -> Result:
        """The same result with a bound known from elsewhere, and the prices that prove it; the tighter one stays."""
        if self.bound is not None and self.bound <= bound:
            return self
        return replace(self, bound=bound, prices=self.prices if prices is None else prices)

    @classmethod
    def from_plan(cls, problem: SAP, plan: Any, *, solver: str = "given") -> Result:
        """A plan from elsewhere as a result: checked against the problem, and scored.

        Parameters
        ----------
        problem : SAP
        plan : array_like of int, shape (T, n), list of Stay, or a table
            Task of every agent at every step, -1 for nothing. A table is one of the forms of `to_pandas`, in a data
            frame of any library, a mapping of names to lists, or a CSV or Parquet file: agents and tasks by name, times
            as the problem has them. What it does not mention is idle.
        solver : str
            What to call the method that made it.

        Returns
        -------
        Result
            Without a bound; `sapopt.bound` and `sapopt.certify` prove one.

        Raises
        ------
        ValueError
            If the plan does not fit the problem, or breaks one of its rules.
        """
        from sapopt.exchange.plans import plan_of

        tasks = plan_of(problem, plan)
        return cls(tasks, problem.evaluate(tasks), Status.FEASIBLE, 0.0, solver, problem=problem)

    def stays(self, problem: SAP | None = None) -> list[Stay]:
        """Who does what, from when to when, agent by agent.

        Parameters
        ----------
        problem : SAP, optional
            The problem that was solved; needed only if the result was read from a file.

        Returns
        -------
        list of Stay
            Steps on which an agent holds nothing are in none of them.
        """
        from sapopt.exchange.forms import owner

        known = owner(self, problem)
        return stays(known, known.check_plan(self.plan))

    def to_pandas(
        self, form: Literal["stays", "wide", "long"] = "stays", problem: SAP | None = None
    ) -> DataFrame:
        """The plan as a data frame of pandas, with the names and times of the problem.

        Parameters
        ----------
        form : {"stays", "wide", "long"}
            One row for each stay (`Stay`); one row a step with a column for each agent; or one row for each step and
            agent, with benefit and handover. Nothing held is None among names and -1 among numbers.
        problem : SAP, optional
            The problem that was solved; needed only if the result was read from a file.

        Raises
        ------
        ImportError
            If pandas is not installed (extra ``tables``).
        """
        from sapopt.exchange.files import to_pandas

        frame: DataFrame = to_pandas(self, form, problem)
        return frame

    def to_csv(
        self, path: str | Path, form: Literal["stays", "wide", "long"] = "stays", problem: SAP | None = None
    ) -> None:
        """Write the plan as CSV in one of the forms of `to_pandas`; `sapopt.exchange` has other kinds of files.

        An existing file is replaced. Times are in ISO 8601. Needs no extra.
        """
        from sapopt.exchange.files import write_csv

        write_csv(self, path, form, problem)

    def report(self, path: str | Path, problem: SAP | None = None, **options: Any) -> Path:
        """Write the result as one HTML page to look at; see `sapopt.report.report`, which also compares several.

        Parameters
        ----------
        path : str or Path
            The file to write.
        problem : SAP, optional
            The problem that was solved; needed only if the result was read from a file.
        **options
            ``scenario`` (gives a map), ``bound``, ``prices``, ``title`` and ``force`` of `sapopt.report.report`.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        ValueError
            If the problem is not known or not the one that was solved, or the file exists and `force` is not given.
        """
        # An import upwards: the page is made of problem and result alone. So is what `sapopt.exchange` writes.
        from sapopt.report import report

        known = self.problem if problem is None else problem
        if known is None:
            raise ValueError(
                "problem: a result that was read from a file does not hold its problem; pass it, for example "
                "result.report(path, SAP.load(...))"
            )
        return report(known, self, path, **options)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "problem": None}

    def save(self, path: str | Path) -> None:
        """Write the result to an ``.npz`` file, without its problem (`SAP.save` writes that)."""
        meta = {
            "format": _FORMAT, "status": self.status.name, "runtime": self.runtime, "solver": self.solver,
            "bound": self.bound, "seed": self.seed, "value": self.value, "handovers": self.handovers,
            "trace": self.trace, "teams": self.evaluation.teams,
            "paid_handovers": self.evaluation.paid_handovers, "switches": self.evaluation.switches,
            "limits": [asdict(use) for use in self.evaluation.limits],
        }  # fmt: skip
        arrays = {"plan": self.plan, "benefit": self.evaluation.benefit, "handover": self.evaluation.handover}
        for name in ("prices", "limit_prices", "team_prices"):
            if getattr(self, name) is not None:
                arrays[name] = getattr(self, name)
        write_npz(path, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Read a result written by `save`.

        Raises
        ------
        ValueError
            If the file is damaged or holds something else.
        """
        meta, arrays = read_npz(path, _FORMAT, _ENTRIES, _MOST_BYTES)
        try:
            plan, prices = arrays["plan"].astype(np.int64), arrays.get("prices")
            steps = len(plan)
            if arrays["benefit"].shape != (steps,) or arrays["handover"].shape != (steps,):
                raise ValueError("its arrays have different numbers of steps")
            if prices is not None and (len(prices) != steps or not np.isfinite(prices).all()):
                raise ValueError("its prices are not finite, or not one row for every step")
            bound = None if meta["bound"] is None else _number(meta, "bound", finite=False)
            score = Evaluation(
                _number(meta, "value"), arrays["benefit"], arrays["handover"], _whole(meta, "handovers"),
                tuple(LimitUse(**use) for use in meta.get("limits", [])), float(meta.get("teams", 0.0)),
                *(None if meta.get(name) is None else _whole(meta, name) for name in ("paid_handovers", "switches")),
            )  # fmt: skip
            return cls(
                plan, score, Status[meta["status"]], _number(meta, "runtime"), _text(meta, "solver"), bound,
                _records(meta["trace"]), _whole(meta, "seed"), prices,
                limit_prices=arrays.get("limit_prices"), team_prices=arrays.get("team_prices"),
            )  # fmt: skip
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"{path}: damaged result file ({error})") from None


def _number(meta: dict[str, Any], name: str, finite: bool = True) -> float:
    value = meta[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError(f"{name} is {value!r}, not a number")
    if math.isnan(value) or (finite and math.isinf(value)):
        raise ValueError(f"{name} is {value}")
    return float(value)


def _whole(meta: dict[str, Any], name: str) -> int:
    value = meta[name]
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError(f"{name} is {value!r}, not a whole number")
    return value


def _text(meta: dict[str, Any], name: str) -> str:
    value = meta[name]
    if not isinstance(value, str):
        raise TypeError(f"{name} is {value!r}, not a text")
    return value


def _records(value: Any) -> list[dict[str, Any]]:
    if not isinstance(value, list) or not all(isinstance(record, dict) for record in value):
        raise TypeError("trace is not a list of records")
    return value
