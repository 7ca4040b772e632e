"""Blocks on threads: the same results whatever their number, errors that come through, no waiting for busy helpers."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sapopt.kernels import blocks
from sapopt.kernels.blocks import in_blocks, summed_in_blocks, thread_count


def squares(begin: int, end: int, out: np.ndarray) -> None:
    """Every item on its own."""
    for i in range(begin, end):
        out[i] += i * i


def add_up(begin: int, end: int, numbers: np.ndarray, total: np.ndarray) -> None:
    """Sums whose last digits depend on the order."""
    for i in range(begin, end):
        total += numbers[i]


def test_every_item_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blocks cover the range, whatever the number of items and threads."""
    for threads in ("1", "2", "7"):
        monkeypatch.setenv(blocks.OWN_VARIABLE, threads)
        for count in (0, 1, 2, 5, 100):
            for turns in (0.0, np.inf):
                out = np.zeros(count)
                in_blocks(squares, count, out, turns=turns)
                np.testing.assert_array_equal(out, np.arange(count) ** 2)


def test_sums_do_not_depend_on_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums over the items of one problem are the same bit for bit with any number of threads."""
    numbers = np.random.default_rng(0).normal(size=(1000, 3)) * 10.0 ** np.arange(1000)[:, None] ** 0.3
    for turns in (0.0, 1e5, np.inf):
        found = []
        for threads in ("1", "2", "5", "16"):
            monkeypatch.setenv(blocks.OWN_VARIABLE, threads)
            (total,) = summed_in_blocks(add_up, len(numbers), ((3,),), numbers, turns=turns)
            found.append(total)
        for total in found:
            np.testing.assert_array_equal(total, found[0])
        np.testing.assert_allclose(found[0], numbers.sum(axis=0))


def test_scratch_belongs_to_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every thread makes its own work arrays, and no other thread sees them."""
    monkeypatch.setenv(blocks.OWN_VARIABLE, "4")
    owners: list[int] = []

    def kernel(begin: int, end: int, owner: int) -> None:
        owners.append(owner)
        assert owner == threading.get_ident()

    in_blocks(kernel, 50, scratch=lambda: (threading.get_ident(),), turns=np.inf)
    assert threading.get_ident() in owners


def test_errors_come_through(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a block raises is raised, on whichever thread it ran; the next call works."""
    monkeypatch.setenv(blocks.OWN_VARIABLE, "3")

    def broken(begin: int, end: int) -> None:
        if begin <= 10 < end:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        in_blocks(broken, 40, turns=np.inf)
    test_every_item_once(monkeypatch)


def test_busy_helpers_are_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A caller does all the work itself while every helper is held up, even within a block of another caller."""
    monkeypatch.setenv(blocks.OWN_VARIABLE, "2")
    release = threading.Event()

    def held_up(begin: int, end: int) -> None:
        if threading.current_thread().name.startswith("sapopt"):
            release.wait(60)
        else:
            out = np.zeros(10)
            in_blocks(squares, 10, out, turns=np.inf)  # from within a block
            np.testing.assert_array_equal(out, np.arange(10) ** 2)
            if end == 4:
                release.set()

    in_blocks(held_up, 4, turns=np.inf)


def test_many_callers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight threads may call at once."""
    monkeypatch.setenv(blocks.OWN_VARIABLE, "3")

    def call(seed: int) -> np.ndarray:
        out = np.zeros(200)
        for _ in range(20):
            in_blocks(squares, 200, out, turns=np.inf)
        return out

    with ThreadPoolExecutor(8) as pool:
        for out in pool.map(call, range(8)):
            np.testing.assert_array_equal(out, 20.0 * np.arange(200) ** 2)


def test_thread_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Our own variable comes first, then numba's; a bad one of ours is one clear error."""
    monkeypatch.setenv(blocks.OWN_VARIABLE, "3")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "5")
    assert thread_count() == 3
    monkeypatch.delenv(blocks.OWN_VARIABLE)
    assert thread_count() == 5
    monkeypatch.delenv("NUMBA_NUM_THREADS")
    assert thread_count() >= 1
    for bad in ("0", "-1", "two", ""):
        monkeypatch.setenv(blocks.OWN_VARIABLE, bad)
        with pytest.raises(ValueError, match=blocks.OWN_VARIABLE):
            thread_count()
