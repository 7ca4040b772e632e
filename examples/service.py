"""A session as a web service.

    pip install 'sapopt[serve]'
    python examples/service.py --agents 20 --tasks 30

Goes on from the file if there is one, and writes it after every step. Ask it with

    curl -X POST localhost:8000/step -H 'Content-Type: application/json' -d \
      '{"agents": ["north"], "tasks": ["port", "field"], "benefits": [[["north", "port", 1.0]]]}'

or look at http://localhost:8000/docs. `docs/howto_service.md` explains it step by step.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from sapopt import Session, SwitchingCost
from sapopt.live.service import create_app
from sapopt.solvers import DualLookahead


def session_of(path: Path) -> Session:
    """The session of a file, or a new one."""
    if path.exists():
        return Session.load(path)
    return Session(DualLookahead(6), SwitchingCost(0.5), idle=True)


def options() -> argparse.Namespace:
    """What the command line says."""
    parser = argparse.ArgumentParser(description="A session as a web service.")
    parser.add_argument("file", nargs="?", type=Path, default=Path("session.npz"), help="where it is kept")
    parser.add_argument("--agents", type=int, default=20, help="about how many there will be")
    parser.add_argument("--tasks", type=int, default=30, help="about how many there will be")
    parser.add_argument("--budget", type=float, default=0.1, help="seconds for a decision")
    parser.add_argument("--port", type=int, default=8000)
    return parser.parse_args()


if __name__ == "__main__":
    import uvicorn

    given = options()
    session = session_of(given.file)
    print("compiling: a minute or two on the first start, then seconds", flush=True)
    session.warm(agents=given.agents, tasks=given.tasks, budget_s=given.budget)
    uvicorn.run(create_app(session, save_to=given.file, budget_s=given.budget), port=given.port)
