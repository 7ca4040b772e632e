"""Agents that run on batteries: work drains, idling charges, and an empty agent is dead for good."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.types import FloatArray, IntArray, real_array
from sapopt.dynamics.base import AgentColumns, Model, Setting, Units

if TYPE_CHECKING:
    from sapopt.data.matrices import Matrix
    from sapopt.data.windows import WindowSums
    from sapopt.dynamics.battery.paths import BatteryPaths
    from sapopt.dynamics.battery.plain import PlainBattery
    from sapopt.dynamics.battery.states import BatteryStates

PayFor = Literal["moves", "entries"]

_MOST_LEVELS = 1000
_LARGEST_DENOMINATOR = 10_000


@dataclass(frozen=True, eq=False)
class BatteryState:
    """State of a `Battery`.

    Attributes
    ----------
    held : ndarray of int64, shape (n,), or None
        Previous assignment; None before a first step that pays no handover.
    levels : ndarray of int64, shape (n,)
        Charge of every agent in whole units of `Battery.units`; 0 is dead.
    working : ndarray of bool, shape (n,)
        Whether the agent worked at the previous step. An initial assignment counts as work.
    """

    held: IntArray | None
    levels: IntArray
    working: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Battery(Model):
    """Agents with batteries (thesis, section 6.4).

    An agent *works* at a step where it holds a task of positive benefit. Work takes `drain` from its charge, any other
    step adds `charge`, up to `capacity`. An agent that still has charge may spend the last of it; one that reached 0 is
    dead for good: it collects no positive benefit any more and pays nothing. (A negative benefit stays: it is no gain.)

    Charge is counted in whole units of the greatest number of which `drain`, `charge`, `capacity` and the initial
    charges are multiples, so that nothing is lost or left over by rounding.

    Parameters
    ----------
    cost : float
        Cost of a handover, not negative.
    drain, charge, capacity : float
        Charge taken by a step of work, added by a step without, and at most stored.
    pay_for : {"moves", "entries"}
        What is charged. "moves", the rule of the papers: a change of task, if the new task has positive benefit at that
        step. An agent can then take a task for free before it is worth anything, and begin to work on it without
        paying. "entries", a set-up cost: every start of work, that is, working on a task on which the agent did not
        work at the previous step, wherever it was idle.
    initial_charge : float or array_like of shape (n,), optional
        Charge before the first step, `capacity` if omitted.

    Raises
    ------
    ValueError
        If a number is negative or not finite, or the charges have no reasonable common unit.

    Examples
    --------
    >>> from sapopt import SAP
    >>> problem = SAP([[[1.0]], [[1.0]], [[1.0]]], Battery(0.0, drain=0.5, charge=0.25), [0])
    >>> problem.evaluate([[0], [0], [0]]).value  # the second step empties the battery
    2.0
    """

    handover_limit = 0.0
    """Largest entry that the handover matrix can have."""
    idles_freely: ClassVar[bool] = True

    cost: float
    drain: float = 0.2
    charge: float = 0.1
    capacity: float = 1.0
    pay_for: PayFor = field(default="moves", kw_only=True)
    initial_charge: float | FloatArray | None = field(default=None, kw_only=True)
    benefits: Benefits | None = field(default=None, repr=False, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("cost", "drain", "charge", "capacity"):
            value = real_array(getattr(self, name), name)
            if value.ndim or not np.isfinite(value) or value < 0:
                raise ValueError(f"{name} must be a finite number that is not negative, got {value!r}")
            object.__setattr__(self, name, float(value))
        if self.capacity == 0:
            raise ValueError("capacity must be positive; agents without any charge are dead from the start")
        if self.pay_for not in get_args(PayFor):
            raise ValueError(f"pay_for must be 'moves' or 'entries', got {self.pay_for!r}")
        if self.initial_charge is not None:
            first = real_array(self.initial_charge, "initial_charge")
            if first.ndim > 1 or not ((first >= 0) & (first <= self.capacity)).all():
                raise ValueError(
                    f"initial_charge must be a number, or one per agent, between 0 and capacity={self.capacity:g}"
                )
            object.__setattr__(self, "initial_charge", float(first) if first.ndim == 0 else first)
        _ = self.units  # the check

    @cached_property
    def units(self) -> Units:
        """The common unit of all charges, and drain, charge and capacity counted in it."""
        drain, charge, capacity = (_fraction(getattr(self, x), x) for x in ("drain", "charge", "capacity"))
        first = () if self.initial_charge is None else np.unique(self.initial_charge)
        unit = capacity
        for part in (drain, charge, *(_fraction(x, "initial_charge") for x in first)):
            unit = _common(unit, part)
        if capacity / unit > _MOST_LEVELS:
            raise ValueError(
                f"drain, charge, capacity and initial_charge: their common unit {unit} makes {capacity / unit} levels, "
                f"more than {_MOST_LEVELS}; round them to simpler fractions of each other"
            )
        return Units(unit, int(drain / unit), int(charge / unit), int(capacity / unit))

    def charge_of(self, state: BatteryState) -> FloatArray:
        """Charge of every agent, shape ``(n,)``, in the units of `capacity`."""
        return np.asarray(state.levels * float(self.units.unit))

    def validate(self, problem: Setting) -> None:
        """Check that the initial charges fit the number of agents."""
        first = self.initial_charge
        if isinstance(first, np.ndarray) and first.shape != (problem.n,):
            raise ValueError(f"initial_charge has shape {first.shape}, but there are {problem.n} agents")

    def bind(self, benefits: Benefits) -> Battery:
        """A copy that knows which pairs mean work."""
        return replace(self, benefits=benefits)

    def initial_state(self, problem: Setting) -> BatteryState:
        """The initial assignment, with the initial charges."""
        first = self.capacity if self.initial_charge is None else self.initial_charge
        # Each is a multiple of the unit, and rounding only undoes the division.
        levels = np.rint(np.broadcast_to(first, problem.n) / float(self.units.unit)).astype(np.int64)
        held = problem.initial_assignment
        return BatteryState(held, levels, np.full(problem.n, held is not None))

    def transition(self, k: int, state: BatteryState, assignment: IntArray) -> BatteryState:
        """The state after an assignment was held at step k."""
        works = (self._worth(k, assignment) > 0) & (state.levels > 0)
        units = self.units
        charged = np.minimum(state.levels + units.charge, units.capacity)
        idle = np.where(state.levels > 0, charged, 0)
        levels = np.where(works, np.maximum(state.levels - units.drain, 0), idle)
        return BatteryState(assignment, levels, works)

    def key(self, state: BatteryState) -> bytes:
        """Fingerprint of all that matters of a state."""
        return state.levels.tobytes() + self.serving(state).tobytes() + bytes([state.held is None])

    def agent_columns(self, state: BatteryState) -> AgentColumns | None:
        """Task, charge, and whether the agent worked."""
        held = np.full(len(state.levels), -1) if state.held is None else state.held
        return AgentColumns({"held": held}, {"levels": state.levels, "working": state.working})

    def of_columns(self, columns: AgentColumns) -> BatteryState:
        """The state of these batteries; whoever holds nothing does not work."""
        held = columns.tasks["held"]
        return BatteryState(held, columns.values["levels"], columns.values["working"] & (held >= 0))

    def serving(self, state: BatteryState) -> IntArray:
        """Task that every agent may work on without paying, shape ``(n,)``; -1 for none (also if it is dead)."""
        if state.held is None:
            return np.full(len(state.levels), -1)
        keeps = state.levels > 0
        if self.pay_for == "entries":
            keeps = keeps & state.working
        return np.where(keeps, state.held, -1)

    def handover(self, k: int, state: BatteryState) -> FloatArray:
        """Handover matrix, shape ``(n, m)``: the cost of moves, and minus the benefit where an agent is dead."""
        return self._handover(dense_step(self._bound().step(k)), state)

    def handover_at(self, k: int, state: BatteryState, assignment: IntArray) -> FloatArray:
        """Handover of every agent under an assignment, shape ``(n,)``."""
        worth = self._worth(k, assignment)
        pays = (assignment != self.serving(state)) & (worth > 0) & (state.held is not None)
        eta = np.where(pays, -self.cost, 0.0)
        return np.where(state.levels > 0, eta, -np.maximum(worth, 0.0)) + 0.0

    def interval(self, windows: WindowSums, start: int, stop: int, state: BatteryState) -> Matrix:
        """Benefit of holding one assignment over ``start .. stop - 1``: what it really yields.

        Batteries run down and charge, and under ``pay_for="entries"`` every start of work inside the interval pays; so
        the value of a pair is that of the agent alone holding the task for that long, from its present charge.
        """
        benefits = windows.slice(start, stop)
        serving, free = self.serving(state), state.held is None
        if windows.is_sparse:
            from sapopt.data.matrices import GainMatrix
            from sapopt.dynamics.battery.hard import Before, Rule
            from sapopt.dynamics.battery.interval import interval_gains

            flat = benefits.flat()
            units = self.units
            rule = Rule(
                self.cost, units.drain, units.charge, units.capacity, self.pay_for == "entries", np.empty(0)
            )
            row_start, tasks, gains = interval_gains(
                flat.indptr,
                flat.indices,
                flat.data,
                stop - start,
                windows.m,
                Before(state.levels, serving, free),
                rule,
            )
            negative = bool(gains.min(initial=0.0) < 0)
            none, zero = np.full(windows.n, -1), np.zeros(windows.n)
            return GainMatrix(row_start, tasks, gains, none, zero, 0.0, windows.m, negative)
        total = np.zeros((windows.n, windows.m))
        units = self.units
        levels = np.broadcast_to(state.levels[:, None], total.shape)
        ready = serving[:, None] == np.arange(windows.m)
        for k in range(stop - start):
            benefit = dense_step(benefits.step(k))
            works = (benefit > 0) & (levels > 0)
            total = total + np.where(works, benefit, np.minimum(benefit, 0.0))
            if not (free and k == 0):
                total -= self.cost * (works & ~ready)
            ready = works if self.pay_for == "entries" else np.ones_like(works)
            charged = np.where(levels > 0, np.minimum(levels + units.charge, units.capacity), 0)
            levels = np.where(works, np.maximum(levels - units.drain, 0), charged)
        return total

    def path_oracle(
        self, benefits: Benefits, state: BatteryState, end_value: FloatArray | None = None
    ) -> BatteryPaths:
        """Longest priced paths of the agents (a `PathOracle`); `end_value`: see `BatteryPaths`."""
        from sapopt.dynamics.battery.paths import BatteryPaths

        return BatteryPaths(benefits, self, state, end_value=end_value)

    def window_oracle(self, benefits: Benefits, state: BatteryState) -> BatteryPaths:
        """`path_oracle` of a window that is not the last: nobody dies in it, and charge left over counts.

        See `sapopt.dynamics.battery.paths.leftover` for the value; it serves receding horizons and proves nothing.
        """
        from sapopt.dynamics.battery.paths import BatteryPaths

        return BatteryPaths(benefits, self, state, goes_on=True)

    def local_model(self, benefits: Benefits, state: BatteryState) -> BatteryStates:
        """The agents' finite states in plain words (`sapopt.dynamics.paths.oracles.LocalModel`)."""
        from sapopt.dynamics.battery.states import BatteryStates

        return BatteryStates(self, benefits.shape[2], state)

    def batteries(self) -> Battery:
        """The agents' batteries: these."""
        return self

    def levels_of(self, state: BatteryState) -> IntArray:
        """Whole levels of charge of every agent, shape ``(n,)``; 0 is dead."""
        return state.levels

    def is_first(self, state: BatteryState) -> bool:
        """Whether nothing is held yet, so that the step pays no handover."""
        return state.held is None

    def plain(self, problem: Setting) -> PlainBattery:
        """The rule once more, for verifying."""
        from sapopt.dynamics.battery.plain import PlainBattery

        return PlainBattery(self, problem)

    def _handover(self, benefit: FloatArray, state: BatteryState) -> FloatArray:
        eta = np.zeros(benefit.shape)
        if state.held is not None:
            eta[benefit > 0] = -self.cost
            serving = self.serving(state)
            keeps = np.flatnonzero(serving >= 0)
            eta[keeps, serving[keeps]] = 0.0
        dead = state.levels == 0
        eta[dead] = -np.maximum(benefit[dead], 0.0)
        return eta + 0.0  # no negative zeros

    def _worth(self, k: int, assignment: IntArray) -> FloatArray:
        return self._bound().slice(k, k + 1).at(assignment[None])[0]

    def _bound(self) -> Benefits:
        if self.benefits is None:
            raise ValueError("this Battery belongs to no problem yet; ask problem.handover(k, state)")
        return self.benefits


def _fraction(value: float, name: str) -> Fraction:
    """The simple fraction that a float stands for: 1/5 for 0.2."""
    found = Fraction(float(value)).limit_denominator(_LARGEST_DENOMINATOR)
    if not math.isclose(float(found), value, rel_tol=1e-12, abs_tol=0.0):
        raise ValueError(
            f"{name}: {value!r} is no simple fraction, so charges have no reasonable common unit; round it, "
            f"for example to {float(found):g}"
        )
    return found


def _common(a: Fraction, b: Fraction) -> Fraction:
    """Greatest number of which both are multiples."""
    return Fraction(
        math.gcd(a.numerator * b.denominator, b.numerator * a.denominator), a.denominator * b.denominator
    )
