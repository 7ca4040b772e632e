"""Agents that do several tasks at once, and tasks that take several agents, written as a plain SAP, and the way back.

The assignment problem gives every agent one task and every task one agent. Copies lift both limits (thesis, 4.3 and
4.4): an agent that does up to B tasks becomes B *synthetic agents*, a task that takes up to C agents C *synthetic
tasks*; the r-th copy is worth ``decay ** r`` of the original. A handover is still one of the originals: an agent is
charged for a task unless one of its copies held it (or a copy of it) at the step before (`SyntheticSwitching`).

    forward: synthetic_agents(problem, B, decay) -> SyntheticAgents
    or synthetic_tasks(problem, C, decay) -> SyntheticTasks
    solve(....problem, any solver), then back: .original(plan), .evaluate(original), .plan(original)
"""

from sapopt.formulations.synthetic.agents import SyntheticAgents, synthetic_agents
from sapopt.formulations.synthetic.tasks import SyntheticTasks, synthetic_tasks

__all__ = ["SyntheticAgents", "SyntheticTasks", "synthetic_agents", "synthetic_tasks"]
