"""Readers of public instances, on small files of the same form, and the problems made of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from experiments import eos, satnet
from sapopt import solve
from sapopt.solvers import Exact


def eos_folder(folder: Path, **changed: str) -> Path:
    """Two satellites, two tasks, the first of them wanted twice."""
    files = {
        "Satellites": "the number of satellites:2\n0,626113,60000\n7,626113,60000\n",
        "Tasks": "the number of tasks:2\n"
        "5,10.0,20.0,2,3600000%3600000%1.0%0.5|10800000%3600000%1.0%0.5\n9,0,0,1,3600000%7200000%2.0%0\n",
        "TaskTimeWins": "the number of TaskTimeWins:4\n0,5,2023/01/01 00:30:00,2023/01/01 00:31:00\n"
        "0,9,2023/01/01 00:31:30,2023/01/01 00:32:00\n7,5,2023/01/01 01:00:00,2023/01/01 01:01:00\n"
        "0,5,2023/01/01 03:00:00,2023/01/01 03:01:00\n",
    }
    for name, text in (files | changed).items():
        (folder / f"{name}.txt").write_text(text, encoding="utf-8")
    return folder


def test_eos_by_hand(tmp_path: Path) -> None:
    """The second satellite takes the first picture, so that the first one has time for the other task."""
    problem = eos.problem_of(eos.read_instance(eos_folder(tmp_path)))
    assert (problem.T, problem.n, problem.m) == (4, 2, 3)
    assert solve(problem, Exact()).value == pytest.approx(1.5 + 1.5 + 2.0)
    near = "the number of TaskTimeWins:2\n0,5,2023/01/01 00:30:00,2023/01/01 00:31:00\n"
    near += "0,9,2023/01/01 00:31:30,2023/01/01 00:32:00\n"
    alone = eos.problem_of(eos.read_instance(eos_folder(tmp_path, TaskTimeWins=near)))
    assert solve(alone, Exact()).value == pytest.approx(2.0)  # 30 s between them are too few
    by_minute = eos.problem_of(eos.read_instance(tmp_path), by_minute=True)
    assert solve(by_minute, Exact()).value == pytest.approx(2.0 + 1.0 + 0.5 * (1 - 29 / 60))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"Satellites": "x\n0,1\n"}, r"Satellites.txt, line 2: "),
        ({"Tasks": "x\n5,10,20,2,1%1%1%1\n"}, r"Tasks.txt, line 2: 2 visits announced, 1 found"),
        (
            {"TaskTimeWins": "x\n3,5,2023/01/01 00:30:00,2023/01/01 00:31:00\n"},
            "satellite 3 or task 5 is in no other",
        ),
        ({"TaskTimeWins": "x\n0,5,today,tomorrow\n"}, r"TaskTimeWins.txt, line 2: "),
        ({"TaskTimeWins": "x\n"}, "there is no window"),
    ],
)
def test_bad_eos_files_are_refused(tmp_path: Path, changed: dict[str, str], said: str) -> None:
    """The message names file and line."""
    with pytest.raises(ValueError, match=said):
        eos.read_instance(eos_folder(tmp_path, **changed))
    with pytest.raises(ValueError, match="give the folder of an instance"):
        eos.read_instance(tmp_path / "nowhere")


def request(views: dict[str, Any], hours: float = 1.0, least: float = 1.0) -> dict[str, Any]:
    """A request with view periods in half hours."""
    named = {
        name: [{"TRX ON": 1800 * a, "TRX OFF": 1800 * b} for a, b in spans] for name, spans in views.items()
    }
    return {"user": "1_0", "duration": hours, "duration_min": least, "setup_time": 30, "teardown_time": 15,
            "resource_vp_dict": named}  # fmt: skip


def test_satnet_by_hand(tmp_path: Path) -> None:
    """One antenna, two requests of which the second must be shortened; then one that wants an array."""
    path = tmp_path / "p.json"
    requests = [request({"DSS-1": [(0, 6)]}), request({"DSS-1": [(0, 8)]}, 2.0, 1.0)]
    path.write_text(json.dumps({"W1": requests}), encoding="utf-8")
    space = satnet.space_of(satnet.read_week(path), arrays=False)
    result = solve(space.problem(), Exact())
    assert space.hours_served(result.plan) == pytest.approx(result.value) == pytest.approx(2.5)
    with_array = [request({"DSS-1": [(0, 9)]}), request({"DSS-1_DSS-2": [(0, 9)]}, 2.0)]
    path.write_text(json.dumps({"W1": with_array}), encoding="utf-8")
    space = satnet.space_of(satnet.read_week(path, "W1"), arrays=True)
    assert set(space.needs) == {1, 2}
    result = solve(space.problem(), Exact())
    assert (
        space.hours_served(result.plan)
        == pytest.approx(result.value, abs=1e-3)
        == pytest.approx(3.0, abs=1e-3)
    )
    path.write_text(json.dumps(with_array[1]), encoding="utf-8")
    with pytest.raises(ValueError, match="give --arrays"):
        satnet.space_of(satnet.read_week(path), arrays=False)


def test_satnet_steps_begin_at_the_full_hour() -> None:
    """A view from ten minutes past the hour on is used from the half hour on; the set-up takes the step before."""
    wish = request({"DSS-1": [(1 / 3, 10 / 3)]})
    space = satnet.space_of([wish], arrays=False)
    assert space.begins[:, 0, 0].tolist() == [True, False, False, False]
    wish = request({"DSS-1": [(1 / 3, 12 / 3)]})
    assert satnet.space_of([wish], arrays=False).begins[:, 0, 0].tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("[1", "cannot be read"),
        ('{"W1": []}', "there is no week 'W2'; there are W1"),
        ('{"W2": 3}', "expected weeks"),
        ('{"W2": [{"duration": 1}]}', "request 0 has no duration_min"),
        (json.dumps({"W2": [request({"DSS-1": [(3, 2)]})]}), "a view period needs"),
    ],
)
def test_bad_satnet_files_are_refused(tmp_path: Path, told: str, said: str) -> None:
    """The message says what is wrong."""
    path = tmp_path / "p.json"
    path.write_text(told, encoding="utf-8")
    with pytest.raises(ValueError, match=said):
        satnet.read_week(path, "W2")
