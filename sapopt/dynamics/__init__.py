"""State models: how assignments move the state, and what a change of task costs."""

from sapopt.dynamics.base import Dynamics
from sapopt.dynamics.battery.model import Battery, BatteryState
from sapopt.dynamics.copies.model import SyntheticSwitching
from sapopt.dynamics.joint.dictator import Dictator
from sapopt.dynamics.joint.interference import Interference
from sapopt.dynamics.rules.agent_local import AgentLocal, LocalStates
from sapopt.dynamics.rules.in_a_row import AtMostInARow
from sapopt.dynamics.rules.jobs import Jobs
from sapopt.dynamics.rules.ride_hailing import RideHailing
from sapopt.dynamics.rules.slewing import SlewCost
from sapopt.dynamics.rules.unit_commitment import UnitCommitment
from sapopt.dynamics.rules.waiting_rides import WaitingRides
from sapopt.dynamics.switching.model import SwitchingCost

__all__ = [
    "AgentLocal",
    "AtMostInARow",
    "Battery",
    "BatteryState",
    "Dictator",
    "Dynamics",
    "Interference",
    "Jobs",
    "LocalStates",
    "RideHailing",
    "SlewCost",
    "SwitchingCost",
    "SyntheticSwitching",
    "UnitCommitment",
    "WaitingRides",
]
