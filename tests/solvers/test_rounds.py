"""Which windows a round solves."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from sapopt.solvers.dual_decomposition.network_plans.rounds import Rounds


def taken(rounds: Rounds, gains: dict[int, float], count: int, distance: float = 100.0) -> list[int]:
    """Lengths of the windows of so many rounds of a second each, where a window of a length gains so much."""
    lengths = []
    for turn in range(count):
        effort, _ = rounds.paying(distance, seconds_left=count - turn)
        rounds.learn(effort, gains.get(effort.length, 0.0), 1.0)
        lengths.append(effort.length)
    return lengths


def test_without_a_clock_windows_grow() -> None:
    """Twice windows and once groups of every size, and the largest in the end."""
    plans = [Rounds(93).planned(turn) for turn in range(20)]
    assert [effort.length for effort, _ in plans[:7]] == [10, 10, 93, 15, 15, 93, 20]
    assert [shift for _, shift in plans[:4]] == [0, 5, 0, 0]
    assert plans[18][0].length == 40


def test_small_windows_go_on_while_they_pay() -> None:
    """Nothing larger is tried as long as they are on the way to close the gap."""
    assert set(taken(Rounds(93), {10: 20.0}, 8)[:6]) == {10}


def test_time_goes_to_what_gains_most() -> None:
    """Once everything was tried, the best length has the rest."""
    lengths = taken(Rounds(93), {10: 0.1, 15: 0.3, 20: 0.2, 93: 0.01}, 30)
    assert lengths[:6] == [10, 15, 20, 30, 40, 93]
    assert set(lengths[6:]) == {15}


def test_where_nothing_is_gained_all_take_turns() -> None:
    """No length is left out and none comes twice as often as another."""
    lengths = taken(Rounds(93), {}, 60)
    assert all(lengths.count(length) == 10 for length in (10, 15, 20, 30, 40, 93))


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=40))
def test_shifts_lie_within_the_windows(gains: list[float]) -> None:
    """Windows begin anywhere within their length, groups at the first step, whatever was gained."""
    rounds = Rounds(50)
    for gain in gains:
        effort, shift = rounds.paying(5.0, 10.0)
        assert 0 <= shift < effort.length
        assert shift == 0 or effort.length < 50
        rounds.learn(effort, gain, 0.5)


def test_rolling_windows_come_again_where_windows_gain_little() -> None:
    """Only where there was a first time, all windows were tried, and there is time for as much again."""
    rounds = Rounds(60)
    assert not rounds.wants_front(1.0, 1e3)  # there was none
    rounds.learn_front(5.0, 10.0)
    assert not rounds.wants_front(1.0, 1e3)  # windows may still gain
    taken(rounds, {}, 8)
    assert rounds.wants_front(1.0, 1e3)
    assert not rounds.wants_front(1.0, 11.0)
    assert not rounds.wants_front(1.0, math.inf)
    rounds.learn_front(0.0, 10.0)
    assert not rounds.wants_front(1.0, 20.0)  # it gained nothing: not so soon again
    assert rounds.wants_front(1.0, 40.0)
