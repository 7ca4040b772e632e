"""Figures of values: against the bound, against time, against the lookahead, against the promise of the theorem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, MaxNLocator

from sapopt.plotting.style import (
    BAR,
    BEST,
    BOUND,
    GRID,
    MUTED,
    PALETTE,
    axes_or_new,
    despine,
    name_of,
)  # fmt: skip

if TYPE_CHECKING:
    from sapopt.problem.result import Result

_SMALLEST_GAP = 0.001  # percent; a gap of zero has no place on a logarithmic scale


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
    ax = axes_or_new(ax, (7.2, 0.42 * len(values) + 1.3))
    names, heights = list(values), np.array(list(values.values()), dtype=float)
    best = heights.max() if len(heights) else 0.0
    colors = [BEST if height == best else BAR for height in heights]
    rows = np.arange(len(names))
    ax.barh(rows, heights, height=0.68, color=colors)
    ax.set_yticks(rows, names)
    ax.invert_yaxis()
    top = max(best, bound if bound is not None else best, 0.0)
    for row, height in zip(rows, heights, strict=True):
        text = f"{height:,.1f}"
        if bound is not None and bound > 0:
            share = height / bound
            text = f"{100 * share:.{2 if 0.995 < share < 1.0 else 1}f} %"  # almost the bound is not all of it
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
        ax.axvline(bound, color=BOUND, lw=1.6)
        ax.annotate(
            f"proven bound {bound:,.1f}",
            (bound, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 4),
            textcoords="offset points",
            ha="right",
            va="bottom",
            color=BOUND,
            fontsize=9,
        )
    ax.set_xlim(min(0.0, heights.min(initial=0.0)) * 1.05, top * 1.02 or 1.0)
    ax.set_xlabel("value (total benefit less handovers)")
    ax.tick_params(axis="y", length=0)
    despine(ax, left=True)
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
    ax = axes_or_new(ax, (7.2, 3.4))
    ax.step(seconds, gap, where="post", color=BEST, lw=1.8)
    ax.plot(seconds[-1], gap[-1], "o", color=BEST, ms=5)
    ax.annotate(
        f"{gap[-1]:.3f} %" if gap[-1] > _SMALLEST_GAP else f"at most {_SMALLEST_GAP} %",
        (seconds[-1], gap[-1]),
        xytext=(0, 8),
        textcoords="offset points",
        ha="right",
        color=BEST,
    )
    ax.set_yscale("log")
    ax.set_ylim(gap.min() / 2, gap.max() * 2)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda percent, _: f"{percent:g} %"))
    ax.set_title(
        f"{name_of(result)}: best plan {value[-1]:,.1f}, proven bound {bound[-1]:,.1f}",
        fontsize=9,
        loc="left",
        color=MUTED,
    )
    ax.set_xlim(left=0)
    ax.set_xlabel("seconds")
    ax.set_ylabel("proven gap")
    ax.grid(axis="y", color=GRID)
    ax.set_axisbelow(True)
    despine(ax)
    return ax


def value_against_lookahead(
    values: Mapping[str, Mapping[int, Any]],
    bound: float | None = None,
    levels: Mapping[str, float] | None = None,
    colors: Mapping[str, str] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw what methods reach against the number of steps they look ahead (Holder 2024, Figure 4.3).

    Parameters
    ----------
    values : mapping of str to mapping of int to float or sequence of float
        For each method, by lookahead, its value; with several (one for each seed) their mean is drawn, and a band of
        one standard deviation.
    bound : float, optional
        A proven upper bound.
    levels : mapping of str to float, optional
        Methods without a lookahead, as dashed lines.
    colors : mapping of str to str, optional
        Colour by name; those of the palette in turn if omitted.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_or_new(ax, (6.4, 4.0))
    names = [*values, *(levels or {})]
    color = {name: PALETTE[k % len(PALETTE)] for k, name in enumerate(names)} | dict(colors or {})
    for name, curve in values.items():
        lookaheads = sorted(curve)
        drawn = [np.atleast_1d(np.asarray(curve[length], dtype=np.float64)) for length in lookaheads]
        mean = np.array([v.mean() for v in drawn])
        ax.plot(lookaheads, mean, color=color[name], marker="o", ms=4.5, label=name)
        if any(len(v) > 1 for v in drawn):
            spread = np.array([v.std(ddof=1) if len(v) > 1 else 0.0 for v in drawn])
            ax.fill_between(lookaheads, mean - spread, mean + spread, color=color[name], alpha=0.15, lw=0)
    for name, level in (levels or {}).items():
        ax.axhline(level, color=color[name], ls="--", lw=1.2, label=name)
    if bound is not None:
        ax.axhline(bound, color=BOUND, lw=1.6, label=f"proven bound {bound:,.1f}")
    ax.set_xlabel("lookahead (steps)")
    ax.set_ylabel("value of the plan")
    ax.set_ylim(bottom=min(0.0, ax.get_ylim()[0]))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if len(names) + (bound is not None) > 1:
        ax.legend(frameon=False, fontsize=9)
    ax.grid(axis="y", color=GRID)
    ax.set_axisbelow(True)
    despine(ax)
    return ax


def ratio_against_c(
    points: Mapping[str, Any], violations: Any = None, markers: Sequence[str] = ".os^", ax: Axes | None = None
) -> Axes:
    """Draw value over optimum against c, with the curve c/(1+c) that theorem 3.5.1 promises.

    Parameters
    ----------
    points : mapping of str to array_like of shape (N, 2)
        For each source of instances, c and ratio; instances with c = 0 are left out, the theorem says nothing there.
    violations : array_like of shape (N, 2), optional
        Points that are ringed in red.
    markers : sequence of str
        Marks of the sources in turn.
    ax : Axes, optional

    Returns
    -------
    Axes
    """
    ax = axes_or_new(ax, (5.2, 4.2))
    c = np.geomspace(0.01, 2000.0, 400)
    ax.plot(c, c / (1 + c), color="black", lw=1.5, label="c / (1 + c)", zorder=3)
    for number, (name, pairs) in enumerate(points.items()):
        known = np.reshape(np.asarray(pairs, dtype=np.float64), (-1, 2))
        known = known[known[:, 0] > 0]
        mark = markers[number % len(markers)]
        ax.scatter(known[:, 0], known[:, 1], s=10 if mark == "." else 17, marker=mark, lw=0, alpha=0.7, label=name,
            color=("#9AA5B1", *PALETTE)[number % (len(PALETTE) + 1)],
        )  # fmt: skip
    if violations is not None and len(violations):
        ringed = np.reshape(np.asarray(violations, dtype=np.float64), (-1, 2))
        ax.scatter(ringed[:, 0], ringed[:, 1], s=60, facecolors="none", edgecolors="red", lw=1.0, zorder=4)
    ax.set(xscale="log", xlim=(0.01, 2000), ylim=(-0.02, 1.02), xlabel="c", ylabel="value / optimum")
    ax.legend(frameon=False, fontsize=9, loc="lower right")
    ax.grid(color=GRID)
    ax.set_axisbelow(True)
    despine(ax)
    return ax
