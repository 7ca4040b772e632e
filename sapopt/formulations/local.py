"""The finite local states of a problem's agents, whichever way its dynamics tells of them."""

from __future__ import annotations

from sapopt.dynamics.paths.oracles import LocalModel, LocalOracle
from sapopt.problem.sap import SAP


def local_model(problem: SAP) -> LocalModel | None:
    """The agents' finite states, or None where the dynamics does not say that its state is local to the agents.

    A dynamics tells by a method ``local_model(benefits, state) -> LocalModel``, or by a ``path_oracle`` that is a
    `LocalOracle`.
    """
    model = problem.model
    if not model.is_agent_local:
        return None
    found = model.local_model(problem.benefits, problem.initial_state())
    if found is None:
        oracle = model.path_oracle(problem.benefits, problem.initial_state())
        return oracle.model if isinstance(oracle, LocalOracle) else None
    return found if isinstance(found, LocalModel) else None


def not_local(problem: SAP) -> str | None:
    """Why the problem has no local states, or None if it has."""
    if local_model(problem) is not None:
        return None
    return (
        f"{problem.model.called} does not say that its state splits into one finite state per agent "
        "(method local_model); Exact(method='dp') takes any dynamics of a tiny problem"
    )
