"""Jobs over processes and over a Dask cluster: everything lands once, whatever dies in between."""

from __future__ import annotations

import json
import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sweep_jobs import always_dies, dies_once, fails, square

from sapopt.sweeps import Finished, Job, run_jobs

# What a dying worker leaves behind in dask and asyncio is not ours.
pytestmark = pytest.mark.filterwarnings("ignore")


def jobs(count: int, log: Path, seconds: float = 0.0) -> list[Job]:
    """Jobs that square the first numbers."""
    return [Job(f"x {x}", {"x": x, "log": str(log), "seconds": seconds}) for x in range(count)]


def lines(log: Path, word: str) -> Counter[int]:
    """How often each job said a word."""
    said = [line.split() for line in log.read_text().splitlines()]
    return Counter(int(x) for verb, x, _ in said if verb == word)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two local workers that are started again when they die."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as started:
        yield started


def test_a_killed_worker_of_a_cluster(cluster: Any, tmp_path: Path) -> None:
    """40 jobs, 2 workers, one of them killed: nothing that had landed is lost or done again."""
    log = tmp_path / "log"
    todo = jobs(40, log, seconds=0.05)
    landed: list[int] = []

    def kill(finished: Finished) -> None:
        landed.append(finished.job.spec["x"])
        if len(landed) == 10:
            last = [line.split() for line in log.read_text().splitlines()][-1]
            os.kill(int(last[2]), signal.SIGKILL)

    done = run_jobs(square, todo, tmp_path / "out", cluster=cluster.scheduler_address, on_finished=kill)
    assert [finished.record for finished in done] == [{"square": x * x} for x in range(40)]
    assert sorted(landed) == list(range(40))
    assert len(list((tmp_path / "out").iterdir())) == 40
    for job in todo:
        content = json.loads((tmp_path / "out" / f"{job.key}.json").read_text())
        assert content["record"] == {"square": job.spec["x"] ** 2}
        assert content["job"] == job.spec
    # A worker does one job at a time: at most that one was begun in vain, and none was finished twice.
    twice = {x for x, count in lines(log, "start").items() if count > 1}
    assert len(twice) <= 1
    assert not twice & set(landed[:10])


def test_a_restarted_sweep(cluster: Any, tmp_path: Path) -> None:
    """A sweep that ends early goes on where it was; damaged files and failures are done again, the rest is not."""
    log, out = tmp_path / "log", tmp_path / "out"
    todo = jobs(12, log, seconds=0.3)

    class StopError(Exception):
        pass

    def stop(finished: Finished) -> None:
        if len(list(out.glob("*.json"))) >= 5:
            raise StopError

    with pytest.raises(StopError):
        run_jobs(square, todo, out, cluster=cluster.scheduler_address, on_finished=stop)
    held = {path: path.stat().st_mtime_ns for path in out.glob("*.json")}
    assert 5 <= len(held) < 12
    broken = next(iter(held))
    broken.write_text(broken.read_text()[:20])
    done = run_jobs(square, todo, out, cluster=cluster.scheduler_address)
    assert [finished.record for finished in done] == [{"square": x * x} for x in range(12)]
    # What was under way when the sweep ended may have landed since.
    assert sum(not finished.fresh for finished in done) >= len(held) - 1
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in held.items() if path != broken)
    assert not list(out.glob("*.part"))


def test_processes(tmp_path: Path) -> None:
    """Without a cluster: a process that dies costs nothing that was done, and a failure only its own job."""
    log = tmp_path / "log"
    todo = jobs(8, log)
    done = run_jobs(dies_once, todo, tmp_path / "out", workers=2)
    assert [finished.record for finished in done] == [{"x": x} for x in range(8)]
    done = run_jobs(fails, todo, tmp_path / "odd", workers=2)
    assert [finished.error for finished in done[:2]] == [None, "ValueError: 1 is odd"]
    assert len(list((tmp_path / "odd").iterdir())) == 4
    again = run_jobs(fails, todo, tmp_path / "odd", workers=2)
    assert [finished.fresh for finished in again] == [False, True] * 4


def test_workers_that_always_die(tmp_path: Path) -> None:
    """There is an end to it, and the message says what may help."""
    with pytest.raises(RuntimeError, match="need more memory or fewer workers"):
        run_jobs(always_dies, jobs(2, tmp_path / "log"), tmp_path / "out", workers=2)


def test_bad_arguments(tmp_path: Path) -> None:
    """Each error names its argument."""
    one = jobs(1, tmp_path / "log")
    with pytest.raises(ValueError, match="'x 0' is listed twice"):
        run_jobs(square, one * 2, tmp_path)
    with pytest.raises(ValueError, match="workers"):
        run_jobs(square, one, tmp_path, workers=0)
    with pytest.raises(ValueError, match="workers"):
        run_jobs(square, one, tmp_path, workers=2, cluster="tcp://127.0.0.1:1")
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="folder"):
        run_jobs(square, one, tmp_path / "file")


def test_keys() -> None:
    """The key depends on the specification, not on the order of its entries."""
    assert Job("a b/c", {"x": 1, "y": 2}).key == Job("a b/c", {"y": 2, "x": 1}).key
    assert Job("a", {"x": 1}).key != Job("a", {"x": 2}).key
    assert "/" not in Job("a b/c", {}).key


def test_missing_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without joblib the error says what to install."""
    monkeypatch.setitem(__import__("sys").modules, "joblib", None)
    with pytest.raises(ImportError, match=r"pip install 'sapopt\[distributed\]'"):
        run_jobs(square, jobs(1, tmp_path / "log"), tmp_path / "out")
