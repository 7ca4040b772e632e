"""The recursions of `hard` where only tasks in sight matter: O(R + tasks in sight) a step and agent.

For ``needs_sight`` where tasks of no benefit are free (no cost, or idling is free): all tasks that are not stored are
then alike but for their prices, lead to the state "none", and cost the same from every state.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sapopt.data.types import FloatArray, IntArray
from sapopt.kernels.blocks import work_array
from sapopt.kernels.jit import njit

_CANCELLED = 1e-9
"""Share of all weights below which a difference of theirs is not to be trusted."""


@njit(cache=True, nogil=True, inline="always")
def _charge(value, cost, forfeit):
    return cost + forfeit * value if value > 0.0 else 0.0


@njit(cache=True, borrows=True, nogil=True)
def _cheapest(order, row, mark, stamp):
    """The cheapest task that is not marked, -1 if all are: the first such one of the order, if there is one."""
    for position in range(len(order)):
        if mark[order[position]] != stamp:
            return order[position]
    found = -1
    for j in range(0 if len(order) > 0 else len(row)):
        if mark[j] != stamp and (found < 0 or row[j] < row[found]):
            found = j
    return found
    return -1


@njit(cache=True, borrows=True, nogil=True)
def _to_go(i, first, window, prices, order, mark, stamps, best, move):
    """Value to go ``best`` (T + 1, R + 1) and the best task ``move`` (T,) of who pays, from step `first` on."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T = prices.shape[0]
    best[T, :] = 0.0
    for k in range(T - 1, first - 1, -1):
        lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
        stamps[0] += 1
        for e in range(lo, hi):
            mark[indices[e]] = stamps[0]
        choice = _cheapest(order[k], prices[k], mark, stamps[0])
        top = -np.inf if choice < 0 else best[k + 1, R] - prices[k, choice]
        for e in range(lo, hi):
            j, value = indices[e], data[e]
            following = best[k + 1, real[j]] if value > 0.0 else best[k + 1, R]
            moved = value - prices[k, j] + following - _charge(value, cost, forfeit)
            if moved > top:
                top, choice = moved, j
        move[k] = choice
        for r in range(best.shape[1]):
            best[k, r] = top
        for e in range(lo, hi):
            j, value = indices[e], data[e]
            if value > 0.0:
                kept = value - prices[k, j] + best[k + 1, real[j]]
                best[k, real[j]] = max(best[k, real[j]], kept)


@njit(cache=True, nogil=True)
def paths(agents, window, prices, order, values, plan):
    """Longest paths: ``values`` (len(agents),) and ``plan`` (T, len(agents)) are filled."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    mark = np.zeros(m, np.int64)
    stamps = np.zeros(1, np.int64)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    for a in range(len(agents)):
        i = agents[a]
        _to_go(i, np.int64(0), window, prices, order, mark, stamps, best, move)
        r = start[i]
        for k in range(T):
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            j = move[k]
            top = best[k, R]
            free = r == R + 1
            for e in range(lo, hi):
                task, value = indices[e], data[e]
                if value > 0.0 and (free or real[task] == r):
                    kept = value - prices[k, task] + best[k + 1, real[task]]
                    if kept > top:
                        top, j = kept, task
            if k == 0:
                values[a] = top
            plan[k, a] = j
            r = R
            for e in range(lo, hi):
                if indices[e] == j and data[e] > 0.0:
                    r = real[j]


@njit(cache=True, nogil=True)
def first_values(window, prices, order, out):
    """Value of every agent's best path that starts with every task, without the first step's prices; fills (n, m)."""
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    T, m = prices.shape
    mark = np.zeros(m, np.int64)
    stamps = np.zeros(1, np.int64)
    best = np.empty((T + 1, R + 1))
    move = np.empty(T, np.int64)
    for i in range(n):
        _to_go(i, np.int64(1), window, prices, order, mark, stamps, best, move)
        out[i, :] = best[1, R]
        for e in range(indptr[i], indptr[i + 1]):
            j, value = indices[e], data[e]
            out[i, j] = value + (best[1, real[j]] if value > 0.0 else best[1, R])
            if start[i] != R + 1 and start[i] != real[j]:
                out[i, j] -= _charge(value, cost, forfeit)


class SeenScratch(NamedTuple):
    """Work arrays of `soft_paths`; an agent's entries lie end to end, step by step.

    Attributes
    ----------
    none : (T + 1,) float64
        Log weight of all that follows a step before which nothing that counts is held.
    idle, unseen : (T,) float64
        Probability that such an agent takes a task that is not stored, and the weight of these tasks.
    crowded : (T,) bool
        Whether hardly any weight is left to them.
    keep : (most entries,) float64
        Log weight of an entry and what follows, for who holds its real task.
    enter : (most entries,) float64
        First the same for who moves there; then the probability that an agent that holds nothing does.
    stay, leave : (most entries,) float64
        For who holds the real task of an entry: by how much more probable the entry is than for one who enters, and
        the weight of who holds nothing relative to theirs.
    level, share, chance : (R,) float64
        By real task: a log weight and a factor of it, which together are the weight of what follows; the probability
        to hold it.
    level_at, share_at, chance_at, active : (R,) int64
        When these were written, for what is older counts as nothing; and the tasks that may be held.
    mark : (m,) int64
        When a task was seen last.
    """

    none: FloatArray
    idle: FloatArray
    unseen: FloatArray
    crowded: NDArray[np.bool_]
    keep: FloatArray
    enter: FloatArray
    stay: FloatArray
    leave: FloatArray
    level: FloatArray
    share: FloatArray
    chance: FloatArray
    level_at: IntArray
    share_at: IntArray
    chance_at: IntArray
    active: IntArray
    mark: IntArray


def seen_scratch(T: int, m: int, real: int, entries: int) -> tuple[SeenScratch]:
    """Work arrays of one thread, for at most so many entries of an agent."""

    def times(count: int) -> IntArray:
        return work_array(count, np.int64, fill=0)

    return (
        SeenScratch(
            work_array(T + 1), work_array(T), work_array(T), work_array(T, np.bool_),
            work_array(entries), work_array(entries), work_array(entries), work_array(entries),
            work_array(real), work_array(real), work_array(real),
            times(real), times(real), times(real), times(real), times(m),
        ),
    )  # fmt: skip


@njit(cache=True, borrows=True, nogil=True)
def soft_paths(begin, end, window, prices, weight, everything, temperature, values, scratch, usage, common):
    """Soft values (n,) of the agents of a block, and their usage; see `hard.soft_paths`.

    What is not in sight counts in sums: the weight of all tasks of a step, `everything` (T,), less that of the stored
    ones. Where next to nothing is left of that, it is added up task by task, for the difference would be rounding.
    With logarithms of weights, so that a share of a great benefit may be forfeited at any temperature, backward

        keep_k[e]  = (benefit - price) / temperature + level_{k+1}[real task]   (none_{k+1} without a benefit)
        enter_k[e] = keep_k[e] - charge / temperature
        none_k     = log(unseen_k exp(none_{k+1}) + sum_e exp(enter_k[e]))
        level_k[r] = log(exp(none_k) + sum over the entries e of r of (exp(keep_k[e]) - exp(enter_k[e])))

    where a real task without an entry is worth what nothing is, so that a step costs a visit to each of its entries,
    however many real tasks there are. Forward the agent holds nothing, or one of the real tasks of the last step.

    Every task j of a step k that an agent has no entry for is used by ``weight[k, j]`` times a number of the agent and
    the step alone: the sum of these numbers is added to `common` (T,), and what is stored makes up for it in `usage`
    (T, m). A value that is not a number says that nothing that is allowed has a weight in the range of floats.
    """
    n, indptr, indices, data, real, R, cost, forfeit, idle_free, sight, start = window
    none, idle, unseen, crowded = scratch.none, scratch.idle, scratch.unseen, scratch.crowded
    keep, enter, stay, leave = scratch.keep, scratch.enter, scratch.stay, scratch.leave
    level, share, chance = scratch.level, scratch.share, scratch.chance
    level_at, share_at, chance_at = scratch.level_at, scratch.share_at, scratch.chance_at
    active, mark = scratch.active, scratch.mark
    T = prices.shape[0]
    colder = 1.0 / temperature
    for i in range(begin, end):
        now = i * (2 * T + 2) + 1  # the present step of either recursion; the arrays hold zeros at first
        g = 0
        for k in range(T):
            g += indptr[k * n + i + 1] - indptr[k * n + i]
        if g == 0:  # in a short window most agents see nothing, and are alike
            log_z = 0.0
            for k in range(T):
                log_z += np.log(everything[k])
                common[k] += 1.0 / everything[k]
            values[i] = temperature * log_z
            continue
        none[T] = 0.0
        for k in range(T - 1, -1, -1):
            later, now = now, now + 1
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            g -= hi - lo
            left = everything[k]
            for e in range(lo, hi):
                left -= weight[k, indices[e]]
            crowded[k] = left < _CANCELLED * everything[k]
            if crowded[k]:
                left = _unmarked_weight(indices, lo, hi, weight[k], mark, now)
            unseen[k] = left
            rest = np.log(left) + none[k + 1] if left > 0.0 else -np.inf
            top = rest
            for e in range(lo, hi):
                j, benefit = indices[e], data[e]
                r = real[j]
                following = none[k + 1]
                if benefit > 0.0 and level_at[r] == later:
                    following = level[r] + np.log(share[r])
                kept = (benefit - prices[k, j]) * colder + following
                keep[g + e - lo] = kept
                kept -= _charge(benefit, cost, forfeit) * colder
                enter[g + e - lo] = kept
                top = max(top, kept)
            if top == -np.inf:  # nothing can be entered, and no task is left to idle on
                none[k], idle[k] = -np.inf, 0.0
            else:
                total = np.exp(rest - top)
                for e in range(lo, hi):
                    total += _exp(enter[g + e - lo] - top)
                idle[k] = np.exp(rest - top) / total
                none[k] = top + np.log(total)
            for e in range(lo, hi):
                if data[e] > 0.0:
                    r = real[indices[e]]
                    if level_at[r] != now:
                        level_at[r], level[r] = now, none[k]
                    level[r] = max(level[r], keep[g + e - lo])
            for e in range(lo, hi):
                q = g + e - lo
                if data[e] > 0.0:
                    r = real[indices[e]]
                    if share_at[r] != now:
                        share_at[r], share[r] = now, _ratio(none[k], level[r])
                    stay[q] = _ratio(keep[q], level[r]) - _ratio(enter[q], level[r])
                    share[r] += stay[q]
            for e in range(lo, hi):
                q = g + e - lo
                enter[q] = _ratio(enter[q], none[k])
                if data[e] > 0.0:
                    r = real[indices[e]]
                    leave[q] = _ratio(none[k], level[r])
                    if share[r] > 0.0:
                        stay[q] /= share[r]
                        leave[q] /= share[r]
        before = start[i]
        log_z = none[0]
        if before < R and level_at[before] == now:
            log_z = level[before] + np.log(share[before])
        first_hi = indptr[i + 1]
        if before == R + 1:  # the first step is free
            rest = np.log(unseen[0]) + none[1] if unseen[0] > 0.0 else -np.inf
            top = rest
            for e in range(indptr[i], first_hi):
                top = max(top, keep[e - indptr[i]])
            total = _ratio(rest, top)
            for e in range(indptr[i], first_hi):
                total += _ratio(keep[e - indptr[i]], top)
            log_z = top + np.log(total) if total > 0.0 else -np.inf
        if not log_z > -np.inf:
            values[i] = np.nan
            continue
        values[i] = temperature * log_z
        nothing = 1.0 if before == R else 0.0  # the probability to hold nothing
        count = 0
        if before < R:
            active[0], chance[before] = before, 1.0
            count = 1
        g = 0
        for k in range(T):
            now += 1
            lo, hi = indptr[k * n + i], indptr[k * n + i + 1]
            for e in range(lo, hi):
                if data[e] > 0.0:
                    r = real[indices[e]]
                    level_at[r], level[r] = now, leave[g + e - lo]
            enters = nothing  # what is to be multiplied by the probabilities of who holds nothing
            for a in range(count):
                r = active[a]
                share_at[r], share[r] = now, chance[r]
                enters += chance[r] * (level[r] if level_at[r] == now else 1.0)
            is_free = k == 0 and before == R + 1
            idles = (
                _ratio(np.log(unseen[0]) + none[1], log_z)
                if is_free and unseen[0] > 0.0
                else enters * idle[k]
            )
            each = idles / unseen[k] if unseen[k] > 0.0 else 0.0
            if crowded[k]:
                _use_unmarked(indices, lo, hi, weight[k], mark, now, each, usage[k])
                each = 0.0
            common[k] += each
            nothing = idles
            count = 0
            for e in range(lo, hi):
                q = g + e - lo
                j = indices[e]
                r = real[j]
                used = _ratio(keep[q], log_z) if is_free else enters * enter[q]
                if data[e] > 0.0:
                    if share_at[r] == now and not is_free:
                        used += share[r] * stay[q]
                    if used > 0.0:
                        if chance_at[r] != now:
                            chance_at[r], chance[r] = now, 0.0
                            active[count] = r
                            count += 1
                        chance[r] += used
                else:
                    nothing += used
                usage[k, j] += used - weight[k, j] * each
            g += hi - lo


@njit(cache=True, nogil=True, inline="always")
def _exp(x):
    """exp, next to nothing as 0: most weights of a cold step are."""
    return np.exp(x) if x > -40.0 else 0.0


@njit(cache=True, nogil=True, inline="always")
def _ratio(log_weight, log_whole):
    """A weight divided by a larger one; 0 where both are."""
    return _exp(log_weight - log_whole) if log_weight > -np.inf else 0.0


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _unmarked_weight(indices, lo, hi, weight, mark, now):
    """Weight of the tasks that are not among ``indices[lo:hi]``, which get marked, added up one by one."""
    for e in range(lo, hi):
        mark[indices[e]] = now
    total = 0.0
    for j in range(weight.size):
        if mark[j] != now:
            total += weight[j]
    return total


@njit(cache=True, borrows=True, nogil=True, no_cpython_wrapper=True)
def _use_unmarked(indices, lo, hi, weight, mark, now, each, usage):
    """Add ``weight * each`` to the usage of the tasks that are not among ``indices[lo:hi]``, which get marked."""
    for e in range(lo, hi):
        mark[indices[e]] = now
    for j in range(weight.size):
        if mark[j] != now:
            usage[j] += weight[j] * each
