"""The loop that plays a policy through a problem, and what becomes of a run that is cut short."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.data.windows import WindowSums
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.running.control import Expired, Run
from sapopt.running.outlook import Forecast, Outlook, Policy, Recording
from sapopt.running.reserve import Reserve, forecast_windows, step_value
from sapopt.running.steps import Ledger

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Rollout:
    """A plan made by a policy, and how the run ended.

    Attributes
    ----------
    plan : ndarray of int64, shape (T, n)
    status : Status
    trace : list of dict
        One record for every step that the policy decided.
    """

    plan: IntArray
    status: Status
    trace: list[dict[str, Any]] = field(default_factory=list)


def rollout(
    problem: SAP, policy: Policy, run: Run | None = None, forecast: Forecast | None = None
) -> Rollout:
    """Play a policy through a problem.

    Parameters
    ----------
    problem : SAP
    policy : Policy
    run : Run, optional
        Clock, seed and callback.
    forecast : callable, optional
        What the policy sees of the future, see `Forecast`; the true benefits by default. It is asked at every step.

    Returns
    -------
    Rollout
        If the time ends or the run is interrupted, the plan is still whole, see `sapopt.running.reserve`.
    """
    run = run or Run()
    windows = WindowSums(problem.benefits)
    memory = policy.begin(problem, run.rng)
    state = problem.initial_state()
    parking = np.arange(problem.m)
    plan = np.empty((problem.T, problem.n), dtype=np.int64)
    ledger = None if problem.is_plain else Ledger(problem)
    reserve = Reserve(problem, run, forecast)
    trace: list[dict[str, Any]] = []
    total = 0.0
    status = Status.FEASIBLE
    recording = policy if isinstance(policy, Recording) else None  # asking costs as much as a small step
    done = 0  # steps that are decided, with `state` the state after them, wherever an interruption strikes
    try:
        for k in range(problem.T):
            reserve.done = k
            reserve.check()
            if forecast is not None:
                windows = forecast_windows(forecast, problem, k)
            else:
                windows.forget(before=k)
            began = run.seconds
            allowance = reserve.allowance
            outlook = Outlook(k, windows.end, state, problem, windows, parking, reserve.check, allowance)
            if ledger is not None:
                outlook = replace(outlook, rules=ledger.rules(k))
            tasks, memory = policy.act(outlook, memory)
            plan[k] = problem.check_assignment(tasks, k)
            if ledger is not None:
                ledger.enter(k, plan[k])
            gain = step_value(problem, k, state, plan[k])
            total += gain
            done, state = k + 1, problem.transition(k, state, plan[k])
            seconds = run.seconds - began
            said = {} if recording is None else recording.record(memory)
            trace.append({"step": k, "value": gain, "total": total, "seconds": seconds, **said})
            run.report(k + 1, problem.T, total)
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    except Expired:
        status = Status.INTERRUPTED if run.stopped else Status.TIME_LIMIT
    if done < problem.T:
        reserve.done = done
        plan = reserve.completed(plan, state, ledger, at_once=status is Status.INTERRUPTED)
        log.warning(
            "%s ended at step %d of %d; %s", policy.name, done, problem.T,
            "HAA's plan is worth more than what it began, and is returned"
            if plan is reserve.plan else "the rest of the plan was completed without it",
        )  # fmt: skip
    return Rollout(plan, status, trace)
