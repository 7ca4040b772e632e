"""What a policy falls back on when the time ends before its last step: HAA's steps, and HAA's plan.

A policy that is cut short has decided some steps. HAA (alpha of beta_hat at every step) decides the rest of them in
what time was kept back for it. Nothing says that the whole is then worth as much as HAA's plan from the first step on:
the cut may leave the agents in a bad place. So that plan is made too, as soon as the policy is seen to be late, and the
better of the two is returned. A policy that is not late never pays for this.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import IntArray
from sapopt.data.windows import WindowSums
from sapopt.problem.sap import SAP
from sapopt.running.control import Expired, Run
from sapopt.running.outlook import Forecast, Outlook
from sapopt.running.steps import Ledger

_PATIENCE = 0.25
"""Share of the time limit before which no policy is called late: its first step may take longer than the others."""
_ON_TIME = 0.9
"""Share of the time limit in which a policy has to be seen to end, by its pace so far, not to be late."""
_SLOWER = 1.5
"""Time kept back for HAA's steps, in multiples of what they took so far."""
_QUICKER = 0.5
"""A policy goes on to the last moment where a step of HAA takes more than this share of its own."""
_MEASURED = 3
"""Steps of HAA after which its pace counts: the first one may load kernels."""


class Reserve:
    """Keeps the time for HAA's steps, and HAA's plan, for one run of a policy under a time limit.

    Parameters
    ----------
    problem : SAP
        A core (`SAP.core`).
    run : Run
        Without a time limit nothing is kept.
    forecast : callable or None
        What the policy sees of the future. With a forecast there is no plan in reserve: which of two plans is worth
        more is known only afterwards.

    Attributes
    ----------
    done : int
        Steps that the policy has decided.
    plan : ndarray or None, shape (T, n)
        HAA's plan, once it is made.
    """

    def __init__(self, problem: SAP, run: Run, forecast: Forecast | None = None) -> None:
        self.problem, self.run, self.forecast = problem, run, forecast
        self.done = 0
        self.plan: IntArray | None = None
        self._was_late = False
        self._step = 0.0  # seconds that a step of HAA takes; 0 until they are worth keeping back

    @property
    def kept_back(self) -> float:
        """Seconds at the end of the run that belong to HAA's steps, not to the policy."""
        return _SLOWER * self._step * (self.problem.T - self.done)

    @property
    def allowance(self) -> float:
        """Seconds for the policy's next step if all steps left share its time evenly."""
        return (self.run.seconds_left - self.kept_back) / (self.problem.T - self.done)

    def check(self) -> None:
        """Raise `Expired` if the policy's time is over; make HAA's plan if the policy is late."""
        self.run.check()
        limit = self.run.time_limit
        if limit is None:
            return
        if not self._was_late:
            used = limit - self.run.seconds_left
            self._was_late = used >= max(_PATIENCE, _ON_TIME * self.done / self.problem.T) * limit
            if self._was_late:
                self._play_haa(used / (self.done + 1))
        if self.kept_back > 0.0 and self.run.seconds_left <= self.kept_back:
            raise Expired

    def completed(self, plan: IntArray, state: Any, ledger: Ledger | None, at_once: bool) -> IntArray:
        """The plan (T, n) of which the policy has decided the first `done` steps, or HAA's if that is worth more.

        While there is time for it, and unless it is to be `at_once`, the steps left are HAA's. Later ones keep the last
        assignment, or take alpha of the benefits where a forbidden pair or a limit is in the way.
        """
        problem = self.problem
        previous = plan[self.done - 1] if self.done else problem.initial_assignment
        for k in range(self.done, problem.T):
            at_once = at_once or self.run.time_limit is None or self.run.expired
            if not at_once:
                try:
                    previous = _haa(problem, k, state, ledger, self.forecast)
                except InfeasibleError:  # by the forecast; or where the policy has led to, as found below
                    at_once = True
            if ledger is not None and at_once:  # what was right at one step may break a limit at the next
                previous = None
            if previous is None or not np.isfinite(step_value(problem, k, state, previous)):
                previous = _haa(problem, k, state, ledger)
            plan[k] = previous
            if ledger is not None:
                ledger.enter(k, plan[k])
            state = problem.transition(k, state, plan[k])
        return plan if self.plan is None or _value(problem, plan) >= _value(problem, self.plan) else self.plan

    def _play_haa(self, pace: float) -> None:
        """Make HAA's plan, if it can be made in the time left; `pace` is what the policy needs a step, in seconds."""
        problem, run = self.problem, self.run
        plan = np.empty((problem.T, problem.n), dtype=np.int64)
        state = problem.initial_state()
        ledger = None if problem.is_plain else Ledger(problem)
        began = run.seconds
        for k in range(problem.T):
            if run.expired:
                return
            try:
                plan[k] = _haa(problem, k, state, ledger)
            except InfeasibleError:
                return  # HAA has no plan here
            if ledger is not None:
                ledger.enter(k, plan[k])
            state = problem.transition(k, state, plan[k])
            step = (run.seconds - began) / (k + 1)
            if k + 1 >= _MEASURED:
                self._step = step if step <= _QUICKER * pace else 0.0
                if step * (problem.T - k - 1) > run.seconds_left or self.forecast is not None:
                    return
        if self.forecast is None:
            self.plan = plan


def forecast_windows(forecast: Forecast, problem: SAP, k: int) -> WindowSums:
    """What is forecast at step k, checked."""
    seen = Benefits(forecast(k, problem.T - k)).settled()
    if seen.shape[1:] != (problem.n, problem.m) or seen.shape[0] > problem.T - k:
        raise ValueError(
            f"forecast({k}, {problem.T - k}) returned shape {seen.shape}, "
            f"expected (1..{problem.T - k}, {problem.n}, {problem.m})"
        )
    return WindowSums(seen, first=k)


def step_value(problem: SAP, k: int, state: Any, tasks: IntArray) -> float:
    """What an assignment (n,) earns at step k, entered in `state`."""
    held = problem.benefits.slice(k, k + 1).at(tasks[None])[0]
    return float(held.sum() + problem.model.handover_at(k, state, tasks).sum())


def _haa(
    problem: SAP, k: int, state: Any, ledger: Ledger | None, forecast: Forecast | None = None
) -> IntArray:
    """HAA's assignment at step k, on the true benefits or on what is forecast."""
    if forecast is None:
        windows = WindowSums(problem.benefits.slice(k, k + 1), first=k)
    else:
        windows = forecast_windows(forecast, problem, k)
    rules = None if ledger is None else ledger.rules(k)
    outlook = Outlook(k, windows.end, state, problem, windows, np.arange(problem.m), rules=rules)
    return problem.check_assignment(outlook.assign(outlook.beta_hat()), k)


def _value(problem: SAP, plan: IntArray) -> float:
    """What a plan is worth; -inf if it breaks a limit that must hold."""
    try:
        return problem.evaluate(plan).value
    except ValueError:
        return -np.inf
