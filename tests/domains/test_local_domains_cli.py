"""The agent-local domains from the command line: saved, solved with a bound, drawn, certified, verified."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from sapopt.cli import app
from sapopt.domains.instances import instance, instances

SMALL: dict[str, dict[str, Any]] = {
    "attitude": {"steps": 4, "tasks": 40, "planes": 4, "per_plane": 6, "altitude_km": 1200.0},
    "ride-hailing": {"drivers": 4, "requests": 20, "steps": 8, "width": 5},
    "unit-commitment": {"units": 6, "steps": 8},
}


def run(*args: Any) -> str:
    outcome = CliRunner().invoke(app, [str(arg) for arg in args])
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


@pytest.mark.parametrize("name", SMALL)
def test_file_to_certificate(name: str, tmp_path: Path) -> None:
    problem, path, out = instance(name, **SMALL[name]), tmp_path / "p.npz", tmp_path / "out"
    problem.save(path)
    report = json.loads(
        run("solve", path, "--solver", "dual-decomposition", "--time-limit", 2, "--json", "--out", out)
    )
    assert report["value"] == pytest.approx(problem.evaluate(report["plan"]).value)
    assert report["value"] <= report["bound"] + 1e-9
    for figure in ("history.png", "timeline.png", "gap.png"):
        assert (out / figure).stat().st_size > 5000
    certificate = tmp_path / "c.npz"
    run("certify", path, "--solver", "haal:2", "--time-limit", 2, "--out", certificate)
    assert "p" in run("verify", certificate, path)


def test_listed() -> None:
    """The sizes that the list tells are those of the instances."""
    known = {entry.name: entry for entry in instances()}
    for name in ("ride-hailing", "unit-commitment"):
        problem = instance(name)
        assert known[name].shape == (problem.T, problem.n, problem.m)
    assert known["attitude"].shape == (93, 324, 450 + 324)


@pytest.mark.parametrize("name", ["attitude", "ride-hailing", "unit-commitment"])
def test_a_choice_that_the_rule_does_not_have_is_refused(name: str) -> None:
    """Whether idling is free is no question here, and the message says why."""
    with pytest.raises(ValueError, match="idle_is_free: there is nothing to choose here"):
        instance(name, idle_is_free=True, **SMALL[name])
