"""Without the extra `learn`, sapopt works, and asking for what is learned says what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HIDE = "import sys; sys.modules['torch'] = None; "  # what an import of a missing package meets


def test_import_says_which_extra() -> None:
    """The ImportError names the package and the extra."""
    code = HIDE + "import sapopt, sapopt.solvers, sapopt.cli\nimport sapopt.learning"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert outcome.returncode == 1
    assert "sapopt.learning needs torch" in outcome.stderr
    assert "pip install 'sapopt[learn]'" in outcome.stderr


def test_command_says_which_extra(tmp_path: Path) -> None:
    """One line on stderr and exit status 2."""
    code = HIDE + "from sapopt.cli import main; sys.argv[1:] = ['train', 'reda', 'power']; main()"
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert outcome.returncode == 2
    assert "sapopt[learn]" in outcome.stderr
    assert len(outcome.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_flags_are_the_options() -> None:
    """The command's options have the names of `TrainOptions`, and its defaults if they have any of their own."""
    pytest.importorskip("torch")
    from dataclasses import asdict

    from sapopt.cli.training import TrainFlags
    from sapopt.learning import TrainOptions

    options = asdict(TrainOptions())
    for name, default in asdict(TrainFlags()).items():
        assert name in options
        assert default is None or options[name] == default


def test_training_command(tmp_path: Path) -> None:
    """`sapopt train reda` leaves weights, log and checkpoint; the weights say how they were made."""
    pytest.importorskip("torch")
    import json

    from typer.testing import CliRunner

    from sapopt.cli import app
    from sapopt.learning import REDA

    words = "train reda constellation-toy --episodes 2 --gradient-steps 1 --evaluate-every 1 --evaluations 1 --json"
    outcome = CliRunner().invoke(app, [*words.split(), "--out", str(tmp_path / "run")])
    assert outcome.exit_code == 0, outcome.stderr
    report = json.loads(outcome.stdout)
    assert report["episodes"] == 2
    assert {path.name for path in (tmp_path / "run").iterdir()} >= {
        "weights.safetensors",
        "log.csv",
        "checkpoint.safetensors",
    }
    assert REDA.load(report["weights"]).about["options"]["episodes"] == 2
    again = CliRunner().invoke(app, [*words.split(), "--out", str(tmp_path / "run")])
    assert again.exit_code == 2
    assert "--force" in again.stderr
    bad = CliRunner().invoke(app, ["train", "reda", "constellation-tiy", "--out", str(tmp_path / "other")])
    assert bad.exit_code == 2
    assert not (tmp_path / "other").exists()


def test_command_takes_presets(tmp_path: Path) -> None:
    """`--preset thesis` trains by Algorithm 4 with the observation of 6.2.2, `--preset per-task` one function for all
    tasks; what is given besides wins."""
    pytest.importorskip("torch")
    from typer.testing import CliRunner

    from sapopt.cli import app
    from sapopt.learning import REDA, ThesisObservation

    words = "train reda constellation-toy --preset thesis --see 2 --hidden none --stretches 2 --episodes 1"
    done = CliRunner().invoke(app, [*words.split(), "--evaluations", "1", "--out", str(tmp_path / "run")])
    assert done.exit_code == 0, done.output
    reda = REDA.load(tmp_path / "run" / "weights.safetensors")
    assert reda.network.spec == ThesisObservation(steps=2, charge=False)
    assert reda.network.hidden == ()
    used = reda.about["options"]
    assert (used["after"], used["noise"], used["perturb"], used["stretches"]) == ("step", 2.0, "pairs", 2)
    assert reda.about["guide"] == "myopic"
    words = "train reda constellation-toy --preset per-task --hidden 8,8 --gradient-steps 1 --episodes 1"
    done = CliRunner().invoke(app, [*words.split(), "--evaluations", "1", "--out", str(tmp_path / "task")])
    assert done.exit_code == 0, done.output
    reda = REDA.load(tmp_path / "task" / "weights.safetensors")
    assert reda.network.spec == ThesisObservation(steps=5, charge=False)
    assert reda.network.per_task
    assert reda.about["options"]["discount"] == 0.7
    bad = CliRunner().invoke(
        app, ["train", "reda", "power", "--hidden", "x", "--out", str(tmp_path / "other")]
    )
    assert bad.exit_code != 0
