"""Problems as LP and MPS files: HiGHS reads them back, finds the same optimum, and a plan of names."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from limited_problems import LOCAL, feasible
from strategies import Instance, instances

from sapopt import SAP, Limit, Result, SwitchingCost, Team
from sapopt.domains.instances import instance
from sapopt.dynamics import Battery


def solved(path: Path) -> tuple[float, dict[str, float]]:
    """Optimum and point of a file, by HiGHS' own reader."""
    import highspy

    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    solver.setOptionValue("mip_rel_gap", 0.0)
    assert solver.readModel(str(path)) == highspy.HighsStatus.kOk
    solver.run()
    assert solver.getModelStatus() == highspy.HighsModelStatus.kOptimal
    names = solver.getLp().col_names_
    return solver.getInfo().objective_function_value, dict(
        zip(names, solver.getSolution().col_value, strict=True)
    )


def plan_of(problem: SAP, point: dict[str, float]) -> np.ndarray:
    """The plan that a point says by the names of its variables, of a problem without labels."""
    plan = np.full((problem.T, problem.n), -1)
    for name, value in point.items():
        found = re.fullmatch(r"(?:take|stay|hold)__agent(\d+)__task(\d+)__(\d+)(?:__\d+)?(?:_\d+)?", name)
        if found and value > 0.5:
            agent, task, step = map(int, found.groups())
            plan[step, agent] = task
    return plan


@pytest.mark.parametrize("suffix", [".lp", ".mps"])
@pytest.mark.parametrize("kind", LOCAL)
def test_the_optimum_is_that_of_the_problem(kind: str, suffix: str, tmp_path: Path) -> None:
    """Tiny problems with capacities, idleness, limits and teams, of every kind of dynamics, against all plans."""
    for made, best in feasible(5, kind, 6):
        made.problem.write(tmp_path / f"p{suffix}")
        value, point = solved(tmp_path / f"p{suffix}")
        assert value == pytest.approx(best, abs=1e-6)
        again = Result.from_plan(made.problem, plan_of(made.problem, point))
        assert again.value == pytest.approx(best, abs=1e-6)


@given(case=instances(plans=300, most=(3, 3, 4), forbid=True), suffix=st.sampled_from([".lp", ".mps"]))
def test_plain_problems(case: Instance, suffix: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Every form of the switching cost, with forbidden pairs and first tasks."""
    problem = case.problem()
    path = tmp_path_factory.mktemp("programmes") / f"p{suffix}"
    problem.write(path)
    value, point = solved(path)
    assert value == pytest.approx(case.best(), abs=1e-6)
    assert Result.from_plan(problem, plan_of(problem, point)).value == pytest.approx(value, abs=1e-6)


AGENTS = ["Åsa", "Asa", "Bo's twin", "e1", "1st", "free"]
TASKS = ["ward/night", "ward night", "<= 3", "病房", "", "st", "take__x", "nothing"]


@pytest.mark.parametrize("suffix", [".lp", ".mps"])
def test_names_stay_readable(suffix: str, tmp_path: Path) -> None:
    """Names keep their letters, never clash, and the file says which were changed."""
    rng = np.random.default_rng(0)
    benefits = rng.random((3, 6, 8)).round(2)
    limits = [Limit.once(["ward/night"], 2), Limit.work(at_most=2, penalty=0.5), Team("st", 2, 1.0, [1])]
    options: dict[str, Any] = {"idle": True, "limits": limits, "capacity": 2}
    named = SAP(benefits, SwitchingCost(0.25), agents=AGENTS, tasks=TASKS, **options)
    named.write(tmp_path / f"named{suffix}")
    limits[0], limits[2] = Limit.once([0], 2), Team(5, 2, 1.0, [1])
    SAP(benefits, SwitchingCost(0.25), **options).write(tmp_path / f"bare{suffix}")
    value, point = solved(tmp_path / f"named{suffix}")
    assert value == pytest.approx(solved(tmp_path / f"bare{suffix}")[0], abs=1e-6)
    assert len(point) == len(set(point))
    assert "take__Asa__ward_night__0" in point
    text = (tmp_path / f"named{suffix}").read_text(encoding="utf-8")
    for words in (
        "agent Asa: 'Åsa'",
        "task ward_night: 'ward/night'",
        "'病房'",
    ):
        assert words in text
    assert max(map(len, text.splitlines())) < 255


def test_states_of_batteries_are_told_apart(tmp_path: Path) -> None:
    """An agent that reaches a task by two ways has a variable for each."""
    problem = SAP(
        np.random.default_rng(1).random((3, 2, 3)), Battery(0.2, drain=0.5, charge=0.25), agents=["a", "b"]
    )
    problem.write(tmp_path / "p.lp")
    assert any(name.startswith("hold__a__task0__2__") for name in solved(tmp_path / "p.lp")[1])


def test_what_cannot_be_written(tmp_path: Path) -> None:
    """Another suffix and a dynamics without paths are told, and no file is left."""
    with pytest.raises(ValueError, match=r"written as \.lp or \.mps"):
        SAP(np.ones((1, 1, 1))).write(tmp_path / "p.txt")
    with pytest.raises(ValueError, match="does not say that its state splits"):
        instance("dictator").write(tmp_path / "p.lp")
    assert list(tmp_path.iterdir()) == []
