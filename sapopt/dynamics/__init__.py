"""State models: how assignments move the state, and what a change of task costs."""

from sapopt.dynamics.agent_local import AgentLocal, LocalStates
from sapopt.dynamics.base import Dynamics
from sapopt.dynamics.battery import Battery, BatteryState
from sapopt.dynamics.dictator import Dictator
from sapopt.dynamics.interference import Interference
from sapopt.dynamics.ride_hailing import RideHailing
from sapopt.dynamics.slewing import SlewCost
from sapopt.dynamics.switching import SwitchingCost
from sapopt.dynamics.synthetic import SyntheticSwitching
from sapopt.dynamics.unit_commitment import UnitCommitment

__all__ = [
    "AgentLocal",
    "Battery",
    "BatteryState",
    "Dictator",
    "Dynamics",
    "Interference",
    "LocalStates",
    "RideHailing",
    "SlewCost",
    "SwitchingCost",
    "SyntheticSwitching",
    "UnitCommitment",
]
