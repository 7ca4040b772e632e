"""Learned policies: REDA and its rivals, their training, and problems as environments. Needs the extra ``learn``."""

from __future__ import annotations

try:
    import safetensors  # noqa: F401
    import torch  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"sapopt.learning needs {error.name or 'PyTorch'}; install the extra: pip install 'sapopt[learn]'"
    ) from error

from sapopt.learning.environment import Environment
from sapopt.learning.network import Network, load_network, save_network
from sapopt.learning.observation import ObservationSpec, ThesisObservation
from sapopt.learning.options import TrainOptions
from sapopt.learning.reda import REDA
from sapopt.learning.state_observation import StateObservation
from sapopt.learning.train import Training, train

__all__ = [
    "REDA",
    "Environment",
    "Network",
    "ObservationSpec",
    "StateObservation",
    "ThesisObservation",
    "TrainOptions",
    "Training",
    "load_network",
    "save_network",
    "train",
]
