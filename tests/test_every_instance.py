"""Every built-in instance can be saved, loaded, solved from the command line, shown, and plotted."""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from typer.testing import CliRunner

from sapopt import SAP, plotting, solve
from sapopt.cli import app
from sapopt.domains import registry
from sapopt.domains.instances import instance, instances, scenario
from sapopt.solvers import Greedy

SMALL: dict[str, dict[str, Any]] = {
    "attitude": {"steps": 4, "tasks": 40, "planes": 4, "per_plane": 6, "altitude_km": 1200.0},
    "constellation-large": {"steps": 2},
    "constellation-large-thesis": {"steps": 2},
    "constellation-mid": {"steps": 3},
    "constellation-shells": {"steps": 2},
    "constellation-toy": {"steps": 5},
    "dictator": {"steps": 4},
    "deep-space": {"antennas": 4, "requests": 8, "steps": 40, "arrays": 2},
    "earth-coverage": {"steps": 3},
    "earth-coverage-thesis": {"steps": 3},
    "imaging": {"satellites": 4, "targets": 12, "steps": 30, "stations": 2},
    "interference": {"steps": 3, "tasks": 40, "planes": 4, "per_plane": 6},
    "multi-beam-us": {"steps": 3, "beams": 2},
    "multi-beam": {"steps": 3, "tasks": 150, "beams": 2},
    "nurse-roster": {"nurses": 5, "wards": 3, "days": 7},
    "power": {"steps": 3},
    "power-1008": {"steps": 2},
    "power-4225": {"steps": 2},
    "power-4425": {"steps": 2},
    "ride-hailing": {"drivers": 4, "requests": 20, "steps": 8, "width": 5},
    "starlink": {"steps": 2},
    "tracking": {"steps": 4, "planes": 12, "resolution": 2},
    "tracking-thesis": {"steps": 4, "planes": 12, "resolution": 2},
    "unit-commitment": {"units": 6, "steps": 8},
    "waiting-rides": {"drivers": 3, "requests": 10, "steps": 8, "width": 4, "patience": 3},
}
"""Options that make them small enough for a test, where there are such options."""

SHORTER = {"nurse-roster": {"days": 1}, "deep-space": {"steps": 30}}
"""Fewer steps, where one step is called otherwise or is too few."""

ON_EARTH = {"deep-space", "dictator", "nurse-roster", "ride-hailing", "unit-commitment", "waiting-rides"}
"""Those without satellites, whose report has no map."""

every = pytest.mark.parametrize("name", [entry.name for entry in instances()])


def run(*args: Any) -> Any:
    """What a command wrote to stdout; it must succeed."""
    outcome = CliRunner().invoke(app, [str(arg) for arg in args])
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The instances with the options above, under their own names."""
    for entry in instances():
        shrunk = dataclasses.replace(entry, build=functools.partial(entry.build, **SMALL[entry.name]))
        monkeypatch.setitem(registry._REGISTRY, entry.name, shrunk)


@every
def test_files(name: str, tmp_path: Path) -> None:
    """A problem comes back from its file with everything that decides the value of a plan."""
    problem = instance(name, seed=1, **SMALL[name])
    problem.save(tmp_path / "p.npz")
    again = SAP.load(tmp_path / "p.npz")
    assert again.fingerprint == problem.fingerprint
    assert (
        again.fingerprint
        != instance(name, seed=1, **SMALL[name] | SHORTER.get(name, {"steps": 1})).fingerprint
    )
    assert (again.agents, again.tasks) == (problem.agents, problem.tasks)


@every
@pytest.mark.usefixtures("small")
def test_command_line(name: str, tmp_path: Path) -> None:
    """Solved by name, with its figures; the report finds the problem by the record, with a map where there is one."""
    out, page = tmp_path / "out", tmp_path / "r.html"
    told = json.loads(run("solve", name, "--solver", "haa", "--time-limit", 1, "--json", "--out", out))
    assert told["value"] == pytest.approx(instance(name).evaluate(told["plan"]).value)
    assert told["value"] <= told["bound"] + 1e-9
    assert {path.name for path in out.iterdir()} == {"solve.json", "solve.npz", "history.png", "timeline.png"}
    run("report", out, "--out", page, "--no-bound")
    assert ('"map":null' in page.read_text("utf-8")) == (name in ON_EARTH)


@every
def test_scenarios_draw(name: str) -> None:
    """What a scenario can draw of itself, it draws of any plan."""
    scene = scenario(name, **SMALL[name])
    problem = instance(name, **SMALL[name])
    result = solve(problem, Greedy())
    with mpl.rc_context({"backend": "Agg"}):
        if hasattr(scene, "draw"):
            assert scene.draw(result.plan).has_data()
        if name not in ON_EARTH:
            prices = np.ones(problem.benefits.shape[::2])
            lines = plotting.world_map(scene, result, 1).collections[2:4]
            busy = int((problem.benefits.at(result.plan)[1] > 0).sum())
            assert (
                busy <= sum(len(kind.get_paths()) for kind in lines) <= 2 * busy
            )  # twice over the date line
            assert plotting.world_map(scene, result, 1, prices=prices).has_data()
        else:
            with pytest.raises(ValueError, match="no satellites"):
                plotting.world_map(scene, result, 1)
        plt.close("all")
