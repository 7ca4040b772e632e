"""Value and bound of problems with capacities, idleness, limits and teams, from the definitions alone.

Plain numpy, nothing shared with the solvers or with the way in which a problem counts its limits: every limit is read
here once more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp

from sapopt.data.benefits import dense_step
from sapopt.data.types import FloatArray, IntArray, real_array
from sapopt.dynamics.idle import IdlePlace
from sapopt.problem.limit import Limit, Team, chosen
from sapopt.problem.sap import SAP
from sapopt.proofs.plain import sum_down
from sapopt.proofs.plain_switching import switching_values

_EPS = float(np.finfo(np.float64).eps)
_SLACK = 1e-9  # of sums that are not whole numbers, by the definition of a Limit


Block = tuple[slice, slice, slice]
_ALL = slice(None)


@dataclass
class _Weights:
    """What one sum adds for holding a pair, for taking it up and for staying on it.

    `where` are the steps, agents and tasks that it is about at most; the arrays are of their shape.
    """

    where: Block
    pair: FloatArray
    taken: FloatArray
    stayed: FloatArray

    @property
    def is_whole(self) -> bool:
        parts = (self.pair, self.taken, self.stayed)
        return all(bool((part == np.rint(part)).all()) for part in parts)


def _one(index: int) -> slice:
    return slice(int(index), int(index) + 1)


def _served(problem: SAP) -> np.ndarray:
    """Mask (T, n, m) of the pairs that serve."""
    return np.stack([dense_step(problem.benefits.step(k)) > 0 for k in range(problem.T)])


def _sums(problem: SAP, limit: Limit, served: np.ndarray) -> Iterator[_Weights]:
    """The sums that a limit stands for, in order; `served` is that of `_served`."""
    T, n, m = problem.T, problem.n, problem.m

    def zeros(*where: slice) -> _Weights:
        shape = [len(range(size)[part]) for part, size in zip(where, (T, n, m), strict=True)]
        return _Weights((where[0], where[1], where[2]), np.zeros(shape), np.zeros(shape), np.zeros(shape))

    tasks = chosen(limit.tasks, m, problem.tasks, "tasks")
    agents = chosen(limit.agents, n, problem.agents, "agents")
    if limit.kind == "weight":
        out = zeros(_ALL, _ALL, _ALL)
        if isinstance(limit.weight, (list, tuple)) and any(sp.issparse(step) for step in limit.weight):
            out.pair[:] = np.stack([step.toarray() for step in limit.weight])
        else:
            out.pair[:] = np.asarray(limit.weight, dtype=np.float64)
        yield out
    elif limit.kind == "once":
        for j in tasks:
            out = zeros(_ALL, _ALL, _one(j))
            out.pair[:, :, 0] = served[:, :, j]
            yield out
    elif limit.kind == "visits":
        for j in tasks:
            out = zeros(_ALL, _ALL, _one(j))
            out.pair[0, :, 0] = served[0, :, j]
            out.taken[1:, :, 0] = served[1:, :, j]
            out.stayed[1:, :, 0] = served[1:, :, j] & ~served[:-1, :, j]
            yield out
    elif limit.kind == "cover":
        for k in chosen(limit.steps, T, None, "steps"):
            out = zeros(_one(k), _ALL, _ALL)
            out.pair[0][:, tasks] = served[k][:, tasks] if limit.served else 1.0
            yield out
    elif limit.kind == "work":
        for i in agents:
            out = zeros(_ALL, _one(i), _ALL)
            out.pair[:, 0] = served[:, i]
            yield out
    else:
        first = 1 if problem.initial_assignment is None else 0
        for group in agents[:, None] if limit.each else [agents]:
            out = zeros(_ALL, slice(int(group[0]), int(group[-1]) + 1) if len(group) else slice(0, 0), _ALL)
            out.taken[first:, group - (group[0] if len(group) else 0)] = 1.0
            yield out


def _bounds(limit: Limit, weights: _Weights) -> tuple[float, float]:
    """Least and greatest sum, with the slack where numbers are not whole."""
    low = -math.inf if limit.at_least is None else limit.at_least
    high = math.inf if limit.at_most is None else limit.at_most

    def slack(bound: float) -> float:
        if not math.isfinite(bound) or (weights.is_whole and bound == round(bound)):
            return 0.0
        return _SLACK * max(1.0, abs(bound))

    return low - slack(low), high + slack(high)


def limited_value(problem: SAP, plan: Any) -> float:
    """Value of a plan, rounded down.

    Raises
    ------
    ValueError
        If the plan is not feasible, or breaks a hard limit.
    """
    tasks = np.asarray(plan)
    T, n, m = problem.T, problem.n, problem.m
    if tasks.shape != (T, n) or tasks.dtype.kind not in "iu":
        raise ValueError(f"the plan must be integers of shape {(T, n)}, got {tasks.shape}")
    if tasks.min() < (-1 if problem.idle else 0) or tasks.max() >= m:
        raise ValueError(f"the plan holds a task outside {-1 if problem.idle else 0}..{m - 1}")
    for k in range(T):
        for j in np.unique(tasks[k][tasks[k] >= 0]):
            room = 1 if problem.capacity is None else problem.capacity[k, j]
            if int((tasks[k] == j).sum()) > room:
                raise ValueError(
                    f"the plan gives {problem.naming.task(j)} to more agents than its capacity {room} at "
                    f"{problem.naming.step(k)}"
                )
    numbers = _terms(problem, tasks)
    if not np.isfinite(numbers).all():
        raise ValueError("the plan uses a forbidden pair")
    initial = problem.initial_assignment
    before = np.vstack([np.full((1, n), -2) if initial is None else initial[None], tasks[:-1]])
    held = np.zeros((T, n, m), dtype=bool)
    where = np.argwhere(tasks >= 0)
    held[where[:, 0], where[:, 1], tasks[tasks >= 0]] = True
    is_new = (tasks != before)[:, :, None]
    served = _served(problem)
    for limit in problem.limits:
        if isinstance(limit, Team):
            numbers += _earned(problem, limit, tasks)
            continue
        for weights in _sums(problem, limit, served):
            here, new = held[weights.where], is_new[weights.where[:2]]
            parts = (weights.pair[here], weights.taken[here & new], weights.stayed[here & ~new])
            use = math.fsum(np.concatenate(parts).tolist())
            low, high = _bounds(limit, weights)
            beyond = max(use - high, low - use, 0.0)
            if beyond > 0 and limit.penalty is None:
                raise ValueError(f"the plan breaks the limit {limit!r}: the sum is {use:g}")
            if beyond > 0:
                numbers.append(-(limit.penalty or 0.0) * beyond)
    # A penalty is rounded twice, and a rule may be a computed number: both stay on the safe side.
    penalties = sum(abs(x) for x in numbers[2 * T * n :])
    return sum_down([*numbers, -2.0 * _EPS * penalties] if penalties else numbers)


def _terms(problem: SAP, tasks: IntArray) -> list[float]:
    """Benefit and handover of every pair, step by step."""
    core, agents = problem.core, np.arange(problem.n)
    places = problem.placed(tasks).astype(np.int64)
    state = core.initial_state()
    out = []
    for k in range(problem.T):
        benefit = dense_step(core.benefits.step(k))[agents, places[k]]
        eta = core.handover(k, state)[agents, places[k]]
        if core.model.interacts:
            eta = eta + core.model.interaction(k, state, places[k])
        out += [*benefit.tolist(), *eta.tolist()]
        if not (np.isfinite(benefit) & np.isfinite(eta)).all():
            return [-math.inf]
        state = core.transition(k, state, places[k])
    return out


def _earned(problem: SAP, team: Team, tasks: IntArray) -> list[float]:
    (task,) = chosen(team.task, problem.m, problem.tasks, "task")
    steps = chosen(team.steps, problem.T, None, "steps")
    return [team.reward for k in steps if int((tasks[k] == task).sum()) >= team.needs]


def price_count(problem: SAP) -> int:
    """Multipliers beside those of tasks and teams: one for each row of the limits, then one for each disturbing pair of
    tasks and step."""
    disturbed = problem.model.disturbed()
    return problem.rows.count + (0 if disturbed is None else len(disturbed.pairs) * problem.T)


def limited_weight(problem: SAP, plan: IntArray) -> float:
    """The sizes of all handovers behind value and bound, added up; 0 for the plain switching rule, which is exact."""
    core = problem.core
    model = core.model.inner if isinstance(core.model, IdlePlace) else core.model
    if model.switching() is not None:
        return 0.0
    terms = np.array(_terms(problem, plan)).reshape(problem.T, 2, problem.n)
    own = float(np.abs(terms[:, 1]).sum())
    return own if model.disturbed() is not None else own + problem.n * _local_values(core, *_nothing(core))[1]


def _nothing(core: SAP) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    none = np.zeros((core.T, core.n, core.m))
    return none, none, none, False


def limited_bound(problem: SAP, prices: Any, limit_prices: Any, team_prices: Any) -> float:
    """Upper bound of the optimal value that prices and multipliers prove, rounded up.

    Parameters
    ----------
    problem : SAP
        With agent-local dynamics.
    prices : array_like, shape (T, m)
        Of the tasks; finite, not negative.
    limit_prices : array_like, shape (rows,)
        Positive for ``at_most``, negative for ``at_least``; at most the penalty of a soft limit. Where tasks disturb
        each other, T more for every pair, each from 0 to the loss, and 0 where one of the two takes several agents.
    team_prices : array_like, shape (teams,)
        Finite, not negative; one for each team and step, in order.

    Raises
    ------
    ValueError
        If they do not prove a bound, or the dynamics has no agent-local form.
    """
    T, n, m = problem.T, problem.n, problem.m
    mu, y, helpers = (
        _checked(values, name, shape, allow_negative)
        for values, name, shape, allow_negative in (
            (prices, "prices", (T, m), False),
            (limit_prices, "limit_prices", (price_count(problem),), True),
            (team_prices, "team_prices", (len(problem.rows.team_cell),), False),
        )
    )
    core = problem.core
    pair, taken, stayed = (np.zeros((T, n, core.m)) for _ in range(3))
    size = np.zeros((T, n, core.m))
    room = np.ones((T, m)) if problem.capacity is None else problem.capacity.astype(np.float64)
    fixed = (room * mu).ravel().tolist()
    pair[:, :, :m] += mu[:, None]
    size[:, :, :m] += mu[:, None]
    row = team = 0
    served = _served(problem)
    for limit in problem.limits:
        if isinstance(limit, Team):
            (task,) = chosen(limit.task, m, problem.tasks, "task")
            for k in chosen(limit.steps, T, None, "steps"):
                pair[k, :, task] -= helpers[team]
                size[k, :, task] += helpers[team]
                fixed.append(max(0.0, limit.reward - limit.needs * float(helpers[team])))
                team += 1
            continue
        for weights in _sums(problem, limit, served):
            price = float(y[row])
            row += 1
            if price == 0.0:
                continue
            low, high = _bounds(limit, weights)
            bound = high if price > 0 else low
            if not math.isfinite(bound):
                side = "at_most" if price > 0 else "at_least"
                raise ValueError(
                    f"limit_prices: number {row - 1} is a price of {side}, which {limit!r} has not"
                )
            if limit.penalty is not None and abs(price) > limit.penalty:
                raise ValueError(f"limit_prices: number {row - 1} is above the penalty of {limit!r}")
            fixed.append(price * bound)
            for part, weight in ((pair, weights.pair), (taken, weights.taken), (stayed, weights.stayed)):
                part[:, :, :m][weights.where] += price * weight
                size[:, :, :m][weights.where] += abs(price) * np.abs(weight)
    disturbed = core.model.disturbed()
    if disturbed is not None:
        for k in range(T):
            serves = dense_step(core.benefits.step(k)) > 0
            for number, ((a, b), loss) in enumerate(zip(disturbed.pairs, disturbed.loss, strict=True)):
                price = float(y[row + number * T + k])
                if price == 0.0:
                    continue
                if not 0.0 < price <= loss or max(room[k, a], room[k, b]) > 1:
                    raise ValueError(
                        f"limit_prices: {price!r} is no price of tasks {a} and {b}, which lose {loss!r} where both "
                        "are served"
                    )
                fixed.append(price)  # both are served where the agents on them are more than 1
                for j in (a, b):
                    pair[k, :, j] += price * serves[:, j]
                    size[k, :, j] += price * serves[:, j]
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows is refused below
        values, charges = _local_values(core, pair, taken, stayed, bool(taken.any() or stayed.any()))
        try:
            total = math.fsum([*values.tolist(), *fixed])
        except (OverflowError, ValueError):
            total = math.inf
    if not math.isfinite(total):
        raise ValueError("prices and benefits are so large that the bound overflows")
    most = charges + math.fsum(abs(x) for x in fixed) / n
    for k in range(T):
        benefit = dense_step(core.benefits.step(k))
        most += float(np.abs(benefit[np.isfinite(benefit)]).max(initial=0.0)) + float(size[k].max())
    # Every number of a path comes from at most 2 (rows + teams) + 8 roundings, and a path adds up 6 T of them.
    roundings = 6 * T + 2 * (len(y) + len(helpers)) + 12
    padding = roundings * _EPS * n * most + _EPS * abs(total)
    return math.nextafter(math.nextafter(total + padding, math.inf), math.inf)


def _checked(values: Any, name: str, shape: tuple[int, ...], allow_negative: bool) -> FloatArray:
    array = real_array(values, name)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all() or (not allow_negative and (array < 0).any()):
        raise ValueError(f"{name} must be finite{'' if allow_negative else ' and not negative'}")
    return array


def _local_values(
    core: SAP, pair: FloatArray, taken: FloatArray, stayed: FloatArray, remembers: bool
) -> tuple[FloatArray, float]:
    """Value of every agent's best path by plain dynamic programming, and the sum of the largest handovers.

    `pair`, `taken` and `stayed` (T, n, m) are taken from the gains: always, on taking a task up, on staying. Where
    something is taken at all that way, the state of an agent is joined by the task it held before.
    """
    disturbed = core.model.disturbed()
    model = core.model if disturbed is None else disturbed.alone
    rule = model.switching()  # of idleness beside it too, whose charges differ: not here
    if rule is not None and rule.uniform_cost is not None:
        return switching_values(core, rule, pair, taken, stayed), core.T * rule.uniform_cost
    states = model.local_model(core.benefits, core.initial_state()) if model.is_agent_local else None
    if states is None:
        raise ValueError(f"dynamics: {model.called} has no local_model, so prices prove nothing")
    T, n, m = core.T, core.n, core.m
    S, initial = states.state_count(), core.initial_assignment
    values, sizes = np.empty(n), np.zeros(T)
    for i in range(n):
        benefits = [dense_step(core.benefits.step(k))[i] for k in range(T)]
        moves = [states.step(k, i, benefits[k]) for k in range(T)]
        # to_go[s, b]: the best that can follow from state s with task b held before (one column if nobody asks)
        to_go = np.zeros((S, m + 1 if remembers else 1))
        for k in range(T - 1, -1, -1):
            successor, handover = (np.broadcast_to(part, (S, m)) for part in moves[k])
            finite = np.abs(handover[np.isfinite(handover)])
            sizes[k] = max(sizes[k], float(finite.max(initial=0.0)))
            after = to_go[successor, np.arange(m) if remembers else 0]
            gain = (benefits[k] - pair[k, i])[None, :] + handover + after
            if not remembers:
                to_go = gain.max(axis=1, keepdims=True)
                continue
            fresh = gain - taken[k, i]
            to_go = np.empty((S, m + 1))
            for b in range(m):
                here = fresh.copy()
                here[:, b] = gain[:, b] - stayed[k, i, b]
                to_go[:, b] = here.max(axis=1)
            to_go[:, m] = fresh.max(axis=1)
        before = 0 if not remembers else m if initial is None else int(initial[i])
        values[i] = to_go[states.start(i), before]
    return values, float(sizes.sum())
