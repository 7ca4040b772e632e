"""Figures: they draw what the results say, on the axes they are given."""

from __future__ import annotations

import dataclasses
import io

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from sapopt import SAP, Result, SwitchingCost, plotting, solve
from sapopt.domains.instances import scenario
from sapopt.plotting.world import ground_tracks_deg
from sapopt.solvers import HAA, HAAL, NoHandover

mpl.use("Agg")


@pytest.fixture
def ax() -> Axes:
    """Axes that need no window system."""
    figure = Figure(layout="constrained")
    FigureCanvasAgg(figure)
    return figure.subplots()


@pytest.fixture(scope="module")
def problem() -> SAP:
    """Half of the pairs are worth something, so that agents idle now and then."""
    rng = np.random.default_rng(3)
    return SAP(rng.random((12, 5, 7)) * (rng.random((12, 5, 7)) < 0.5), SwitchingCost(0.4))


@pytest.fixture(scope="module")
def results(problem: SAP) -> dict[str, Result]:
    """Three results of the problem."""
    return {solver.name: solve(problem, solver) for solver in (NoHandover(), HAA(), HAAL(lookahead=3))}


def draw(ax: Axes) -> None:
    """Render, since much of matplotlib only fails then."""
    ax.figure.savefig(io.BytesIO(), format="png")


def test_value_against_bound(ax: Axes) -> None:
    """One bar for each solver, its length the value, its label the share of the bound."""
    assert plotting.value_against_bound({"a": 50.0, "b": 75.0}, 100.0, ax) is ax
    draw(ax)
    assert [bar.get_width() for bar in ax.patches] == [50.0, 75.0]
    assert {"50.0 %", "75.0 %", "proven bound 100.0"} <= {text.get_text() for text in ax.texts}
    assert ax.get_xlim()[1] > 100.0


@pytest.mark.parametrize("values", [{}, {"a": 0.0}, {"a": -3.0, "b": 2.0}])
def test_value_against_bound_of_odd_values(ax: Axes, values: dict[str, float]) -> None:
    """No solver, nothing gained, and losses are drawn as well, without a bound."""
    draw(plotting.value_against_bound(values, None, ax))
    assert len(ax.patches) == len(values)


def test_benefit_history(ax: Axes, problem: SAP, results: dict[str, Result]) -> None:
    """Each solver has a line with the benefit of the agent's task, and a circle at each of its handovers."""
    plotting.benefit_history(problem, results, 2, ax)
    draw(ax)
    dense = problem.benefits.dense()
    for number, result in enumerate(results.values()):
        line, circles = ax.lines[2 * number : 2 * number + 2]
        held = result.plan[:, 2]
        np.testing.assert_array_equal(line.get_ydata(), dense[np.arange(12), 2, held])
        np.testing.assert_array_equal(circles.get_xdata(), 1 + np.flatnonzero(held[1:] != held[:-1]))


def test_history_counts_the_initial_assignment(ax: Axes, problem: SAP) -> None:
    """With an initial assignment the first step can be a handover."""
    result = solve(problem, HAA())
    initial = np.roll(result.plan[0], 1)
    moved = SAP(problem.benefits, problem.dynamics, initial)
    plotting.benefit_history(moved, {"haa": result}, 0, ax)
    assert 0 in ax.lines[1].get_xdata()


def test_timeline(ax: Axes, problem: SAP, results: dict[str, Result]) -> None:
    """A stroke for every handover of the agents drawn, a coloured cell for every pair that is worth something."""
    result = results["HAA"]
    plotting.timeline(problem, result, [1, 4], ax)
    draw(ax)
    assert len(ax.collections[0].get_segments()) == (np.diff(result.plan[:, [1, 4]], axis=0) != 0).sum()
    drawn = ax.images[0].get_array()
    np.testing.assert_array_equal(
        ~np.ma.getmaskarray(drawn), problem.benefits.at(result.plan)[:, [1, 4]].T > 0
    )
    assert [label.get_text() for label in ax.get_yticklabels()] == ["1", "4"]


def test_gap_trace(ax: Axes, results: dict[str, Result]) -> None:
    """The gap of the best bound and the best plan so far, from the first plan on; never below the scale."""
    trace = [
        {"seconds": 0.0, "bound": 30.0, "value": None},
        {"seconds": 1.0, "bound": 25.0, "value": 10.0},
        {"seconds": 2.0, "bound": 20.0, "value": 8.0},
        {"seconds": 3.0, "bound": 20.0, "value": 20.0},
    ]
    plotting.gap_trace(dataclasses.replace(results["HAA"], trace=trace), ax)
    draw(ax)
    np.testing.assert_allclose(ax.lines[0].get_xydata(), [[1.0, 60.0], [2.0, 50.0], [3.0, 0.001]])
    assert "proven bound 20.0" in ax.get_title(loc="left")


def test_value_against_lookahead(ax: Axes) -> None:
    """A line through the means of each method, a band where there are several seeds, levels and the bound as lines."""
    values = {"a": {3: [5.0, 7.0], 1: [2.0, 4.0]}, "b": {1: 1.0, 2: 2.5}}
    plotting.value_against_lookahead(values, 9.0, {"greedy": 0.5}, {"b": "black"}, ax)
    draw(ax)
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[1, 3.0], [3, 6.0]])
    np.testing.assert_array_equal(ax.lines[1].get_xydata(), [[1, 1.0], [2, 2.5]])
    assert ax.lines[1].get_color() == "black"
    assert [line.get_ydata()[0] for line in ax.lines[2:]] == [0.5, 9.0]
    assert len(ax.collections) == 1
    assert [text.get_text() for text in ax.legend().get_texts()] == ["a", "b", "greedy", "proven bound 9.0"]


def test_ratio_against_c(ax: Axes) -> None:
    """The curve of the theorem, the points with c > 0, and rings around those that break it."""
    points = {"random": [(0.0, 0.4), (2.0, 0.9)], "search": np.array([[5.0, 0.8]])}
    plotting.ratio_against_c(points, [(5.0, 0.8)], ax=ax)
    draw(ax)
    c, promised = ax.lines[0].get_data()
    np.testing.assert_allclose(promised, c / (1 + c))
    assert [spots.get_offsets().tolist() for spots in ax.collections] == [
        [[2.0, 0.9]],
        [[5.0, 0.8]],
        [[5.0, 0.8]],
    ]


def test_price_heat_map(ax: Axes) -> None:
    """The scarcest tasks on top, or those asked for, with their names."""
    prices = np.array([[0.0, 3.0, 1.0], [0.5, 2.0, 0.0]])
    plotting.price_heat_map(prices, 2, ["north", "east", "south"], ax)
    draw(ax)
    np.testing.assert_array_equal(ax.images[0].get_array(), prices[:, [1, 2]].T)
    assert [label.get_text() for label in ax.get_yticklabels()] == ["east", "south"]
    other = Figure().subplots()
    plotting.price_heat_map(prices, [0], ax=other)
    np.testing.assert_array_equal(other.images[0].get_array(), prices[:, [0]].T)


def test_world_map(ax: Axes) -> None:
    """Satellites lie where they are, each one at work has a line to its task, over the date line two."""
    constellation = scenario("constellation-toy", steps=6)
    small = constellation.problem()
    result = solve(small, HAA())
    assert plotting.world_map(constellation, result, 4, trail=2, ax=ax) is ax
    draw(ax)
    busy = small.benefits.at(result.plan)[4] > 0
    idle_dots, busy_dots = ax.collections[-2:]
    assert (len(idle_dots.get_offsets()), len(busy_dots.get_offsets())) == ((~busy).sum(), busy.sum())
    moved = busy & (result.plan[4] != result.plan[3])
    links = [c for c in ax.collections if isinstance(c, LineCollection)][-2:]
    ground = ground_tracks_deg(constellation.positions_km[4])
    for drawn, who in zip(links, (busy & ~moved, moved), strict=True):
        apart = ground[who, 0] - constellation.tasks.longitude_deg[result.plan[4][who]]
        assert len(drawn.get_segments()) == who.sum() + (np.abs(apart) > 180).sum()
        for line in drawn.get_segments():
            assert abs(line[0, 0] - line[1, 0]) <= 180
    np.testing.assert_allclose(ground[busy], busy_dots.get_offsets())
    draw(plotting.world_map(constellation, step=0, prices=np.ones((6, 30)), ax=Figure().subplots()))
    with pytest.raises(ValueError, match=r"step must lie in 0\.\.5, got 6"):
        plotting.world_map(constellation, step=6, ax=ax)
    with pytest.raises(ValueError, match="result: its plan has shape"):
        plotting.world_map(scenario("constellation-toy", steps=9), result, 7, ax=ax)


def test_without_axes() -> None:
    """Without axes a new pyplot figure is made."""
    before = plt.get_fignums()
    made = plotting.value_against_bound({"a": 1.0}, 2.0)
    assert len(plt.get_fignums()) == len(before) + 1
    plt.close(made.figure)


def test_agents_and_tasks_by_their_labels() -> None:
    """A label stands for its number, in every figure that draws some of them."""
    names, tasks = ["plane 0", "plane 1", "plane 2"], [f"t{j}" for j in range(4)]
    problem = SAP(np.random.default_rng(0).random((5, 3, 4)), SwitchingCost(0.1), agents=names, tasks=tasks)
    result = solve(problem, HAA())
    drawn = [
        np.asarray(plotting.timeline(problem, result, agents, Figure().subplots()).images[0].get_array())
        for agents in (["plane 2", 0], [2, "plane 0"])
    ]
    np.testing.assert_array_equal(*drawn)
    lines = [
        plotting.benefit_history(problem, {"HAA": result}, agent, Figure().subplots()).lines[0].get_ydata()
        for agent in ("plane 1", 1)
    ]
    np.testing.assert_array_equal(*lines)
    prices = np.random.default_rng(1).random((5, 4))
    by_name = plotting.price_heat_map(prices, ["t3", 1], tasks, Figure().subplots())
    np.testing.assert_array_equal(np.asarray(by_name.images[0].get_array()), prices[:, [3, 1]].T)
    with pytest.raises(
        ValueError, match="agents: there is none called 'plane 7'; the first label is 'plane 0'"
    ):
        plotting.timeline(problem, result, ["plane 7"])


def test_bad_arguments(ax: Axes, problem: SAP, results: dict[str, Result]) -> None:
    """An agent that does not exist and a trace without bounds are named."""
    with pytest.raises(ValueError, match=r"agent must lie in 0\.\.4, got 5"):
        plotting.benefit_history(problem, results, 5, ax)
    with pytest.raises(ValueError, match=r"agents must be numbers in 0\.\.4"):
        plotting.timeline(problem, results["HAA"], [0, -1], ax)
    with pytest.raises(ValueError, match=r"tasks must be numbers in 0\.\.2 or labels, got 3"):
        plotting.price_heat_map(np.ones((2, 3)), [3], ax=ax)
    with pytest.raises(ValueError, match=r"tasks must be a positive count or numbers in 0\.\.2"):
        plotting.price_heat_map(np.ones((2, 3)), 0, ax=ax)
    with pytest.raises(ValueError, match="agents: there is none called 'mary'; there are no labels"):
        plotting.timeline(problem, results["HAA"], ["mary"], ax)
    for bad in ([], "ab", [1.5], [True]):
        with pytest.raises(ValueError, match="agents must be"):
            plotting.timeline(problem, results["HAA"], bad, ax)
    with pytest.raises(ValueError, match=r"prices must be finite, of shape \(T, m\)"):
        plotting.price_heat_map(np.ones(3), ax=ax)
    with pytest.raises(ValueError, match="holds no bounds"):
        plotting.gap_trace(results["HAA"], ax)
