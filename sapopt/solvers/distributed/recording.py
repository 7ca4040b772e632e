"""Play a distributed policy and keep what every step cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sapopt.data.types import IntArray
from sapopt.problem.sap import SAP
from sapopt.running.control import Run
from sapopt.running.outlook import Outlook, Policy
from sapopt.running.rollout import Rollout, rollout
from sapopt.solvers.distributed.simulator import Traffic


@dataclass(frozen=True)
class _Recorder:
    """Plays a policy and notes the traffic in its memory."""

    policy: Any
    steps: list[Traffic] = field(default_factory=list)

    @property
    def name(self) -> str:
        return str(self.policy.name)

    def begin(self, problem: SAP, rng: np.random.Generator) -> Any:
        return self.policy.begin(problem, rng)

    def act(self, outlook: Outlook, memory: Any) -> tuple[IntArray, Any]:
        tasks, memory = self.policy.act(outlook, memory)
        self.steps.append(memory.traffic)
        return tasks, memory

    def record(self, memory: Any) -> dict[str, Any]:
        return dict(self.policy.record(memory))


def play(problem: SAP, policy: Policy, run: Run | None = None) -> tuple[Rollout, list[Traffic]]:
    """`sapopt.running.rollout.rollout` of a distributed policy, with the traffic of every step.

    Parameters
    ----------
    problem : SAP
    policy : HAALD, CBBA, DistributedAuction or DistributedDualLookahead
    run : Run, optional
    """
    recorder = _Recorder(policy)
    return rollout(problem, recorder, run), recorder.steps
