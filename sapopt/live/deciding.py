"""One decision of a session: what is frozen, what the policy says in the time it has, and what is sure in any case."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sapopt.data.benefits import Benefits, dense_step
from sapopt.data.feasibility import InfeasibleError
from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels import clock
from sapopt.live.benefits import arranged
from sapopt.live.course import FREE, Course, pinned
from sapopt.live.decision import Decision, Outcome
from sapopt.live.frozen import pins_of
from sapopt.live.limits import used_after
from sapopt.live.names import Roster
from sapopt.live.proving import window_bound
from sapopt.live.thinking import OVERHEAD_S, Pace, Thought, Times
from sapopt.live.window import Settings, Standing, Window, made_window
from sapopt.running.outlook import Carrying, Change

_PROOF = 0.2
"""Share of the time left that an ascent for the bound may take; it gets better the longer it takes."""


@dataclass(frozen=True, eq=False)
class _Answer:
    """What the policy says of the next step and those announced."""

    places: list[IntArray]
    memory: Any
    is_short: bool


def decided(
    settings: Settings,
    standing: Standing,
    agents: Roster,
    tasks: Roster,
    benefits: Benefits,
    frozen: Any,
    ends: bool,
    began: float,
    budget: float | None,
    pace: Pace,
) -> tuple[Decision, Standing]:
    """The answer to a call, and what is carried on.

    Parameters
    ----------
    pace : Pace
        Changed in place.
    """
    window = made_window(settings, standing, agents, tasks, benefits)
    pins = pins_of(frozen, window, standing)
    times = pace.times(began, budget)
    course = Course(window, settings.change_cost, ends)
    memory, outcome = None, Outcome.FROZEN
    decided_at = standing.decided
    for k, fixed in enumerate(pins):
        if (fixed != FREE).all():
            course.play(fixed)
        elif k == 0:
            places, memory, outcome = _partly_frozen(settings, standing, course, benefits, fixed, times, pace)
            decided_at = standing.step
            course.play(places)
        else:
            course.play(course.best(fixed))
    all_frozen = all((fixed != FREE).all() for fixed in pins)
    prefix = course.copy()
    if not course.is_whole and len(pins) < settings.announce:
        known = _carried(settings, standing, window, standing.step + len(pins))
        thought, sure = _thought(settings, course, known, standing.step, times, pace)
        chosen, answer, how = _chosen(course, thought, sure, times)
        if answer is not None:
            memory, decided_at = answer.memory, standing.step + len(pins)
        outcome = how if not pins or how is not Outcome.COMPLETE else outcome
        course = chosen
    else:
        course.go_on(times.has_time)
    if memory is None:  # the policy was not asked, or had no answer
        memory, decided_at = _carried(settings, standing, window, standing.decided + 1), standing.decided
    bound, prices = None, None
    if settings.prove and all_frozen and times.has_time():
        bound, prices = _proven(prefix, memory, standing, times, pace, window)
    decision = Decision(
        window.named(course.plan[0]), tuple(window.named(places) for places in course.plan[: settings.announce]),
        course.value, bound, course.gains[0], 0.0, outcome, standing.step, _changes(window, standing, course.plan[0]),
    )  # fmt: skip
    carried = _stands(settings, standing, window, course, decision, memory, decided_at, prices)
    pace.done()
    return decision, carried


def _thought(
    settings: Settings,
    course: Course,
    memory: Any,
    step: int,
    times: Times,
    pace: Pace,
) -> tuple[_Answer | None, Course | None]:
    """The policy's answer, None if there is none in time; and the course of HAA, None where there is no hurry."""
    if np.isinf(times.due):
        return _asked(settings, course.copy(), memory, step, np.inf, _never), None
    thought: Thought[_Answer] | None = None
    if time.perf_counter() < times.think_until and pace.may_think():
        own = course.copy()
        # on the clock that stands still while kernels are compiled
        until = clock.now() + times.think_until - time.perf_counter()
        thought = Thought(lambda check: _asked(settings, own, memory, step, until, check))
        pace.thought = thought
    sure = course.copy()
    sure.play(sure.best())
    sure.go_on(times.has_time)
    if thought is None:
        return None, sure
    slack = 0.5 * (times.due - times.think_until)  # for what a policy does after it has stopped to think
    try:
        answer = thought.answer(times.think_until + slack)
    except InfeasibleError:  # its lookahead has found no way on; there is one for this step
        answer = None
    pace.heard(answer is not None)
    return answer, sure


def _never() -> None:
    """Nobody asks to stop."""


def _asked(
    settings: Settings, course: Course, memory: Any, step: int, until: float, check: Callable[[], None]
) -> _Answer:
    """What the policy says of the next step, and of the others that are announced."""
    policy = settings.policy
    if memory is None:
        memory = policy.begin(course.window.core, np.random.default_rng([settings.seed, step]))
    cuts: list[bool] = []
    tasks, memory = policy.act(course.outlook(check, until, lambda: cuts.append(True)), memory)
    is_short = bool(cuts) or clock.now() >= until
    course.play(course.window.core.check_assignment(tasks, course.length))
    places, later = [course.plan[-1]], memory
    carrying = isinstance(policy, Carrying)
    while course.length < min(settings.announce, course.window.steps):
        # What follows is only announced, so whoever can answer at once does so.
        if not carrying:
            later = policy.begin(course.window.core, np.random.default_rng([settings.seed, step]))
        tasks, later = policy.act(course.outlook(check, clock.now()), later)
        course.play(course.window.core.check_assignment(tasks, course.length))
        places.append(course.plan[-1])
    return _Answer(places, memory, is_short)


def _chosen(
    course: Course, answer: _Answer | None, sure: Course | None, times: Times
) -> tuple[Course, _Answer | None, Outcome]:
    """The better of the policy's plan and that of HAA, where the policy could not come to its end."""
    if answer is None:
        assert sure is not None
        return sure, None, Outcome.FALLBACK
    for places in answer.places:
        course.play(places)
    course.go_on(times.has_time)
    if not answer.is_short:
        return course, answer, Outcome.COMPLETE
    if sure is not None and sure.value > course.value:
        return sure, answer, Outcome.FALLBACK
    return course, answer, Outcome.SHORT


def _partly_frozen(
    settings: Settings,
    standing: Standing,
    course: Course,
    benefits: Benefits,
    fixed: IntArray,
    times: Times,
    pace: Pace,
) -> tuple[IntArray, Any, Outcome]:
    """The assignment of a first step of which a part is frozen: the policy decides on the others."""
    window = course.window
    now = replace(settings, announce=1)
    if not window.core.is_plain:
        return _within_pins(now, standing, course, fixed, times, pace)
    free = np.flatnonzero(fixed == FREE)
    taken = fixed[fixed != FREE]
    tasks = np.setdiff1d(np.arange(len(window.tasks)), taken)
    part = made_window(
        now, standing, Roster(tuple(window.agents.names[i] for i in free)),
        Roster(tuple(window.tasks.names[j] for j in tasks)), arranged(benefits, free, tasks),
    )  # fmt: skip
    own = Course(part, settings.change_cost, course.goes_on == 0)
    known = _carried(settings, standing, part, standing.step)
    answer, sure = _thought(now, own, known, standing.step, times, pace)
    chosen, answer, outcome = _chosen(own, answer, sure, times)
    places = fixed.copy()
    places[free] = tasks[chosen.plan[0]]
    memory = None
    if answer is not None and isinstance(settings.policy, Carrying):
        change = Change(
            window.agents.places(part.agents), window.tasks.places(part.tasks), np.zeros(0, int), 1
        )
        memory = settings.policy.carried(answer.memory, change)
    return places, memory, outcome


def _within_pins(
    settings: Settings,
    standing: Standing,
    course: Course,
    fixed: IntArray,
    times: Times,
    pace: Pace,
) -> tuple[IntArray, Any, Outcome]:
    """The same with capacities, idleness or limits: all other pairs of those agents are forbidden."""
    window = course.window
    core = window.core
    assert core.capacity is not None
    dense = np.stack([dense_step(core.benefits.step(k)) for k in range(core.T)])
    dense[0] = pinned(dense[0], fixed, core.capacity[0])
    set_on = np.flatnonzero((fixed != FREE) & (fixed != window.idle_place))
    # What earns nothing would not be looked at where agents may idle; whatever it earns here, there is no choice.
    dense[0][set_on, fixed[set_on]] = np.where(
        dense[0][set_on, fixed[set_on]] > 0, dense[0][set_on, fixed[set_on]], 1.0
    )
    only = _with_benefits(window, Benefits(dense))
    own = Course(only, settings.change_cost, course.goes_on == 0)
    known = _carried(settings, standing, only, standing.step)
    answer, sure = _thought(settings, own, known, standing.step, times, pace)
    chosen, answer, outcome = _chosen(own, answer, sure, times)
    return chosen.plan[0], None if answer is None else answer.memory, outcome


def _with_benefits(window: Window, benefits: Benefits) -> Window:
    """A window with other benefits of its core."""
    core = copy.copy(window.core)
    core.benefits = benefits
    core.core = core
    return replace(window, core=core)


def _carried(settings: Settings, standing: Standing, window: Window, step: int) -> Any:
    """The policy's memory for a window whose decision is that of a step; None if it begins anew."""
    if not isinstance(settings.policy, Carrying) or standing.memory is None:
        return None
    place = window.tasks.places(standing.tasks)
    if settings.idle:
        place = np.append(place, len(standing.tasks))
    rows = {name: number for number, name in enumerate(standing.rows)}
    limits = np.array([rows.get(name, -1) for name in window.core.rows.names], dtype=np.int64)
    change = Change(window.agents.places(standing.agents), place, limits, step - standing.decided)
    return settings.policy.carried(standing.memory, change)


def _proven(
    prefix: Course, memory: Any, standing: Standing, times: Times, pace: Pace, window: Window
) -> tuple[float | None, FloatArray | None]:
    start = None
    if standing.prices is not None and len(standing.prices) > 1:
        place = window.tasks.places(standing.tasks)
        start = np.where(
            place >= 0, np.hstack([standing.prices, np.zeros((len(standing.prices), 1))])[1:, place], 0.0
        )
        if window.idle_place >= 0:
            start = None
    if np.isinf(times.due):
        return window_bound(prefix, memory, start, np.inf)
    if pace.proof is not None and not pace.proof.is_over:
        return None, None
    seconds = times.left
    proof = Thought(lambda _: window_bound(prefix, memory, start, _PROOF * seconds))
    pace.proof = proof
    return proof.answer(times.due - OVERHEAD_S) or (None, None)


def _changes(window: Window, standing: Standing, places: IntArray) -> tuple[Any, ...]:
    """Agents who were announced for something else that could still be had."""
    if not standing.announced:
        return ()
    benefits, out = window.truth.benefits.step(0), []
    dense = benefits if isinstance(benefits, np.ndarray) else None
    tasks = window.unplaced(places)
    for agent, task in standing.announced[0].items():
        i = window.agents.index.get(agent)
        j = None if task is None else window.tasks.index.get(task)
        if i is not None and j is not None and tasks[i] != j:
            worth = dense[i, j] if dense is not None else benefits[i, j]
            if worth > 0:
                out.append(agent)
    return tuple(out)


def _stands(
    settings: Settings,
    standing: Standing,
    window: Window,
    course: Course,
    decision: Decision,
    memory: Any,
    decided_at: int,
    prices: FloatArray | None,
) -> Standing:
    """What is carried on from a decision."""
    places = course.plan[0]
    core = window.core
    state = core.model.transition(0, window.state, places)
    held = window.unplaced(places)
    used = standing.used
    if settings.limits:
        served = (core.benefits.slice(0, 1).at(places[None])[0] > 0) & (held >= 0)
        taken = (
            np.zeros(len(held), dtype=bool) if window.held is None else (held >= 0) & (held != window.held)
        )
        used = used_after(settings.limits, used, window.agents, window.tasks, held, served, taken)
    return Standing(
        standing.step + 1, window.agents, window.tasks, held, state, core.model.agent_columns(state),
        memory if isinstance(settings.policy, Carrying) else None, core.rows.names, decided_at,
        decision.plan[1:], used, prices,
    )  # fmt: skip
