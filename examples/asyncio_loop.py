"""A control loop in asyncio: forecasts come in through a queue, decisions go out, and the loop never stands still.

    python examples/asyncio_loop.py

The session thinks in a thread, so that timers, sockets and whatever else the loop serves go on meanwhile.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import numpy as np

from sapopt import Decision, Session, SwitchingCost
from sapopt.solvers import DualLookahead

STEPS = 5


async def forecasts(steps: int = STEPS) -> AsyncIterator[dict[str, Any]]:
    """Made-up forecasts: the window and the ids of every step; a real source would be a socket or a message queue."""
    rng = np.random.default_rng(0)
    for k in range(steps):
        await asyncio.sleep(0.01)  # until the next step begins
        agents = [f"sat {i}" for i in range(4) if i != k]  # another one fails at every step
        tasks = [f"task {j}" for j in range(k, k + 6)]
        yield {"benefits": rng.random((3, len(agents), len(tasks))), "agents": agents, "tasks": tasks}


async def decisions(session: Session, budget_s: float = 0.05) -> AsyncIterator[Decision]:
    """A decision for every forecast."""
    async for call in forecasts():
        yield await asyncio.to_thread(
            session.step, call["benefits"], agents=call["agents"], tasks=call["tasks"], budget_s=budget_s
        )


async def main() -> list[Decision]:
    """Decide as long as forecasts come."""
    session = Session(DualLookahead(3), SwitchingCost(0.1))
    await asyncio.to_thread(session.warm, agents=4, tasks=6)
    found = []
    async for decision in decisions(session):
        print(decision.step, decision.assignment, decision.status.value)
        found.append(decision)
    return found


if __name__ == "__main__":
    asyncio.run(main())
