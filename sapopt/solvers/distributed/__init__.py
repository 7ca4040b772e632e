"""Solvers without a central node: agents that exchange packets with their neighbours in a communication graph."""

from sapopt.solvers.distributed.auction import AuctionResult, DistributedAuction
from sapopt.solvers.distributed.cbba import CBBA
from sapopt.solvers.distributed.common import Memory
from sapopt.solvers.distributed.dual import DistributedDualLookahead
from sapopt.solvers.distributed.faults import Cut, Faults
from sapopt.solvers.distributed.haal_d import HAALD, CentralHAALD
from sapopt.solvers.distributed.network import Network, Networks
from sapopt.solvers.distributed.recording import play
from sapopt.solvers.distributed.simulator import Simulator, Traffic

__all__ = [
    "CBBA",
    "HAALD",
    "AuctionResult",
    "CentralHAALD",
    "Cut",
    "DistributedAuction",
    "DistributedDualLookahead",
    "Faults",
    "Memory",
    "Network",
    "Networks",
    "Simulator",
    "Traffic",
    "play",
]
