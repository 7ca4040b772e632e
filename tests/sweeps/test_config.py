"""The configuration of a sweep, and the command that runs it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from sapopt import SAP, bound, solve
from sapopt.cli import app
from sapopt.solvers import HAAL
from sapopt.sweeps import read_config, solve_job

GOOD = """
instances = ["small.npz", "constellation-toy", { name = "constellation-toy", cost = 1.5, tasks = 40 }]
solvers = ["haa", "HAAL:2", "bound"]
seeds = [0, 3]
time_limit = 20
out = "results"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a problem and a configuration."""
    SAP(np.random.default_rng(1).random((5, 3, 4)), 0.3).save(tmp_path / "small.npz")
    (tmp_path / "sweep.toml").write_text(GOOD)
    return tmp_path


def run(*args: Any) -> Any:
    """Outcome of a command."""
    return CliRunner().invoke(app, ["sweep", *map(str, args)])


def test_good(folder: Path) -> None:
    """Instances x seeds x solvers; names are brought to one form, paths are relative to the file."""
    sweep = read_config(folder / "sweep.toml")
    assert sweep.out == folder / "results"
    assert len(sweep.jobs) == len({job.key for job in sweep.jobs}) == 18
    assert {job.spec["solver"] for job in sweep.jobs} == {"haa", "haal:2", "bound"}
    assert sweep.jobs[0].spec["time_limit"] == 20.0
    assert sweep.jobs[-1].label == "constellation-toy cost=1.5 tasks=40 seed 3 bound"


def test_a_changed_file_is_another_job(folder: Path) -> None:
    """Results belong to the content of a problem file, not to its name."""
    before = read_config(folder / "sweep.toml").jobs[0].key
    SAP(np.random.default_rng(2).random((5, 3, 4)), 0.3).save(folder / "small.npz")
    assert read_config(folder / "sweep.toml").jobs[0].key != before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("instances = [", "sweep.toml: "),
        ('solvers = ["haa"]', "instances: is missing"),
        ('instances = "constellation-toy"\nsolvers = ["haa"]', "instances: must be a list"),
        ('instances = []\nsolvers = ["haa"]', "instances: must be a list"),
        ('instances = ["constelation-toy"]\nsolvers = ["haa"]', "instances[0]: unknown instance"),
        ('instances = ["no.npz"]\nsolvers = ["haa"]', "instances[0]: there is no file"),
        (
            'instances = [{ name = "constellation-toy", taks = 3 }]\nsolvers = ["haa"]',
            "instances[0].taks: unknown option; did you mean 'tasks'?",
        ),
        ('instances = [{ name = "constellation-toy", cost = -1 }]\nsolvers = ["haa"]', "instances[0].cost: "),
        ('instances = [3]\nsolvers = ["haa"]', "instances[0]: must be a name"),
        ('instances = ["constellation-toy"]\nsolvers = ["haall"]', "solvers[0]: unknown solver 'haall'"),
        ('instances = ["constellation-toy"]\nsolvers = ["haa", "haa"]', "solvers[1]: 'haa' is listed twice"),
        ('instances = ["constellation-toy"]\nsolvers = ["haal:0"]', "solvers[0]: lookahead"),
        ('instances = ["constellation-toy"]\nsolvers = [1]', "solvers[0]: must be a name"),
        ('instances = ["constellation-toy"]\nsolvers = ["haa"]\nseeds = [-1]', "seeds[0]: "),
        ('instances = ["constellation-toy"]\nsolvers = ["haa"]\nseeds = [true]', "seeds[0]: "),
        (
            'instances = ["constellation-toy"]\nsolvers = ["haa"]\nseed = [1]',
            "seed: unknown key; did you mean",
        ),
        ('instances = ["constellation-toy"]\nsolvers = ["haa"]\ntime_limit = 0', "time_limit: "),
        ('instances = ["constellation-toy"]\nsolvers = ["haa"]\nout = 3', "out: "),
        ('instances = ["constellation-toy"]\nsolvers = ["haa"]', "out: is missing"),
    ],
)
def test_bad(folder: Path, text: str, words: str) -> None:
    """One line that names the key, status 2, nothing on stdout, nothing written."""
    (folder / "sweep.toml").write_text(text)
    outcome = run(folder / "sweep.toml")
    assert outcome.exit_code == 2
    assert outcome.stdout == ""
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"sapopt: {folder / 'sweep.toml'}: ")
    assert words in lines[0]
    assert not (folder / "results").exists()


def test_missing_config_and_cluster(folder: Path) -> None:
    """A file that is not there, and a cluster that does not answer."""
    assert "there is no file" in run(folder / "no.toml").stderr
    outcome = run(folder / "sweep.toml", "--cluster", "nonsense://x")
    assert outcome.exit_code == 2
    assert "cluster nonsense://x" in outcome.stderr.strip().splitlines()[-1]


def test_job_is_what_the_library_says(folder: Path) -> None:
    """A job's record is the result of `solve` or `bound` on that problem."""
    jobs = read_config(folder / "sweep.toml").jobs
    problem = SAP.load(folder / "small.npz")
    records = {job.spec["solver"]: solve_job(dict(job.spec)) for job in jobs[:3]}
    assert records["haal:2"]["value"] == solve(problem, HAAL(2)).value
    assert records["bound"]["bound"] == pytest.approx(bound(problem, time_limit=20).value, rel=1e-3)
    assert records["haa"]["fingerprint"] == problem.fingerprint


def test_command(folder: Path) -> None:
    """JSON alone on stdout; the second time everything is skipped; the table shows means over the seeds."""
    (folder / "sweep.toml").write_text(GOOD.replace(", 3]", "]").replace('"constellation-toy", {', "{"))
    first = run(folder / "sweep.toml", "--workers", "1", "--json")
    assert first.exit_code == 0, first.output
    report = json.loads(first.stdout)
    assert (report["jobs"], report["done"], report["skipped"]) == (6, 6, 0)
    assert all(row["error"] is None for row in report["results"])
    assert {path.stem for path in (folder / "results").iterdir()} == {row["key"] for row in report["results"]}
    assert "6 of 6 done" in first.stderr or "sweep of 6 jobs" in first.stderr
    again = run(folder / "sweep.toml", "--workers", "1", "--json")
    assert json.loads(again.stdout)["skipped"] == 6
    table = run(folder / "sweep.toml", "--workers", "1").stdout
    assert "small.npz" in table
    assert "6 of 6 jobs" in table


def test_failed_jobs(folder: Path) -> None:
    """A job that fails is named, the others are done, and the status is 1."""
    broken = SAP(np.random.default_rng(1).random((5, 3, 4)), 0.3)
    broken.save(folder / "small.npz")
    content = (folder / "small.npz").read_bytes()
    (folder / "small.npz").write_bytes(content[: len(content) // 2])
    (folder / "sweep.toml").write_text(
        'instances = ["small.npz", "constellation-toy"]\nsolvers = ["haa"]\nout = "results"'
    )
    outcome = run(folder / "sweep.toml", "--workers", "1", "--json")
    assert outcome.exit_code == 1
    report = json.loads(outcome.stdout)
    assert "damaged" in report["results"][0]["error"]
    assert report["results"][1]["error"] is None
    assert report["done"] == 1
