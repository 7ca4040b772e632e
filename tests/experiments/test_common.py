"""The common command line of the experiments: seeds, quick runs, and results that nothing overwrites."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import sapopt
from experiments import common, fig_optimal_comparison


def begin(tmp_path: Path, *argv: str) -> common.Run:
    """A run of a made-up experiment."""
    return common.begin("An experiment.", "made_up", [*argv, "--out", str(tmp_path)], seeds=5, quick_seeds=2)


@pytest.mark.parametrize(
    ("argv", "seeds"),
    [
        ([], (0, 1, 2, 3, 4)),
        (["--quick"], (0, 1)),
        (["--seeds", "3"], (0, 1, 2)),
        (["--quick", "--seeds", "4"], (0, 1, 2, 3)),
        (["--seeds", "2", "--seed", "11"], (11, 12)),
    ],
)
def test_seeds(tmp_path: Path, argv: list[str], seeds: tuple[int, ...]) -> None:
    """The seeds are as many as were asked for, else those of a full or a quick run, from the first one named on."""
    run = begin(tmp_path, *argv)
    assert run.seeds == seeds
    assert run.quick is ("--quick" in argv)


def test_results_hold_environment_and_seeds(tmp_path: Path) -> None:
    """The report can be read by any program, and says what it came from."""
    run = begin(tmp_path, "--seeds", "2")
    run.write_json({"mean": np.float64(0.5), "values": np.arange(3), "folder": tmp_path})
    report = json.loads((tmp_path / "made_up.json").read_text(encoding="utf-8"))
    assert report["seeds"] == [0, 1]
    assert report["options"]["seeds"] == 2
    assert report["environment"]["sapopt"] == sapopt.__version__
    assert report["mean"] == 0.5
    assert report["values"] == [0, 1, 2]


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Earlier results end the run with status 2 and one clear line before any work, unless --force is given."""
    begin(tmp_path).write_json({})
    with pytest.raises(SystemExit) as ended:
        begin(tmp_path)
    assert ended.value.code == 2
    assert "exists already; give --force" in capsys.readouterr().err
    begin(tmp_path, "--force")


def test_only_the_same_run_goes_on(tmp_path: Path) -> None:
    """A script that goes on keeps finished results of other options, or of seeds that it would not run again."""

    def again(*argv: str) -> common.Run:
        given = [*argv, "--out", str(tmp_path)]
        return common.begin("An experiment.", "made_up", given, seeds=5, quick_seeds=2, resumes=True)

    again("--seeds", "3").write_json({})
    for argv in (["--quick"], ["--seeds", "2"], ["--seeds", "3", "--seed", "1"]):
        with pytest.raises(SystemExit):
            again(*argv)
    assert again("--seeds", "3").seeds == (0, 1, 2)
    assert again("--seeds", "4").seeds == (0, 1, 2, 3)
    again("--quick", "--force")
    (tmp_path / "made_up.json").write_text("{", encoding="utf-8")
    with pytest.raises(SystemExit):
        again("--seeds", "3")


def test_bad_seeds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """There is no experiment with no seed."""
    with pytest.raises(SystemExit):
        begin(tmp_path, "--seeds", "0")
    assert "--seeds must be at least 1, got 0" in capsys.readouterr().err


def test_a_script_runs(tmp_path: Path) -> None:
    """The comparison with the optimum, on two problems: its report and its figure are there and right."""
    fig_optimal_comparison.main(["--seeds", "2", "--out", str(tmp_path)])
    report = json.loads((tmp_path / "fig_optimal_comparison.json").read_text(encoding="utf-8"))
    best = report["values"]["optimum"]
    for values in report["values"].values():
        assert len(values) == 2
        assert all(value <= top + 1e-9 for value, top in zip(values, best, strict=True))
    assert (tmp_path / "fig_optimal_comparison.png").read_bytes().startswith(b"\x89PNG")


def test_one_way_to_import() -> None:
    """Scripts are run as modules, so they import each other as `experiments.NAME`, never by the bare name."""
    root = Path(common.__file__).parent
    names = {path.stem for path in root.rglob("*.py")} - {"__main__"}
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                assert not {alias.name for alias in node.names} & names, path
            elif isinstance(node, ast.ImportFrom):
                assert node.module not in names, path


def test_names_of_an_option(tmp_path: Path) -> None:
    """Names separated by commas are known ones, or the script ends with a line that lists those."""
    run = begin(tmp_path)
    assert run.chosen("methods", "b,a", ["a", "b", "c"]) == ["b", "a"]
    with pytest.raises(SystemExit, match="made_up: --methods: unknown 'd'; known: a, b, c"):
        run.chosen("methods", "a,d", ["a", "b", "c"])
