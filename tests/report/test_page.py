"""The page as a file: what it holds is what the results say, and nothing in it reaches for the network."""

from __future__ import annotations

import base64
import json
import re
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, Limit, Result, SwitchingCost, solve, why_not
from sapopt.domains.instances import find_instance, scenario
from sapopt.dynamics import Interference
from sapopt.plotting.coastline import coastline_deg
from sapopt.report import report
from sapopt.report.moments import told_limit, told_times
from sapopt.solvers import HAA, NoHandover

EVIL = "</script><img src=x onerror=alert(1)> & <b>"


def told(page: Path) -> dict[str, Any]:
    """The data inside a page."""
    found = re.search(
        r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8"), re.S
    )
    assert found is not None
    data: dict[str, Any] = json.loads(found.group(1))
    return data


def array(text: str, kind: str) -> np.ndarray:
    """An array as the page decodes it."""
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def test_plans_and_benefits(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """Plans arrive exactly, benefits within the rounding, and idle agents stay idle."""
    data = told(report(problem, results, tmp_path / "r.html"))
    assert [r["name"] for r in data["results"]] == list(results)
    for one, result in zip(data["results"], results.values(), strict=True):
        np.testing.assert_array_equal(array(one["plan"], "<u2").reshape(12, 4), result.plan)
        held = problem.benefits.at(result.plan)
        levels = array(one["held"]["data"], "<u2").reshape(12, 4)
        np.testing.assert_allclose(levels * one["held"]["top"] / 65535, held, atol=one["held"]["top"] / 65535)
        np.testing.assert_array_equal(levels > 0, held > 0)
        assert one["value"] == result.value
        np.testing.assert_allclose(np.sum(one["benefit"]) + np.sum(one["handover"]), result.value, atol=1e-3)
    assert data["initial"] == [0, 1, 2, 3]
    assert data["map"] is None


def test_bound_and_prices(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """The tightest bound known is shown, with the prices of the result that proved it."""
    dual = results["dual"]
    assert dual.bound is not None
    data = told(report(problem, results, tmp_path / "a.html"))
    assert data["bound"] == dual.bound
    scale = data["prices"]["top"] / 65535
    np.testing.assert_allclose(
        array(data["prices"]["data"], "<u2").reshape(12, 6) * scale, dual.prices, atol=1.01 * scale
    )
    assert told(report(problem, results, tmp_path / "b.html", bound=1e9))["bound"] == dual.bound
    assert told(report(problem, results["haa"], tmp_path / "c.html", bound=99.0))["bound"] == 99.0
    assert told(report(problem, results["haa"], tmp_path / "d.html"))["bound"] is None


def test_map(tmp_path: Path, constellation: Any) -> None:
    """Ground tracks are the satellites' positions, places those of the tasks."""
    problem = constellation.problem()
    data = told(report(problem, solve(problem, HAA()), tmp_path / "r.html", scenario=constellation))
    tracks = array(data["map"]["tracks"], "<i2").reshape(8, 24, 2) / 180
    x, y, z = np.moveaxis(constellation.positions_km, 2, 0)
    np.testing.assert_allclose(tracks[..., 1], np.degrees(np.arctan2(z, np.hypot(x, y))), atol=0.01)
    np.testing.assert_allclose(tracks[..., 0], np.degrees(np.arctan2(y, x)), atol=0.01)
    places = array(data["map"]["places"], "<i2").reshape(30, 2) / 180
    np.testing.assert_allclose(places[:, 0], constellation.tasks.longitude_deg, atol=0.01)
    assert data["map"]["land"]["source"].startswith("Natural Earth")


def test_map_of_beams(tmp_path: Path) -> None:
    """The beams of a satellite are where it is; idle tasks that the domain adds have no priority."""
    from sapopt.domains.multibeam import multi_beam

    beams = multi_beam(0, steps=3, tasks=40)
    problem = beams.problem()
    data = told(report(problem, solve(problem, HAA()), tmp_path / "r.html", scenario=beams))
    tracks = array(data["map"]["tracks"], "<i2").reshape(3, problem.n, 2)
    np.testing.assert_array_equal(tracks[:, beams.synthetic().agent_of == 0][:, :1], tracks[:, :1])
    assert len(data["map"]["priority"]) == problem.m
    assert sum(p > 0 for p in data["map"]["priority"]) == 40


@pytest.mark.parametrize(
    "name", ["attitude", "dictator", "power", "ride-hailing", "tracking", "unit-commitment"]
)
def test_every_domain(tmp_path: Path, name: str) -> None:
    """Built-in problems get a page, those that fly with a map."""
    built = scenario(name, steps=4) if "steps" in find_instance(name).options else scenario(name)
    problem = built.problem(cost=find_instance(name).cost)
    data = told(report(problem, solve(problem, NoHandover()), tmp_path / "r.html", scenario=built))
    assert (data["map"] is not None) == (name in ("attitude", "power", "tracking"))


def test_a_scenario_of_another_problem(
    tmp_path: Path, problem: SAP, results: dict[str, Result], constellation: Any
) -> None:
    """A map of other satellites would lie."""
    with pytest.raises(ValueError, match="scenario: it has 8 steps, 24 agents and 30 tasks"):
        report(problem, results, tmp_path / "r.html", scenario=constellation)
    assert list(tmp_path.iterdir()) == []


def test_labels_are_escaped(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """No label and no title becomes markup."""
    page = report(problem, {EVIL: results["haa"]}, tmp_path / "r.html", title=EVIL)
    text = page.read_text("utf-8")
    assert EVIL not in text
    assert "<img" not in text
    assert told(page)["agents"][1] == EVIL
    assert "<title>&lt;/script&gt;&lt;img" in text


def test_nothing_from_the_network(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """No address, import or font is asked for; the page even forbids it to itself."""
    text = report(problem, results, tmp_path / "r.html").read_text("utf-8")
    assert not re.search(r"(?i)https?://|@import|url\(|\bfetch\(|XMLHttpRequest|<link", text)
    assert "default-src 'none'" in text


def test_nothing_is_overwritten(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """A file that exists stays unless force is given, and a failed page leaves nothing behind."""
    path = tmp_path / "r.html"
    path.write_text("mine", "utf-8")
    with pytest.raises(ValueError, match="exists already; pass force=True"):
        report(problem, results, path)
    assert path.read_text("utf-8") == "mine"
    assert report(problem, results, path, force=True) == path
    assert [file.name for file in tmp_path.iterdir()] == ["r.html"]


def test_results_of_another_problem(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """A result is shown with its own problem only."""
    other = SAP(problem.benefits, SwitchingCost(0.4), range(4))
    with pytest.raises(ValueError, match=r"the plan of 'haa' is worth .* in this problem"):
        report(other, results, tmp_path / "r.html")
    with pytest.raises(ValueError, match="'haa' is not a result of this problem"):
        report(SAP(np.ones((2, 4, 6)), 0.1), results, tmp_path / "r.html")
    with pytest.raises(ValueError, match="results is empty"):
        report(problem, {}, tmp_path / "r.html")
    with pytest.raises(ValueError, match="not a Result"):
        report(problem, {"plan": results["haa"].plan}, tmp_path / "r.html")  # type: ignore[dict-item]
    with pytest.raises(ValueError, match="bound must be a finite number, got inf"):
        report(problem, results, tmp_path / "r.html", bound=float("inf"))
    with pytest.raises(ValueError, match=r"prices must be finite, of shape \(T, m\) = \(12, 6\)"):
        report(problem, results, tmp_path / "r.html", prices=np.ones((6, 12)))


def test_coastline() -> None:
    """The land is that of the Earth: closed rings within its degrees, with Greenland in it and no mid-ocean."""
    from matplotlib.path import Path as Outline

    rings = coastline_deg()
    for ring in rings:
        np.testing.assert_array_equal(ring[0], ring[-1])
        assert (np.abs(ring) <= [180.0, 90.0]).all()
        across = np.abs(np.diff(ring[:, 0])) > 180.0
        assert (
            ring[:-1][across, 1] == -90.0
        ).all()  # no outline runs across the map but along its lower edge

    def is_land(longitude: float, latitude: float) -> bool:
        return sum(Outline(ring).contains_point((longitude, latitude)) for ring in rings) % 2 == 1

    assert is_land(-42.0, 72.0)  # Greenland
    assert is_land(134.0, -25.0)  # Australia
    assert is_land(20.0, 5.0)  # Africa
    assert not is_land(-30.0, 40.0)  # Atlantic
    assert not is_land(-140.0, 0.0)  # Pacific
    assert not is_land(51.0, 42.0)  # the Caspian Sea


def test_idle_agents_are_told_as_such(tmp_path: Path) -> None:
    """An agent that holds nothing is no holder of the last task: it has no benefit, and a label of its own."""
    problem = SAP(np.ones((2, 2, 2)), 0.0, [-1, 0], idle=True, limits=[Limit.once(1)])
    result = solve(problem, HAA())
    data = told(result.report(tmp_path / "r.html"))
    assert data["tasks"] == ["task 0", "task 1", "nothing"]
    assert data["initial"] == [2, 0]
    assert data["results"][0]["busy"] == float((result.plan >= 0).mean())
    assert set(array(data["results"][0]["plan"], "<u2").tolist()) <= {0, 1, 2}


def test_limits_and_pairs(tmp_path: Path, limited: tuple[SAP, dict[str, Result]]) -> None:
    """Use, slack and price of every limit, and what is proven about pairs that a plan does not hold."""
    problem, results = limited
    data = told(report(problem, results, tmp_path / "r.html"))
    for one, result in zip(data["results"], results.values(), strict=True):
        rows = {row["name"]: row for row in one["limits"]["rows"]}
        assert not any("step 0]" in name for name in rows)
        assert one["limits"]["count"] == len(rows) == len(result.evaluation.limits)
        for r, use in enumerate(result.evaluation.limits):
            row = rows[told_limit(problem, use.name)]
            assert row["use"] == use.use
            assert row["slack"] == use.slack
            assert row["cost"] == use.cost
            if result.limit_prices is not None:
                assert row["price"] == abs(result.limit_prices[r])
        assert one["why"]
        for pair in one["why"]:
            expected = why_not(problem, result, pair["agent"], pair["task"], pair["step"])
            assert pair["held"] == expected.held != pair["task"]
            assert pair["holders"] == list(expected.holders)
            if result.limit_prices is not None:
                assert pair["bound"] == pytest.approx(expected.bound)
                assert pair["limits"] == [told_limit(problem, name) for name in expected.limits]


DAY, NOON = datetime(2026, 3, 2), datetime(2026, 3, 2, 12, tzinfo=UTC)


@pytest.mark.parametrize(
    ("times", "texts", "zone", "days"),
    [
        (None, None, "", False),
        ([DAY, DAY + timedelta(1)], ["2026-03-02", "2026-03-03", "2026-03-04"], "", True),
        ([NOON, NOON + timedelta(0, 90)],
         ["2026-03-02 12:00", "2026-03-02 12:01:30", "2026-03-02 12:03"], "UTC", False),
        ([NOON.astimezone(timezone(timedelta(hours=-3)))], ["2026-03-02 09:00", "the end"], "UTC-03:00", False),
        ([NOON, (NOON + timedelta(hours=1)).astimezone(timezone(timedelta(hours=1)))],
         ["2026-03-02 12:00+00:00", "2026-03-02 14:00+01:00", "2026-03-02 15:00+01:00"], "", False),
        ([3, 5], ["3", "5", "7"], "", False),
    ],
)  # fmt: skip
def test_times_are_short(times: Any, texts: Any, zone: str, days: bool) -> None:
    """Days are dates, a zone that all share is said once, and limits are named by the time of their step."""
    steps = 2 if times is None else len(times)
    problem = SAP(np.ones((steps, 1, 1)), agents=["Ada"], tasks=["lab"], times=times)
    assert told_times(problem) == {"times": texts, "zone": zone, "days": days}
    assert told_limit(problem, "once[lab]") == "once[lab]"
    last = f"step {steps}" if texts is None else texts[steps - 1]
    assert told_limit(problem, f"cover[lab, step {steps - 1}]") == f"cover[lab, {last}]"


def test_prices_of_rounding_are_left_out(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """What solvers leave of zero makes no heat map."""
    prices = np.full((problem.T, problem.m), 1e-12)
    assert told(report(problem, results, tmp_path / "r.html", prices=prices))["prices"]["top"] == 0.0
    prices[0, 0] = 0.5
    page = report(problem, results, tmp_path / "r.html", prices=prices, force=True)
    assert told(page)["prices"]["top"] == 0.5


def test_pages_without_limits(tmp_path: Path, problem: SAP, results: dict[str, Result]) -> None:
    """No table of limits, yet pairs are explained; not so where paths depend on each other."""
    data = told(report(problem, results, tmp_path / "r.html"))
    assert all(one["limits"] is None and one["why"] for one in data["results"])
    joint = SAP(np.ones((3, 2, 2)), Interference([[0, 1]], 0.5, 0.1))
    assert told(report(joint, solve(joint, HAA()), tmp_path / "j.html"))["results"][0]["why"] == []
