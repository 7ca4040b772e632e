"""A compiled dive: agents plan some steps anew by fixing what their softened paths agree on, a little at a time.

Under prices and a temperature every agent walks at random, better paths more often (the Gibbs distribution of its
paths); a task that is expected to be used more than once gets dearer, one that is used less gets cheaper. Once that has
settled a little, the pairs that are nearly sure are fixed, at least a share of all: the agent goes nowhere else at that
step, and nobody else goes there. Then the rest settles anew. In the end everything is fixed. This is decimation, as of
survey propagation (Braunstein, Mezard and Zecchina 2005), with the soft dual in place of messages, or a dive with
prices ascended anew (Sadykov and others 2019).
"""

from __future__ import annotations

import math
from collections import namedtuple

from sapopt.kernels.jit import njit
from sapopt.solvers.dual_decomposition.exchanges.rule import earned, span

Work = namedtuple(
    "Work",
    "weight usage claim chosen start old task origin same move stay price forward backward soft dropped bins",
)
"""Arrays to work on, see `work_for`."""

Pace = namedtuple("Pace", "temperature charge rounds share sure")
"""Temperature; weights ``exp(-cost / temperature)`` (m, m) of moves where a matrix tells costs, else empty; rounds
of settling before every fixing; share of the agents' steps that is fixed at a time, at least; share of an agent's walks
from which on a pair is fixed anyhow."""

_BINS = 512
"""Classes of sureness."""

_UNLIKELY = 1e-6
"""Share of its walks below which an agent does not come to a task again."""

_LEAST = 1e-290
"""Least weight of a price."""


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _gather(rule, cells, plan, owner, agents, first, last, temperature, work):  # type: ignore[no-untyped-def]
    """List what is still open to the agents; return how many rows have nothing left and were given up."""
    steps = plan.shape[0]
    width = last - first
    given_up = 0
    position = 0
    for a in range(len(agents)):
        i = agents[a]
        for t in range(width):
            k = first + t
            row = a * width + t
            work.start[row] = position
            before = plan[k - 1, i] if k > 0 else rule.initial[i]
            lo, hi = cells.start[i * steps + k], cells.start[i * steps + k + 1]
            if work.chosen[row] >= 0:
                lo = work.chosen[row]
                hi = lo + 1
            highest = -math.inf
            for c in range(lo, hi):
                j = cells.task[c]
                if work.chosen[row] < 0 and (owner[k, j] >= 0 or work.dropped[c] > 0):
                    continue
                work.task[position], work.origin[position], work.same[position] = j, c, -1
                move, stay = cells.move[c], cells.stay[c]
                if t == 0:
                    move = earned(rule, k, i, before, j)
                    stay = move
                else:
                    for p in range(work.start[row - 1], work.start[row]):
                        if work.task[p] == j:
                            work.same[position] = p
                            break
                if t == width - 1 and last < steps:
                    on = earned(rule, last, i, j, plan[last, i])
                    move, stay = move + on, stay + on
                work.move[position], work.stay[position] = move, stay
                highest = max(highest, move)
                if work.same[position] >= 0:
                    highest = max(highest, stay)
                position += 1
            if position == work.start[row]:  # anything, found in the end
                if work.chosen[row] == -1:
                    work.chosen[row] = -2
                    given_up += 1
                work.task[position], work.origin[position], work.same[position] = -1, -1, -1
                work.move[position], work.stay[position] = 0.0, 0.0
                highest = 0.0
                position += 1
            for p in range(work.start[row], position):
                work.move[p] = math.exp((work.move[p] - highest) / temperature)
                stay = math.exp((work.stay[p] - highest) / temperature) if work.same[p] >= 0 else 0.0
                work.stay[p] = stay - work.move[p] if work.same[p] >= 0 else 0.0
    work.start[len(agents) * width] = position
    return given_up


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _walk(charge, agent, first, last, work):  # type: ignore[no-untyped-def]
    """The distribution of one agent's walks, into `soft` and added to `usage`."""
    width = last - first
    for t in range(width):
        row = agent * width + t
        lo, hi = work.start[row], work.start[row + 1]
        total = 0.0
        for p in range(lo, hi):
            j = work.task[p]
            price = work.weight[first + t, j] if j >= 0 else 1.0
            value = 1.0
            if t > 0 and charge.shape[0] > 0 and j >= 0:
                value = 0.0
                for q in range(work.start[row - 1], lo):
                    other = work.task[q]
                    value += work.forward[q] * (charge[other, j] if other >= 0 else 1.0)
                value *= work.move[p]
            elif t > 0:
                value = work.move[p]
                if work.same[p] >= 0:
                    value += work.stay[p] * work.forward[work.same[p]]
            else:
                value = work.move[p]
            work.price[p] = price
            work.forward[p] = value * price
            total += value * price
        scale = 1.0 / max(total, _LEAST)
        for p in range(lo, hi):
            work.forward[p] *= scale
    for t in range(width - 1, -1, -1):
        row = agent * width + t
        lo, hi = work.start[row], work.start[row + 1]
        if t == width - 1:
            for p in range(lo, hi):
                work.backward[p] = 1.0
        else:
            end = work.start[row + 2]
            if charge.shape[0] > 0:
                for p in range(lo, hi):
                    j, value = work.task[p], 0.0
                    for q in range(hi, end):
                        other = work.task[q]
                        toll = charge[j, other] if j >= 0 and other >= 0 else 1.0
                        value += toll * work.move[q] * work.price[q] * work.backward[q]
                    work.backward[p] = value
            else:
                value = 0.0
                for q in range(hi, end):
                    value += work.move[q] * work.price[q] * work.backward[q]
                for p in range(lo, hi):
                    work.backward[p] = value
                for q in range(hi, end):
                    if work.same[q] >= 0:
                        work.backward[work.same[q]] += work.stay[q] * work.price[q] * work.backward[q]
            highest = 0.0
            for p in range(lo, hi):
                highest = max(highest, work.backward[p])
            scale = 1.0 / max(highest, _LEAST)
            for p in range(lo, hi):
                work.backward[p] *= scale
        total = 0.0
        for p in range(lo, hi):
            work.soft[p] = work.forward[p] * work.backward[p]
            total += work.soft[p]
        scale = 1.0 / max(total, _LEAST)
        for p in range(lo, hi):
            work.soft[p] *= scale
            if work.task[p] >= 0:
                work.usage[first + t, work.task[p]] += work.soft[p]


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _settle(rule, charge, count, owner, first, last, rounds, work):  # type: ignore[no-untyped-def]
    """Let prices and walks settle for some rounds."""
    tasks = owner.shape[1]
    spare = owner.shape[1] > rule.agents
    for _ in range(rounds):
        for k in range(first, last):
            for j in range(tasks):
                work.usage[k, j] = 0.0
        for a in range(count):
            _walk(charge, a, first, last, work)
        for k in range(first, last):
            for j in range(tasks):
                if owner[k, j] < 0:
                    # the step of the smooth descent: the price grows by rate * temperature * log(usage), rate 1/4
                    weight = work.weight[k, j] / math.sqrt(math.sqrt(max(work.usage[k, j], 1e-3)))
                    if spare:
                        weight = min(weight, 1.0)
                    work.weight[k, j] = max(weight, _LEAST)


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _fix(agents, owner, first, last, wanted, sure, work):  # type: ignore[no-untyped-def]
    """Fix what is sure, at least so many rows; return how many."""
    width = last - first
    for b in range(_BINS + 1):
        work.bins[b] = 0
    for row in range(len(agents) * width):
        if work.chosen[row] != -1:
            continue
        k = first + row % width
        best, which = -1.0, work.start[row]
        for p in range(work.start[row], work.start[row + 1]):
            if work.soft[p] > best:
                best, which = work.soft[p], p
            if work.soft[p] < _UNLIKELY:
                work.dropped[work.origin[p]] = 1
        work.dropped[work.origin[which]] = 0
        best /= max(1.0, work.usage[k, work.task[which]])
        work.bins[int(best * _BINS)] += 1
        # kept where no walk needs them before the next gathering
        work.forward[work.start[row]], work.same[work.start[row]] = best, which
        work.claim[k, work.task[which]] = max(work.claim[k, work.task[which]], best)
    level, found = _BINS, work.bins[_BINS]
    while level > 0 and found < wanted:
        level -= 1
        found += work.bins[level]
    least = min(level / _BINS, sure)
    fixed = 0
    for row in range(len(agents) * width):
        if work.chosen[row] != -1:
            continue
        k = first + row % width
        best, which = work.forward[work.start[row]], work.same[work.start[row]]
        j = work.task[which]
        if best >= least and best >= work.claim[k, j] and owner[k, j] < 0:
            work.chosen[row] = work.origin[which]
            owner[k, j] = agents[row // width]
            fixed += 1
    for row in range(len(agents) * width):
        which = work.same[work.start[row]]
        if which >= 0 and work.task[which] >= 0:
            work.claim[first + row % width, work.task[which]] = 0.0
    return fixed


@njit(borrows=True, nogil=True)
def dive(rule, cells, pace, plan, owner, agents, first, last, prices, least, over, work):  # type: ignore[no-untyped-def]
    """Plan some agents anew over some steps, in place where that gains `least` or more; return the gain, else -inf.

    Parameters
    ----------
    rule : PairRule
    cells : Candidates
    pace : Pace
    plan : (T, n) int64
    owner : (T, m) int32
        Who holds a task, -1 for nobody.
    agents : (count,) int64
    first, last : int
        Steps first..last - 1.
    prices : (T, m)
    least : float
        Gain below which everything stays as it is.
    over : (1,) int64
        Not 0 once the time is over.
    work : Work
    """
    width, tasks = last - first, owner.shape[1]
    rows = len(agents) * width
    before = 0.0
    for a in range(len(agents)):
        i = agents[a]
        before += span(rule, plan, i, first, last)
        for t in range(width):
            k = first + t
            owner[k, plan[k, i]] = -1
            work.old[a * width + t] = plan[k, i]
            work.chosen[a * width + t] = -1
            for c in range(cells.start[i * plan.shape[0] + k], cells.start[i * plan.shape[0] + k + 1]):
                work.dropped[c] = 0
    for k in range(first, last):
        for j in range(tasks):
            work.weight[k, j] = max(math.exp(-prices[k, j] / pace.temperature), _LEAST)
            work.claim[k, j] = 0.0
    left, wanted = rows, max(int(pace.share * rows), 1)
    while left > 0 and over[0] == 0:
        left -= _gather(rule, cells, plan, owner, agents, first, last, pace.temperature, work)
        if left > 0:
            _settle(rule, pace.charge, len(agents), owner, first, last, pace.rounds, work)
            left -= _fix(agents, owner, first, last, wanted, pace.sure, work)
    if left == 0:
        for row in range(rows):
            i, k = agents[row // width], first + row % width
            if work.chosen[row] >= 0:
                plan[k, i] = cells.task[work.chosen[row]]
        for row in range(rows):
            i, k = agents[row // width], first + row % width
            if work.chosen[row] < 0:
                _complete(rule, plan, owner, i, k)
        after = 0.0
        for a in range(len(agents)):
            after += span(rule, plan, agents[a], first, last)
        if after - before >= least:
            return after - before
    for row in range(rows):
        k = first + row % width
        if left == 0:
            owner[k, plan[k, agents[row // width]]] = -1
        elif work.chosen[row] >= 0:
            owner[k, cells.task[work.chosen[row]]] = -1
    for row in range(rows):
        i, k = agents[row // width], first + row % width
        plan[k, i] = work.old[row]
        owner[k, plan[k, i]] = i
    return -math.inf


@njit(borrows=True, nogil=True, no_cpython_wrapper=True)
def _complete(rule, plan, owner, i, k):  # type: ignore[no-untyped-def]
    """Give agent i the best free task at step k."""
    before = plan[k - 1, i] if k > 0 else rule.initial[i]
    best, task = -math.inf, -1
    for j in range(owner.shape[1]):
        if owner[k, j] < 0:
            value = earned(rule, k, i, before, j)
            if k + 1 < plan.shape[0]:
                value += earned(rule, k + 1, i, j, plan[k + 1, i])
            if task < 0 or value > best:
                best, task = value, j
    plan[k, i] = task
    owner[k, task] = i
