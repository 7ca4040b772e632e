"""A session as a web service.

    pip install 'sapopt[serve]'
    python examples/service.py session.npz

Goes on from the file if there is one, and writes it after every step. Ask it with

    curl -X POST localhost:8000/step -H 'Content-Type: application/json' -d \
      '{"agents": ["north"], "tasks": ["port", "field"], "benefits": [[["north", "port", 1.0]]]}'

or look at http://localhost:8000/docs.
"""

from __future__ import annotations

import sys
from pathlib import Path

from sapopt import Session, SwitchingCost
from sapopt.live.service import create_app
from sapopt.solvers import DualLookahead


def session_of(path: Path) -> Session:
    """The session of a file, or a new one."""
    if path.exists():
        return Session.load(path)
    session = Session(DualLookahead(6), SwitchingCost(0.5))
    session.warm(agents=1000, tasks=1250, budget_s=0.1)
    return session


if __name__ == "__main__":
    import uvicorn

    file = Path(sys.argv[1] if len(sys.argv) > 1 else "session.npz")
    uvicorn.run(create_app(session_of(file), save_to=file, budget_s=0.1), port=8000)
