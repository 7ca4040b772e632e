"""Algorithm 2 of the thesis by brute force over all assignments, in any kind of numbers; nothing from sapopt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations
from typing import Any

Tasks = tuple[int, ...]


def partitions(length: int) -> Iterator[list[tuple[int, int]]]:
    """Q_L: all ways to cut ``0 .. length - 1`` into intervals (first, one past the last)."""
    for mask in range(2 ** (length - 1)):
        ends = [t + 1 for t in range(length - 1) if mask >> t & 1] + [length]
        yield list(zip([0, *ends[:-1]], ends, strict=True))


class Tied(Exception):
    """Some choice is free: two assignments, or two sequences, are worth the same."""


def haal(
    sizes: tuple[int, int, int],
    start: Any,
    entered: Callable[[int, int, Any, Tasks], Any],
    play: Callable[[int, Any, Tasks], tuple[Any, Any] | None],
    lookahead: int,
    near: Any,
) -> list[Tasks]:
    """The plan of HAAL.

    Parameters
    ----------
    sizes : (T, n, m)
    start : state
    entered : callable
        ``entered(k, stop, state, tasks)``: what line 9 chooses by, the benefits of steps ``k .. stop - 1`` and the
        handovers of step k; None where a pair is forbidden.
    play : callable
        ``play(k, state, tasks) -> (value, state after)``, None where a pair is forbidden.
    lookahead : int
    near : number
        Values nearer than that are equal.

    Raises
    ------
    Tied
        If a choice is not determined.
    """
    T, n, m = sizes
    every = list(permutations(range(m), n))

    def alpha(k: int, stop: int, state: Any) -> Tasks | None:
        worth = [(w, x) for x in every if (w := entered(k, stop, state, x)) is not None]
        if not worth:
            return None
        best = max(w for w, _ in worth)
        top = [x for w, x in worth if w >= best - near]
        if len(top) > 1:
            raise Tied
        return top[0]

    def sequence(k: int, cuts: list[tuple[int, int]], state: Any) -> tuple[Any, Tasks] | None:
        total, first = 0, None
        for a, b in cuts:
            x = alpha(k + a, k + b, state)
            if x is None:
                return None
            first = first or x
            for t in range(k + a, k + b):
                played = play(t, state, x)
                if played is None:
                    return None
                total, state = total + played[0], played[1]
        assert first is not None
        return total, first

    state, plan = start, []
    for k in range(T):
        found = [
            s for cuts in partitions(min(lookahead, T - k)) if (s := sequence(k, cuts, state)) is not None
        ]
        if not found:
            raise Tied  # no sequence goes through; what is played then is not said
        best = max(value for value, _ in found)
        firsts = {x for value, x in found if value >= best - near}
        if len(firsts) > 1:
            raise Tied
        plan.append(firsts.pop())
        played = play(k, state, plan[-1])
        assert played is not None
        state = played[1]
    return plan
