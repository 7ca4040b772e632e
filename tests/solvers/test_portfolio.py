"""What a round of the search does next."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest

from sapopt import SAP, SwitchingCost
from sapopt.solvers.dual_decomposition.dives import Dives
from sapopt.solvers.dual_decomposition.exchanges import Exchanges
from sapopt.solvers.dual_decomposition.portfolio import Portfolio
from sapopt.solvers.dual_decomposition.search import DualSearch


@pytest.fixture
def sparse() -> Portfolio:
    """Of a problem most of whose pairs are worth nothing, with a minute of time."""
    rng = np.random.default_rng(0)
    benefits = rng.random((40, 20, 25)) * (rng.random((40, 20, 25)) < 0.05)
    return Portfolio(SAP(benefits, SwitchingCost(1.0)), 1, 60.0)


def test_windows_not_tried_yet_come_first_where_agents_wait(sparse: Portfolio) -> None:
    """Dives and exchanges have their turn once windows of every kind have gained nothing."""
    sparse.learn(None, 0.0, 1.0)
    assert sparse.turn(10.0, 50.0, has_untried=True) is None
    assert sparse.turn(10.0, 50.0, has_untried=False) is not None


def test_where_nothing_is_gained_all_get_as_much_time(sparse: Portfolio) -> None:
    """A way that takes ten times as long comes a tenth as often."""
    seconds = {Dives: 1.0, Exchanges: 10.0, type(None): 2.0}
    spent = dict.fromkeys(seconds, 0.0)
    left = 1000.0
    sparse.time_limit = left
    while left > 0.0:
        way = sparse.turn(10.0, left)
        sparse.learn(way, 0.0, seconds[type(way)])
        spent[type(way)] += seconds[type(way)]
        left -= seconds[type(way)]
    assert max(spent.values()) - min(spent.values()) <= 10.0


def test_who_has_found_something_is_not_idle(sparse: Portfolio) -> None:
    """What was gained goes first, however long it took."""
    for way in (None, *sparse.others):
        sparse.learn(way, 0.0, 1.0)
    exchanges = next(way for way in sparse.others if isinstance(way, Exchanges))
    sparse.learn(exchanges, 1.0, 30.0)
    assert sparse.turn(10.0, 25.0) is exchanges


@pytest.mark.parametrize("rounds", [None, 5])
def test_no_round_begins_once_time_is_over(rounds: int | None) -> None:
    """Rounds that find nothing give the caller no chance to look at the clock."""
    search = Mock(seconds_left=1.0)
    search.options.rounds, search.run.time_limit = rounds, 10.0
    turns = DualSearch.turns(search)
    assert next(turns) == 0
    search.seconds_left = 0.0
    assert list(turns) == []
