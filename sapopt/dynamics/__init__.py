"""State models: how assignments move the state, and what a change of task costs."""

from sapopt.dynamics.base import Dynamics
from sapopt.dynamics.battery import Battery, BatteryState
from sapopt.dynamics.dictator import Dictator
from sapopt.dynamics.switching import SwitchingCost

__all__ = ["Battery", "BatteryState", "Dictator", "Dynamics", "SwitchingCost"]
