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
from matplotlib.figure import Figure

from sapopt import SAP, Result, SwitchingCost, plotting, solve
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


def test_without_axes() -> None:
    """Without axes a new pyplot figure is made."""
    before = plt.get_fignums()
    made = plotting.value_against_bound({"a": 1.0}, 2.0)
    assert len(plt.get_fignums()) == len(before) + 1
    plt.close(made.figure)


def test_bad_arguments(ax: Axes, problem: SAP, results: dict[str, Result]) -> None:
    """An agent that does not exist and a trace without bounds are named."""
    with pytest.raises(ValueError, match=r"agent must lie in 0\.\.4, got 5"):
        plotting.benefit_history(problem, results, 5, ax)
    with pytest.raises(ValueError, match=r"agents must be numbers in 0\.\.4"):
        plotting.timeline(problem, results["HAA"], [0, -1], ax)
    with pytest.raises(ValueError, match="holds no bounds"):
        plotting.gap_trace(results["HAA"], ax)
