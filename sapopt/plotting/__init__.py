"""Figures of problems and results. Every function draws on one matplotlib axes and returns it.

Without ``ax`` a new figure is made through pyplot. The colours are the Okabe-Ito palette, which the colour-blind can
tell apart.
"""

from sapopt.plotting.plans import benefit_history, price_heat_map, timeline
from sapopt.plotting.style import PALETTE
from sapopt.plotting.values import gap_trace, ratio_against_c, value_against_bound, value_against_lookahead
from sapopt.plotting.world import world_map

__all__ = [
    "PALETTE",
    "benefit_history",
    "gap_trace",
    "price_heat_map",
    "ratio_against_c",
    "timeline",
    "value_against_bound",
    "value_against_lookahead",
    "world_map",
]
