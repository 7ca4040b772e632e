"""Unit commitment: power stations that are slow to start and to stop (thesis, section 7.1.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sapopt.data.types import FloatArray, IntArray, index_array, real_array
from sapopt.dynamics.base import Setting
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates


@dataclass(frozen=True, eq=False)
class UnitCommitment(AgentLocal):
    """Units that are on or off, with start-up and shut-down cost, and minimum up and down time (Holder 2024, 7.1.3).

    A task with a benefit (which may be negative) is output: a unit that takes one runs. Any other task switches the
    unit off. A unit that starts pays its start-up cost and runs for at least `minimum_up` steps; one that stops pays
    its shut-down cost and stays off for at least `minimum_down` steps. (One that runs to the end stops for free.)
    Orders against that are not obeyed: a unit that has to stay on runs idle and pays `idling`, one that has to stay off
    does so and gets nothing for its task. So every assignment is feasible.

    The local state is the number of steps that a unit has been on (positive) or off (negative), up to its minimum.

    Parameters
    ----------
    start_up : array_like, shape (n,)
        Cost of starting each unit, not negative.
    minimum_up, minimum_down : array_like of int, shape (n,)
        Steps, at least 1.
    idling : array_like, shape (n,)
        Cost of one step of running against the order, not negative.
    initial : array_like of int, shape (n,)
        Steps that each unit has been on (positive) or off (negative) before the first step; not 0.
    shut_down : float or array_like, shape (n,)
        Cost of stopping each unit, not negative.

    Raises
    ------
    ValueError
        If a list has another length, or a number is out of range.
    """

    start_up: FloatArray
    minimum_up: IntArray
    minimum_down: IntArray
    idling: FloatArray
    initial: IntArray
    shut_down: FloatArray | float = 0.0

    def __post_init__(self) -> None:
        for name in ("start_up", "idling", "shut_down"):
            values = real_array(getattr(self, name), name)
            if name == "shut_down" and values.ndim == 0:
                values = np.full(len(self.start_up), float(values))
            if values.ndim != 1 or not np.isfinite(values).all() or (values < 0).any():
                raise ValueError(f"{name} must be a list of finite costs, not negative")
            object.__setattr__(self, name, values)
        for name in ("minimum_up", "minimum_down", "initial"):
            object.__setattr__(self, name, index_array(getattr(self, name), name))
        for name in ("minimum_up", "minimum_down"):
            if getattr(self, name).ndim != 1 or (getattr(self, name) < 1).any():
                raise ValueError(f"{name} must be a list of whole numbers of at least 1")
        if self.initial.ndim != 1 or (self.initial == 0).any():
            raise ValueError(
                "initial must be a list of steps on (positive) or off (negative), none of them 0"
            )
        lengths = {name: len(getattr(self, name)) for name in
                   ("start_up", "minimum_up", "minimum_down", "idling", "initial", "shut_down")}  # fmt: skip
        if len(set(lengths.values())) > 1:
            raise ValueError(f"one entry per unit is needed everywhere, got {lengths}")

    def __repr__(self) -> str:
        return f"UnitCommitment({len(self.start_up)} units)"

    def validate(self, problem: Setting) -> None:
        """Check that there is an agent for every unit."""
        if len(self.start_up) != problem.n:
            raise ValueError(f"start_up has {len(self.start_up)} entries for {problem.n} agents")

    def start(self, problem: Setting) -> IntArray:
        """What `initial` says; an initial assignment tells nothing more."""
        return np.clip(self.initial, -self.minimum_down, self.minimum_up)

    def features(self, state: LocalStates) -> FloatArray:
        """Whether every unit is on, and the share of its minimum time that is left, shape ``(n, 2)``."""
        on = state.local > 0
        least = np.where(on, self.minimum_up, self.minimum_down)
        return np.stack([on.astype(np.float64), 1.0 - np.abs(state.local) / least], axis=1)

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Start, run, or stop, as far as the minimum times allow."""
        on = local > 0
        ordered = np.isfinite(benefit) & (benefit != 0)
        locked_on = on & (local < self.minimum_up[agent])
        locked_off = ~on & (-local < self.minimum_down[agent])
        eta = np.where(ordered & locked_off, -benefit, 0.0)
        eta -= np.where(~ordered & locked_on, self.idling[agent], 0.0)
        eta -= np.where(ordered & ~on & ~locked_off, self.start_up[agent], 0.0)
        eta -= np.where(~ordered & on & ~locked_on, np.asarray(self.shut_down)[agent], 0.0)
        runs = (ordered & ~locked_off) | (~ordered & locked_on)
        longer_on = np.where(on, np.minimum(local + 1, self.minimum_up[agent]), 1)
        longer_off = np.where(on, -1, np.maximum(local - 1, -self.minimum_down[agent]))
        return eta, np.where(runs, longer_on, longer_off)
