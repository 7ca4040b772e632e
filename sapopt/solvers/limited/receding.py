"""One step of the dual lookahead where there are capacities, limits and teams."""

from __future__ import annotations

import numpy as np

from sapopt.data.types import IntArray
from sapopt.formulations.limited.ascent import Ascent
from sapopt.formulations.limited.building import path_graph
from sapopt.formulations.limited.dual import Prices
from sapopt.formulations.limited.window import window_of
from sapopt.kernels import clock
from sapopt.running.outlook import Outlook
from sapopt.solvers.limited.rolling import first_values

_FIRST_TEMPERATURES = (0.3, 0.1, 0.03)
_TEMPERATURES = (0.1, 0.03)
"""Of the smoothed dual of a window: at the first step, and where the prices of the step before are known."""


def priced_step(
    outlook: Outlook, window: int, iterations: int, memory: Prices | None, seconds: float
) -> tuple[IntArray, Prices]:
    """Prices of the next `window` steps, what is left of each limit among them, then one assignment.

    Parameters
    ----------
    outlook : Outlook
        Of a core (`SAP.core`).
    window, iterations : int
    memory : Prices or None
        Of the step before, to go on from.
    seconds : float
        Time for the prices.
    """
    assert outlook.rules is not None
    ledger = outlook.rules.ledger
    benefits = outlook.benefits(window)
    part = window_of(outlook.problem, outlook.k, benefits, ledger.previous, ledger.used)
    graph = path_graph(part, outlook.state)
    T, m = part.T, part.m

    def watch(_: int, __: float) -> bool:
        outlook.check()
        return False

    known = np.zeros((T, m))
    limits = np.zeros(part.rows.count)
    if memory is not None:
        rows = min(T, len(memory.tasks) - 1)
        known[:rows] = memory.tasks[1 : rows + 1]
        limits = memory.limits
    start = Prices(known, limits, np.zeros(len(part.rows.team_cell)))
    stages = _FIRST_TEMPERATURES if memory is None else _TEMPERATURES
    ascent = Ascent(
        graph, clock.now() + seconds, watch, iterations=max(5, iterations // len(stages)), polish=False
    )
    prices = ascent.run(start, stages).prices
    effective = prices.effective(part.rows)
    weight = graph.priced(effective, prices.limits)
    onward, _ = graph.onward(weight)
    values, _ = first_values(graph, graph.node_ptr[:-1], weight, onward, 0)
    return outlook.assign(values + effective[0]), prices
