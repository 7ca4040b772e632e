"""HiGHS as this library runs it: limits, interruptions, and programmes that grow."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from sapopt.formulations import highs
from sapopt.formulations.highs import Ending, GrowingProgramme, Programme, maximise


def packing(seed: int, rows: int = 12, columns: int = 30) -> Programme:
    """A random packing programme whose relaxation is fractional."""
    rng = np.random.default_rng(seed)
    matrix = sp.csc_array((rng.random((rows, columns)) < 0.3).astype(float))
    free = np.full(rows, -np.inf)
    return Programme(
        rng.random(columns), matrix, free, np.ones(rows), np.ones(columns), np.ones(columns, dtype=bool)
    )


@pytest.mark.parametrize("unit", [0.5, 1.0, 300.0, 4000.0])
@pytest.mark.parametrize("rest", [0.0, 1.0])
def test_a_start_is_not_taken_for_optimal(unit: float, rest: float) -> None:
    """One of two, and places for two others that are all worth the same: the start has the worse of the two."""
    choice, places = np.eye(2).repeat(4, axis=1), np.tile(np.eye(4), 2)
    rows = np.zeros((7, 10))
    rows[0, :2], rows[1:3, 2:], rows[3:, 2:] = 1.0, choice, places
    low = np.array([1.0] * 3 + [-np.inf] * 4)
    gain = unit * np.array([0.9, 0.8999] + [rest] * 8)
    programme = Programme(gain, rows, low, np.ones(7), np.ones(10), np.ones(10, dtype=bool))
    start = np.zeros(10)
    start[[1, 2, 7]] = 1.0
    answer = maximise(programme, start=start)
    assert answer.ending is Ending.OPTIMAL
    assert answer.value == pytest.approx(unit * (0.9 + 2 * rest), rel=1e-9)
    assert answer.bound >= answer.value
    assert answer.x is not None
    assert answer.x[0] == pytest.approx(1.0)


def test_writing_a_programme_down_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """When handing a programme over took all the time, HiGHS is not started any more."""
    clock = [0.0]
    plain = highs._model

    def slow(*args: Any) -> Any:
        clock[0] += 100.0
        return plain(*args)

    monkeypatch.setattr(highs, "_model", slow)
    monkeypatch.setattr(highs, "_run", lambda *args: pytest.fail("started"))
    monkeypatch.setattr(highs.time, "monotonic", lambda: clock[0])
    answer = maximise(packing(0), seconds=99.0)
    assert answer.ending is Ending.TIME_LIMIT
    assert answer.x is None
    assert answer.bound == np.inf


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_watch_that_raises_leaves_no_thread(error: type[BaseException]) -> None:
    """Whatever ends the wait, HiGHS is stopped first: it must not call into a Python that has gone."""
    before = threading.active_count()

    def watch(value: float, bound: float) -> bool:
        raise error

    with pytest.raises(error):
        maximise(packing(1), watch=watch)
    assert threading.active_count() == before


def test_more_interruptions_while_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who presses Ctrl-C again and again gets his KeyboardInterrupt once HiGHS has ended."""
    done = threading.Event()
    worker = threading.Thread(target=done.wait)
    worker.start()
    plain, presses = worker.join, [3]

    def join(timeout: float | None = None) -> None:
        presses[0] -= 1
        if presses[0]:
            raise KeyboardInterrupt
        done.set()
        plain(timeout)

    monkeypatch.setattr(worker, "join", join)
    with pytest.raises(KeyboardInterrupt):
        highs._wait(worker)
    assert not worker.is_alive()


@pytest.mark.parametrize("first_slice", [0.1, 1e-6])
@pytest.mark.parametrize("seed", range(5))
def test_growing_meets_whole(seed: int, first_slice: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Columns and rows added one after the other, solved in between and in slices, give the optimum of the whole."""
    monkeypatch.setattr(highs, "_FIRST_SLICE", first_slice)
    whole = packing(seed)
    part = Programme(
        whole.gain[:10],
        whole.rows[:8, :10],
        whole.low[:8],
        whole.high[:8],
        np.full(10, np.inf),
        whole.integer[:10],
    )
    growing = GrowingProgramme(part)
    assert growing.solve()
    growing.add_columns(whole.gain[10:], whole.rows[:8, 10:])
    assert growing.solve()
    growing.add_rows(whole.rows[8:], whole.high[8:])
    growing.set_upper(np.arange(30), np.ones(30))
    assert growing.solve()
    relaxed = maximise(whole, relaxed=True)
    assert float(whole.gain @ growing.x) == pytest.approx(relaxed.value)
    assert relaxed.duals is not None
    assert float(whole.high @ np.maximum(growing.duals, 0.0)) <= relaxed.value + 1e-7
    growing.set_gain(np.arange(30), -whole.gain)
    assert growing.solve()
    assert np.abs(growing.x).max() <= 1e-9


def test_growing_is_stopped() -> None:
    """A true answer ends the work before it has begun."""
    assert not GrowingProgramme(packing(0)).solve(lambda: True)
