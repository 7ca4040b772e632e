"""Linear and mixed-integer programmes as plain arrays, and HiGHS with a clock, a cut-off and a start.

Every run of HiGHS in this library is one of two: `maximise` solves a programme once; a `GrowingProgramme` is a linear
one that gets columns and rows between its solutions. Both hold a time limit and hear Ctrl-C, which `sapopt.solve` turns
into a run that is stopped: `maximise` asks its `Watch`, a `GrowingProgramme` its clock.

Statuses are told apart: a proven optimum, an incumbent with a bound when time or patience ended, an infeasible
programme, and a solver that failed (`SolverError`).
"""

from __future__ import annotations

import enum
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.types import FloatArray


class SolverError(RuntimeError):
    """A solver ended in a way that says nothing about the problem (numerical trouble, out of memory)."""


class Ending(enum.Enum):
    """How a solver ended."""

    OPTIMAL = "optimal"
    INFEASIBLE = "infeasible"
    TIME_LIMIT = "time limit"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, eq=False)
class Programme:
    """maximise ``gain @ x + offset`` subject to ``low <= rows @ x <= high`` and ``0 <= x <= upper``.

    Attributes
    ----------
    gain : ndarray, shape (columns,)
    rows : sparse matrix, shape (rows, columns)
    low, high : ndarray, shape (rows,)
        -inf and +inf leave a side open.
    upper : ndarray, shape (columns,)
    integer : ndarray of bool, shape (columns,)
    offset : float
    """

    gain: FloatArray
    rows: Any
    low: FloatArray
    high: FloatArray
    upper: FloatArray
    integer: np.ndarray
    offset: float = 0.0

    def value(self, x: FloatArray) -> float:
        """Objective of a point."""
        return float(self.gain @ x) + self.offset


@dataclass(frozen=True, eq=False)
class Answer:
    """What a solver found.

    Attributes
    ----------
    ending : Ending
    x : ndarray or None
        Best point found.
    value : float
        Its objective, -inf without a point.
    bound : float
        No point is better.
    nodes : int
        Nodes of the search tree.
    duals : ndarray or None
        Row duals of a linear programme.
    """

    ending: Ending
    x: FloatArray | None
    value: float
    bound: float
    nodes: int = 0
    duals: FloatArray | None = None


Watch = Callable[[float, float], bool]
"""``watch(value, bound) -> stop?``, called ten times a second while the solver runs, in the thread that called it."""

_LOOK = 0.1
"""Seconds between two looks at the watch."""
_FIRST_SLICE = 0.1
"""Seconds that a growing programme is solved before the first look at the clock."""


def maximise(
    programme: Programme,
    *,
    relaxed: bool = False,
    seconds: float = np.inf,
    tolerance: float = 1e-9,
    cutoff: float = -np.inf,
    start: FloatArray | None = None,
    watch: Watch | None = None,
    options: dict[str, Any] | None = None,
) -> Answer:
    """Solve a programme with HiGHS.

    Parameters
    ----------
    programme : Programme
    relaxed : bool
        Solve the linear relaxation.
    seconds : float
        Time limit, for handing the programme over and solving it.
    tolerance : float
        Relative gap at which a point counts as optimal.
    cutoff : float
        Only points better than this matter: a search that ends without one proves that there is none, and answers
        OPTIMAL with the cut-off as its bound and no point.
    start : ndarray, optional
        A feasible point to start from.
    watch : callable, optional
        See `Watch`.
    options : dict, optional
        Further options of HiGHS by name.

    Raises
    ------
    SolverError
        If HiGHS fails.
    """
    import highspy

    if programme.gain.size == 0:
        feasible = bool((programme.low <= 0).all() and (programme.high >= 0).all())
        value = programme.offset if feasible else -np.inf
        return Answer(
            Ending.OPTIMAL if feasible else Ending.INFEASIBLE, np.zeros(0) if feasible else None, value, value
        )
    stop_at = time.monotonic() + seconds
    if seconds <= 0:
        return Answer(Ending.TIME_LIMIT, None, -np.inf, np.inf)
    factor = objective_factor(programme.gain)
    if factor != 1.0:
        heard = None if watch is None else (lambda value, bound: watch(value / factor, bound / factor))
        larger = replace(programme, gain=programme.gain * factor, offset=programme.offset * factor)
        found = maximise(
            larger, relaxed=relaxed, seconds=seconds, tolerance=tolerance, cutoff=cutoff * factor, start=start,
            watch=heard, options=options,
        )  # fmt: skip
        duals = None if found.duals is None else found.duals / factor
        return replace(found, value=found.value / factor, bound=found.bound / factor, duals=duals)
    solver = highspy.Highs()
    settings: dict[str, Any] = {"output_flag": False, "mip_rel_gap": tolerance, "mip_abs_gap": 1e-9}
    if np.isfinite(cutoff):
        settings["objective_bound"] = float(programme.offset - cutoff)  # of the minimisation
    for name, value in (settings | (options or {})).items():
        solver.setOptionValue(name, value)
    solver.passModel(_model(highspy, programme, relaxed))
    if start is not None and not relaxed:
        point = highspy.HighsSolution()
        point.col_value = np.asarray(start, dtype=np.float64)
        solver.setSolution(point)
    if np.isfinite(stop_at):
        left = stop_at - time.monotonic()  # large programmes take seconds to hand over
        if left <= 0:
            return Answer(Ending.TIME_LIMIT, None, -np.inf, np.inf)
        solver.setOptionValue("time_limit", left)
    interrupted = _run(solver, programme.offset, watch, stop_at)
    answer = _answer(highspy, solver, programme, relaxed, interrupted, cutoff)
    if start is None or relaxed or answer.ending is not Ending.OPTIMAL or answer.nodes > 0:
        return answer
    # Where presolving leaves an objective of nothing but zeros, HiGHS 1.15 takes all values for whole numbers, and so a
    # start less than one below the optimum for optimal, before the first node. Without a start it does not.
    again = maximise(
        programme, seconds=stop_at - time.monotonic(), tolerance=tolerance, cutoff=cutoff, watch=watch, options=options
    )  # fmt: skip
    if again.x is not None and again.value >= answer.value:
        return again
    return replace(again, x=answer.x, value=answer.value, bound=max(again.bound, answer.value))


def objective_factor(gain: FloatArray) -> float:
    """Power of two that brings the largest gain to 512 .. 1024, unless it lies in 1 .. 10^6 already.

    HiGHS judges reduced costs and gaps by absolute tolerances (1e-7, 1e-9), which means nothing where the benefits
    themselves are of that size. A power of two changes no digit.
    """
    largest = float(np.abs(gain).max(initial=0.0))
    if largest == 0.0 or not np.isfinite(largest) or 1.0 <= largest <= 1e6:
        return 1.0
    # Beyond 2^1023 there is no such number; benefits below 1e-299 are then left a little smaller.
    return float(2.0 ** min(10 - math.frexp(largest)[1], 1023))


def _model(highspy: Any, programme: Programme, relaxed: bool) -> Any:
    rows = sp.csc_array(programme.rows)
    model = highspy.HighsLp()
    model.num_row_, model.num_col_ = rows.shape
    # HiGHS minimises at heart: cut-off and bounds of a maximisation are turned round in some places and not in others.
    model.col_cost_ = -np.asarray(programme.gain, dtype=np.float64)
    model.col_lower_ = np.zeros(rows.shape[1])
    model.col_upper_ = np.asarray(programme.upper, dtype=np.float64)
    model.row_lower_ = np.asarray(programme.low, dtype=np.float64)
    model.row_upper_ = np.asarray(programme.high, dtype=np.float64)
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = rows.indptr
    model.a_matrix_.index_ = rows.indices
    model.a_matrix_.value_ = rows.data
    if not relaxed and programme.integer.any():
        whole, real = highspy.HighsVarType.kInteger, highspy.HighsVarType.kContinuous
        model.integrality_ = np.where(programme.integer, whole, real).tolist()
    return model


def _run(solver: Any, offset: float, watch: Watch | None, stop_at: float) -> bool:
    """Run in a thread of its own, so that Ctrl-C and the watch are heard. Returns whether the watch ended it.

    HiGHS asks whether to stop more often than it looks at its own clock, so it is told when the time is over as well.
    """
    stop = threading.Event()
    seen = [-np.inf, np.inf]

    def listen(event: Any) -> None:
        if stop.is_set():
            event.interrupt()

    def note(event: Any) -> None:
        seen[0] = offset - event.data_out.mip_primal_bound
        seen[1] = offset - event.data_out.mip_dual_bound

    solver.cbMipInterrupt += listen
    solver.cbSimplexInterrupt += listen
    solver.cbIpmInterrupt += listen
    solver.cbMipLogging += note
    worker = threading.Thread(target=solver.run, daemon=True)
    asked = False
    try:
        worker.start()
        while worker.is_alive():
            worker.join(_LOOK)
            if watch is not None and not asked and watch(seen[0], seen[1]):
                asked = True
                stop.set()
            if time.monotonic() > stop_at:
                stop.set()
    finally:
        stop.set()
        _wait(worker)
    return asked


def _wait(worker: threading.Thread) -> None:
    """Wait for the end of a thread, whatever the user presses: Python must not end while HiGHS calls back into it."""
    interruption = None
    while worker.is_alive():
        try:
            worker.join()
        except KeyboardInterrupt as error:
            interruption = error
    if interruption is not None:
        raise interruption


def _answer(
    highspy: Any, solver: Any, programme: Programme, relaxed: bool, interrupted: bool, cutoff: float
) -> Answer:
    status = solver.getModelStatus()
    states = highspy.HighsModelStatus
    info = solver.getInfo()
    whole = not relaxed and bool(programme.integer.any())
    x: FloatArray | None = None
    duals: FloatArray | None = None
    value, bound = -np.inf, np.inf
    if info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible:
        solution = solver.getSolution()
        x = np.asarray(solution.col_value)
        value = programme.value(x)
        if not whole:
            duals = -np.asarray(solution.row_dual)
    if whole and np.isfinite(info.mip_dual_bound):
        bound = programme.offset - info.mip_dual_bound
    nodes = max(int(info.mip_node_count), 0) if whole else 0
    if status == states.kOptimal:
        return Answer(Ending.OPTIMAL, x, value, max(bound, value) if whole else value, nodes, duals)
    if status in (states.kInfeasible, states.kUnboundedOrInfeasible):
        if np.isfinite(cutoff):
            return Answer(Ending.OPTIMAL, None, -np.inf, cutoff, nodes)
        return Answer(Ending.INFEASIBLE, None, -np.inf, -np.inf, nodes)
    if status in (states.kTimeLimit, states.kInterrupt, states.kSolutionLimit, states.kIterationLimit):
        ending = Ending.INTERRUPTED if interrupted else Ending.TIME_LIMIT
        return Answer(ending, x, value, bound, nodes, duals)
    if status in (states.kObjectiveBound, states.kObjectiveTarget):
        return Answer(Ending.OPTIMAL, x, value, bound, nodes, duals)
    raise SolverError(f"HiGHS ended with {solver.modelStatusToString(status)!r}; give it more time or memory")


class GrowingProgramme:
    """A linear programme that grows: after a change, the next solution starts from the basis of the last one.

    Parameters
    ----------
    programme : Programme
        What it begins with; `integer` does not count. Its largest gain is to be of the size of those added later:
        it says how the gains are scaled for HiGHS, as `maximise` scales them.
    """

    def __init__(self, programme: Programme) -> None:
        import highspy

        self._solver = highspy.Highs()
        for name, value in (("output_flag", False), ("threads", 1), ("presolve", "off")):
            self._solver.setOptionValue(name, value)
        self._factor = objective_factor(programme.gain)
        scaled = replace(programme, gain=programme.gain * self._factor)
        self._solver.passModel(_model(highspy, scaled, relaxed=True))
        self._unfinished = highspy.HighsModelStatus.kTimeLimit

    def add_columns(self, gain: FloatArray, columns: Any) -> None:
        """Add columns (rows, count) with their gains (count,), each at least 0."""
        columns = sp.csc_array(columns)
        count = len(gain)
        self._solver.addCols(
            count, -self._factor * gain, np.zeros(count), np.full(count, np.inf), columns.nnz,
            columns.indptr.astype(np.int32), columns.indices.astype(np.int32), columns.data,
        )  # fmt: skip

    def add_rows(self, rows: Any, high: FloatArray) -> None:
        """Add rows (count, columns) with their upper sides (count,)."""
        rows = sp.csr_array(rows)
        self._solver.addRows(
            len(high), np.full(len(high), -np.inf), high, rows.nnz,
            rows.indptr.astype(np.int32), rows.indices.astype(np.int32), rows.data,
        )  # fmt: skip

    def set_upper(self, columns: np.ndarray, upper: FloatArray) -> None:
        """Change the upper bounds of some columns."""
        self._solver.changeColsBounds(len(columns), columns.astype(np.int32), np.zeros(len(columns)), upper)

    def set_gain(self, columns: np.ndarray, gain: FloatArray) -> None:
        """Change the gains of some columns."""
        self._solver.changeColsCost(len(columns), columns.astype(np.int32), -self._factor * gain)

    @property
    def basis(self) -> Any:
        """The basis of the last solution; can be set to begin with it again."""
        return self._solver.getBasis()

    @basis.setter
    def basis(self, basis: Any) -> None:
        self._solver.setBasis(basis)

    @property
    def x(self) -> FloatArray:
        """The last point, optimal or not."""
        return np.asarray(self._solver.getSolution().col_value, dtype=np.float64)

    @property
    def duals(self) -> FloatArray:
        """Row duals of the last basis; any numbers make a Lagrangian bound, these make a good one."""
        return np.asarray(self._solver.getSolution().row_dual, dtype=np.float64) / -self._factor

    def solve(self, stop: Callable[[], bool] = lambda: False, iterations: int | None = None) -> bool:
        """Solve, or take a number of simplex steps. Returns False if ``stop()`` was true before the end.

        The simplex method goes on from where a time limit interrupted it, so the clock is looked at between slices of
        time, each as long as all before it: a callback at every step would cost a seventh of the time, and a slice of
        fixed length might be too short for a single step.
        """
        self._solver.setOptionValue(
            "simplex_iteration_limit", 2**31 - 1 if iterations is None else iterations
        )
        spent = 0.0
        while not stop():
            began = time.monotonic()
            slice_end = self._solver.getRunTime() + max(
                _FIRST_SLICE, spent
            )  # HiGHS adds up the time of all its runs
            self._solver.setOptionValue("time_limit", slice_end)
            self._solver.run()
            spent += time.monotonic() - began
            if self._solver.getModelStatus() != self._unfinished:
                return True
        return False
