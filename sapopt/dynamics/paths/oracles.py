"""What agent-local dynamics offer: each agent's longest path under task prices.

A dynamics is *agent-local* when the state splits into one finite state per agent that only the agent's own assignments
change. Once the task capacities are priced, the agents no longer see each other, and the best a single agent can do is
a longest path. `PathOracle` is the interface through which dual methods ask for those paths.

Two ways in: a dynamics may bring its own oracle (method ``path_oracle(benefits, state)``, as `SwitchingCost` does, with
compiled recursions), or describe its finite states (method ``local_model(benefits, state)``, a `LocalModel`), from
which a compiled oracle is made. `LocalOracle` is the same in plain numpy, slow and easy to check.
"""

from __future__ import annotations

import logging
from typing import Any, Protocol, runtime_checkable

import numpy as np

from sapopt.data.types import FloatArray, IntArray

log = logging.getLogger(__name__)

IDLE = -1
"""Stands for every task that is worth nothing to the agent at the step."""


@runtime_checkable
class PathOracle(Protocol):
    """Longest priced paths of the agents over one window of steps."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window the oracle was made for."""

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of every agent's longest path under `prices` (T, m)."""

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a price of +inf forbids a task at a step."""


@runtime_checkable
class SoftPathOracle(PathOracle, Protocol):
    """An oracle that can also soften its maximum: what the fast dual ascent needs."""

    @property
    def scale(self) -> float:
        """Typical size of a benefit."""

    @property
    def coldest(self) -> float:
        """Lowest temperature that `soft_paths` can take."""

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Values (n,) of ``temperature * log sum exp(path value / temperature)`` over an agent's paths, and the
        expected usage (T, m) of the tasks under the Gibbs distribution of the paths, summed over the agents."""


@runtime_checkable
class FirstValueOracle(PathOracle, Protocol):
    """An oracle that can value every first task: what `DualLookahead` needs."""

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count.

        -inf where the first task is forbidden.
        """


@runtime_checkable
class FirstGainsOracle(PathOracle, Protocol):
    """An oracle that values first tasks in the sparse form of one assignment problem."""

    def first_gains(self, prices: FloatArray) -> Any:
        """`FirstValueOracle.first_values` as a `sapopt.data.matrices.GainMatrix`, less any constant for every agent."""


@runtime_checkable
class PlacingOracle(PathOracle, Protocol):
    """An oracle that can re-plan many agents in turn without a call for each."""

    def place(self, order: IntArray, closed: FloatArray, prices: FloatArray, plan: IntArray) -> None:
        """Let the agents of `order` move one by one: each gives up its cells and takes its best open path.

        Parameters
        ----------
        closed : (T, m)
            Prices with +inf at the cells that `plan` holds; kept so, in place.
        prices : (T, m)
            Prices of open cells.
        plan : (T, n)
            A feasible plan; changed in place.
        """


@runtime_checkable
class SteppingOracle(PathOracle, Protocol):
    """An oracle that can go on by a step: what a rolling plan asks for at every step, made only once."""

    def after(self, assignment: IntArray) -> PathOracle:
        """Paths of the later steps, once the agents held `assignment` (n,) at the first one."""


@runtime_checkable
class LocalModel(Protocol):
    """A finite state per agent, numbered 0..S-1 (the same number S for all agents).

    The state before step k and the task held at step k determine the state before step k+1 and what the handover adds
    to the benefit (never the other agents).
    """

    def state_count(self) -> int:
        """Number S of local states."""

    def start(self, agent: int) -> int:
        """Local state of `agent` before the first step of the window."""

    def step(self, k: int, agent: int, benefit: FloatArray) -> tuple[IntArray, FloatArray]:
        """Successor (S, m) of every local state under every task, and handover (S, m) added to `benefit` (m,).

        A handover of -inf forbids the task in that state.
        """


@runtime_checkable
class ChargePathOracle(PathOracle, Protocol):
    """An oracle of agents on batteries."""

    def mean_values(self, prices: FloatArray) -> FloatArray:
        """What each level is worth before each step and after the last, (T + 1, levels + 1): mean of the agents."""


class HasPaths(Protocol):
    """The part of a `sapopt.dynamics.base.Model` that tells of its agents' paths; None where it does not."""

    @property
    def called(self) -> str:
        """Name for messages."""

    def path_oracle(self, benefits: Any, state: Any) -> PathOracle | None:
        """The agents' longest priced paths over a window."""

    def window_oracle(self, benefits: Any, state: Any) -> PathOracle | None:
        """The same where the problem goes on."""

    def local_model(self, benefits: Any, state: Any) -> LocalModel | None:
        """The agents' finite states."""


def path_oracle(model: HasPaths, benefits: Any, state: Any, *, goes_on: bool = False) -> PathOracle:
    """The longest priced paths of a dynamics' agents over a window.

    Parameters
    ----------
    model : Model
    benefits : Benefits
        Those of the window.
    state : object
        State before it.
    goes_on : bool
        The problem goes on after the window, and a dynamics that has a ``window_oracle`` says what the state at its end
        is worth. Not for bounds.

    Raises
    ------
    ValueError
        If the dynamics is not agent-local.
    """
    made = model.window_oracle(benefits, state) if goes_on else None
    if made is None:
        made = model.path_oracle(benefits, state)
    if made is None:
        states = model.local_model(benefits, state)
        if states is None:
            raise ValueError(
                f"dynamics: {model.called} is not agent-local: it has neither path_oracle nor local_model"
            )
        made = compiled(benefits, states)
    return made


def compiled(benefits: Any, model: LocalModel) -> PathOracle:
    """A compiled oracle of a `LocalModel`: its tables are read once, tasks that do the same become one arc.

    Where that saves nothing (every task leads to a state of its own, and there are many), it is a `LocalOracle`, and
    the log says so.
    """
    from sapopt.data.benefits import Benefits
    from sapopt.dynamics.paths.arcs import ArcPaths  # compiled code: imported when it is needed
    from sapopt.dynamics.paths.arcs_build import model_graph

    graph = model_graph(model, Benefits(benefits))
    if graph is None:
        log.warning("%s has too many arcs to compile; its paths are slow", type(model).__name__)
        return LocalOracle(benefits, model)
    return ArcPaths(graph)


class LocalOracle:
    """Longest paths of any `LocalModel`, by plain dynamic programming: O(T S m) an agent, in numpy.

    Parameters
    ----------
    benefits : (T, n, m) float array, or anything with `shape` and `step(k)`
        Static benefits of the window.
    model : LocalModel
        The agents' finite states; kept as an attribute.
    """

    def __init__(self, benefits: Any, model: LocalModel) -> None:
        self._benefits = benefits
        self.model = model
        T, n, m = benefits.shape
        self._shape = int(T), int(n), int(m)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._shape

    def _benefit(self, k: int, agent: int) -> FloatArray:
        step = self._benefits[k] if isinstance(self._benefits, np.ndarray) else self._benefits.step(k)
        row = step[agent] if isinstance(step, np.ndarray) else step[[agent]].toarray()[0]
        return np.asarray(row, dtype=np.float64)

    def first_values(self, prices: FloatArray) -> FloatArray:
        """Value (n, m) of every agent's best path that starts with every task; the first step's prices do not count."""
        T, n, m = self._shape
        later = np.array(prices, dtype=np.float64)
        later[0] = 0.0
        values = np.empty((n, m))
        for i in range(n):
            to_go = np.zeros(self.model.state_count())
            for k in range(T - 1, -1, -1):
                benefit = self._benefit(k, i)
                successor, handover = self.model.step(k, i, benefit)
                total = (benefit - later[k])[None, :] + handover + to_go[successor]
                to_go = total.max(axis=1)
            values[i] = total[self.model.start(i)]
        return values

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent under `prices` (T, m)."""
        T, _, _ = self._shape
        S = self.model.state_count()
        to_go = np.zeros(S)
        choice = np.empty((T, S), dtype=np.int64)
        follow = np.empty((T, S), dtype=np.int64)
        for k in range(T - 1, -1, -1):
            benefit = self._benefit(k, agent)
            successor, handover = self.model.step(k, agent, benefit)
            total = (benefit - prices[k])[None, :] + handover + to_go[successor]
            choice[k] = total.argmax(axis=1)
            rows = np.arange(S)
            follow[k] = successor[rows, choice[k]]
            to_go = total[rows, choice[k]]
        s = self.model.start(agent)
        value = float(to_go[s])
        path = np.empty(T, dtype=np.int64)
        for k in range(T):
            path[k] = choice[k, s]
            s = int(follow[k, s])
        return value, path

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        T, n, _ = self._shape
        values = np.empty(n)
        plan = np.empty((T, n), dtype=np.int64)
        for i in range(n):
            values[i], plan[:, i] = self.best_path(i, prices)
        return values, plan
