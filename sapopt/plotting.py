"""Figures of problems and results. Every function draws on one matplotlib axes and returns it.

Without ``ax`` a new figure is made through pyplot. The colours are the Okabe-Ito palette, which the colour-blind can
tell apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import FuncFormatter

if TYPE_CHECKING:
    from sapopt.problem import SAP
    from sapopt.result import Result

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_BAR, _BEST, _BOUND, _MUTED = "#9DB8CF", "#0072B2", "#D55E00", "#666666"
_IDLE = "#E4E4E4"
_SMALLEST_GAP = 0.001  # percent; a gap of zero has no place on a logarithmic scale
_BLUES = LinearSegmentedColormap.from_list("held", ["#D6E6F2", "#0072B2", "#06304D"])


def value_against_bound(
    values: Mapping[str, float], bound: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the value of each solver as a bar, against the proven upper bound.

    Parameters
    ----------
    values : mapping of str to float
        Value by solver name, drawn from top to bottom.
    bound : float, optional
        A proven upper bound of the optimum. With it, the bars are labelled with their share of it.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = _axes(ax, (7.2, 0.42 * len(values) + 1.3))
    names, heights = list(values), np.array(list(values.values()), dtype=float)
    best = heights.max() if len(heights) else 0.0
    colors = [_BEST if height == best else _BAR for height in heights]
    rows = np.arange(len(names))
    ax.barh(rows, heights, height=0.68, color=colors)
    ax.set_yticks(rows, names)
    ax.invert_yaxis()
    top = max(best, bound if bound is not None else best, 0.0)
    for row, height in zip(rows, heights, strict=True):
        text = f"{height:,.1f}"
        if bound is not None and bound > 0:
            text = f"{100 * height / bound:.1f} %"
        inside = height > 0.5 * top
        ax.annotate(
            text,
            (height if inside else max(height, 0.0), row),
            xytext=(-6 if inside else 6, 0),
            textcoords="offset points",
            ha="right" if inside else "left",
            va="center",
            color="white" if height == best and inside else "#222222",
            fontsize=9,
        )
    if bound is not None:
        ax.axvline(bound, color=_BOUND, lw=1.6)
        ax.annotate(
            f"proven bound {bound:,.1f}",
            (bound, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4),
            textcoords="offset points",
            ha="right",
            va="bottom",
            color=_BOUND,
            fontsize=9,
        )
    ax.set_xlim(min(0.0, heights.min(initial=0.0)) * 1.05, top * 1.02 or 1.0)
    ax.set_xlabel("value (total benefit less handovers)")
    ax.tick_params(axis="y", length=0)
    _despine(ax, left=True)
    return ax


def benefit_history(
    problem: SAP, results: Mapping[str, Result], agent: int = 0, ax: Axes | None = None
) -> Axes:
    """Draw the benefit of the tasks that one agent holds over the steps, handovers marked (Holder 2024, Figure 4.4b).

    Parameters
    ----------
    problem : SAP
    results : mapping of str to Result
        One line for each. The legend tells how often the agent changed its task and what it earned in all.
    agent : int
        The agent, 0-based.
    ax : Axes, optional

    Returns
    -------
    Axes

    Raises
    ------
    ValueError
        If there is no such agent.
    """
    if not 0 <= agent < problem.n:
        raise ValueError(f"agent must lie in 0..{problem.n - 1}, got {agent}")
    ax = _axes(ax, (8.0, 3.6))
    steps = np.arange(problem.T)
    for number, (name, result) in enumerate(results.items()):
        color = PALETTE[number % len(PALETTE)]
        benefit = problem.benefits.at(result.plan)[:, agent]
        changed = _changes(problem, result.plan)[:, agent]
        label = f"{name}: benefit {benefit.sum():.1f}, {int(changed.sum())} handovers"
        # The later lines are thinner, so that equal stretches stay visible under each other.
        width = max(3.2 - 1.1 * number, 1.1)
        ax.plot(
            steps, benefit, color=color, lw=width, label=label, zorder=2 + number, solid_joinstyle="round"
        )
        ax.plot(
            steps[changed],
            benefit[changed],
            ls="none",
            marker="o",
            ms=5.5 - 0.6 * min(number, 3),
            mfc="white",
            mec=color,
            mew=1.3,
            zorder=10 + number,
        )
    ax.set_xlim(0, max(problem.T - 1, 1))
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.set_xlabel("step")
    ax.set_ylabel(f"benefit of the task of agent {agent}")
    ax.grid(axis="y", color="#EEEEEE", zorder=0)
    ax.set_axisbelow(True)
    ax.legend(
        loc="lower left", bbox_to_anchor=(0, 1.01), frameon=False, fontsize=9, title="circles: handovers",
        title_fontsize=9, alignment="left", ncols=2 if len(results) > 3 else 1,
    )  # fmt: skip
    _despine(ax)
    return ax


def timeline(
    problem: SAP, result: Result, agents: Sequence[int] | None = None, ax: Axes | None = None
) -> Axes:
    """Draw what every agent does at every step: the benefit of its task as colour, handovers as strokes.

    Parameters
    ----------
    problem : SAP
    result : Result
    agents : sequence of int, optional
        The agents to draw, from top to bottom; by default the first 40.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    rows = np.arange(min(problem.n, 40)) if agents is None else np.asarray(agents, dtype=np.int64)
    if len(rows) == 0 or rows.min() < 0 or rows.max() >= problem.n:
        raise ValueError(f"agents must be numbers in 0..{problem.n - 1}, got {list(rows)}")
    ax = _axes(ax, (9.0, 0.13 * len(rows) + 1.6))
    benefit = problem.benefits.at(result.plan)[:, rows].T
    changed = _changes(problem, result.plan)[:, rows].T
    image = ax.imshow(
        np.where(benefit > 0, benefit, np.nan),
        aspect="auto",
        interpolation="nearest",
        cmap=_BLUES.with_extremes(bad=_IDLE),
        vmin=0.0,
        vmax=max(float(benefit.max()), 1e-12),
    )
    row, step = np.nonzero(changed)
    x = step - 0.5
    strokes = np.stack([np.stack([x, row - 0.42], axis=1), np.stack([x, row + 0.42], axis=1)], axis=1)
    ax.add_collection(LineCollection(list(strokes), colors=_BOUND, linewidths=1.1))
    ax.hlines(np.arange(len(rows) - 1) + 0.5, -0.5, problem.T - 0.5, color="white", lw=1.0)
    ax.set_yticks(*_few_ticks(rows))
    ax.set_xlabel("step")
    ax.set_ylabel("agent")
    ax.set_title(
        f"{_name(result)}: colour is the benefit of the task held, grey is idle, a red stroke is a handover",
        fontsize=9,
        loc="left",
        color=_MUTED,
    )
    bar = ax.figure.colorbar(image, ax=ax, pad=0.015, fraction=0.03)
    bar.set_label("benefit")
    bar.outline.set_visible(False)
    ax.tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return ax


def gap_trace(result: Result, ax: Axes | None = None) -> Axes:
    """Draw how the proven gap between the bound and the best plan closed while a planner ran.

    Parameters
    ----------
    result : Result
        With a trace whose records hold ``seconds``, ``bound`` and ``value``.
    ax : Axes, optional

    Returns
    -------
    Axes
        Seconds against the gap in percent of the bound, on a logarithmic scale down to 0.001 %.

    Raises
    ------
    ValueError
        If the trace holds no bound; policies decide step by step and have none.
    """
    known = [r for r in result.trace if r.get("bound") and r.get("value") is not None]
    if not known:
        raise ValueError(f"result: the trace of {result.solver} holds no bounds; gap_trace is for planners")
    seconds = np.array([r["seconds"] for r in known])
    bound = np.minimum.accumulate([r["bound"] for r in known])
    value = np.maximum.accumulate([r["value"] for r in known])
    gap = np.maximum(100 * (bound - value) / np.abs(bound), _SMALLEST_GAP)
    ax = _axes(ax, (7.2, 3.4))
    ax.step(seconds, gap, where="post", color=_BEST, lw=1.8)
    ax.plot(seconds[-1], gap[-1], "o", color=_BEST, ms=5)
    ax.annotate(
        f"{gap[-1]:.3f} %" if gap[-1] > _SMALLEST_GAP else f"at most {_SMALLEST_GAP} %",
        (seconds[-1], gap[-1]),
        xytext=(0, 8),
        textcoords="offset points",
        ha="right",
        color=_BEST,
    )
    ax.set_yscale("log")
    ax.set_ylim(gap.min() / 2, gap.max() * 2)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda percent, _: f"{percent:g} %"))
    ax.set_title(
        f"{_name(result)}: best plan {value[-1]:,.1f}, proven bound {bound[-1]:,.1f}",
        fontsize=9,
        loc="left",
        color=_MUTED,
    )
    ax.set_xlim(left=0)
    ax.set_xlabel("seconds")
    ax.set_ylabel("proven gap")
    ax.grid(axis="y", color="#EEEEEE")
    ax.set_axisbelow(True)
    _despine(ax)
    return ax


def _axes(ax: Axes | None, size: tuple[float, float]) -> Axes:
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt  # only here: whoever brings an axes needs no window system

    return plt.subplots(figsize=size, layout="constrained")[1]


def _despine(ax: Axes, left: bool = False) -> None:
    for side in ("top", "right", *(("left",) if left else ())):
        ax.spines[side].set_visible(False)


def _few_ticks(rows: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """At most about 20 labels."""
    shown = np.arange(0, len(rows), -(-len(rows) // 20))
    return shown, [str(rows[k]) for k in shown]


def _changes(problem: SAP, plan: np.ndarray) -> np.ndarray:
    """Where an agent holds another task than at the step before, shape (T, n)."""
    first = plan[:1] if problem.initial_assignment is None else np.asarray(problem.initial_assignment)[None]
    return np.diff(plan, axis=0, prepend=first) != 0


def _name(result: Any) -> str:
    return str(getattr(result, "solver", "plan"))
