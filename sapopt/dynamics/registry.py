"""The dynamics that come with sapopt: the only classes that a file can name."""

from __future__ import annotations

from typing import Any

from sapopt.dynamics.base import Model
from sapopt.dynamics.battery.model import Battery
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.dynamics.joint.dictator import Dictator
from sapopt.dynamics.joint.interference import Interference
from sapopt.dynamics.rules.in_a_row import AtMostInARow
from sapopt.dynamics.rules.jobs import Jobs
from sapopt.dynamics.rules.ride_hailing import RideHailing
from sapopt.dynamics.rules.slewing import SlewCost
from sapopt.dynamics.rules.unit_commitment import UnitCommitment
from sapopt.dynamics.rules.waiting_rides import WaitingRides
from sapopt.dynamics.switching.model import SwitchingCost

BUILT_IN: dict[str, type[Model]] = {
    cls.__name__: cls
    for cls in (
        AtMostInARow, Battery, Dictator, Interference, Jobs, RideHailing, SlewCost, SwitchingCost,
        SyntheticSwitching, UnitCommitment, WaitingRides,
    )
}  # fmt: skip
"""Name in files -> class."""


def is_own(dynamics: Any) -> bool:
    """Whether the dynamics is of a user's own class, a subclass of one of sapopt's among them."""
    return type(dynamics) not in BUILT_IN.values()
