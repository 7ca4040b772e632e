"""What a state model is: three methods that are its rule, and what it may say beyond them.

`Model` is what every solver, bound and proof sees: ``problem.model``. It has an answer to every question; a model that
says nothing of itself answers by its rule alone. A user's own class needs the three methods and no base class:
`sapopt.dynamics.capabilities` makes a `Model` of it when the problem is built.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from sapopt.data.benefits import Benefits
from sapopt.data.frozen import frozen
from sapopt.data.matrices import Matrix
from sapopt.data.types import FloatArray, IntArray, real_array
from sapopt.data.windows import WindowSums
from sapopt.dynamics.paths.oracles import ChargePathOracle, LocalModel, PathOracle

if TYPE_CHECKING:
    from sapopt.dynamics.copies.model import SyntheticSwitching


class Setting(Protocol):
    """What a state model may know of the problem it belongs to: sizes, benefits and what is held before the first step.

    Attributes
    ----------
    T, n, m : int
        Steps, agents, tasks.
    initial_assignment : ndarray of int64, shape (n,), or None
    benefits : Benefits
    """

    T: int
    n: int
    m: int
    initial_assignment: IntArray | None
    benefits: Benefits


@dataclass(frozen=True, eq=False)
class Switching:
    """The plain switching rule: the state is the assignment before (None: a first step that is free), moves cost.

    Attributes
    ----------
    cost : float or ndarray of shape (m, m)
        Of every move; entry ``[a, b]`` of a matrix is that of the move from task a to task b.
    idle_is_free : bool
        Only a move to a task of positive benefit is charged.
    """

    cost: float | FloatArray
    idle_is_free: bool

    @property
    def uniform_cost(self) -> float | None:
        """The cost of every move if it is the same for all, else None."""
        return self.cost if isinstance(self.cost, float) else None

    @property
    def largest_cost(self) -> float:
        """The cost of the dearest move."""
        return float(np.max(self.cost))


@dataclass(frozen=True, eq=False)
class Entering:
    """A rule by which a pair costs the same whatever was held before, unless the agent held the same task.

    A move to a pair of benefit b costs ``cost + forfeit * max(b, 0)``; see `sapopt.dynamics.SyntheticSwitching`.

    Attributes
    ----------
    cost : float
    forfeit : float
        Share of the benefit, 0 to 1.
    idle_is_free : bool
        Only a move to a task of positive benefit is charged.
    needs_sight : bool
        A task counts as held only while its benefit is positive.
    """

    cost: float
    forfeit: float = 0.0
    idle_is_free: bool = False
    needs_sight: bool = False


class AgentColumns(NamedTuple):
    """A state in columns of one entry for each agent, so that agents and tasks may come and go between two steps.

    Attributes
    ----------
    tasks : dict of str to ndarray of int64, shape (n,)
        Indices of tasks; -1 for none, also where the task that an agent held is there no more.
    values : dict of str to ndarray, shape (n,)
        Numbers that mean the same whatever tasks there are.
    """

    tasks: dict[str, IntArray]
    values: dict[str, np.ndarray]


class Units(NamedTuple):
    """Drain, charge and capacity of a battery in whole multiples of one `unit` of charge."""

    unit: Any
    drain: int
    charge: int
    capacity: int


class Disturbed(NamedTuple):
    """Pairs of tasks that lose when both are served at a step, where nothing else makes a step depend on the whole.

    Attributes
    ----------
    pairs : ndarray of int64, shape (P, 2)
    loss : ndarray, shape (P,)
        Not negative. With several agents on a task of a pair, the loss may be more than this.
    alone : Model
        The rule without the losses, bound to the benefits; it is agent-local.
    """

    pairs: IntArray
    loss: FloatArray
    alone: Model


class Batteries(Protocol):
    """Agents whose work drains a battery: what prices of energy and values of charge ask for."""

    @property
    def cost(self) -> float:
        """Cost of a handover."""

    @property
    def units(self) -> Units:
        """Drain, charge and capacity in whole levels."""

    def serving(self, state: Any) -> IntArray:
        """Task that every agent may work on without paying, shape ``(n,)``; -1 for none."""

    def levels_of(self, state: Any) -> IntArray:
        """Whole levels of charge of every agent, shape ``(n,)``; 0 is dead."""

    def is_first(self, state: Any) -> bool:
        """Whether the state is that before a first step that pays no handover."""

    def path_oracle(
        self, benefits: Benefits, state: Any, end_value: FloatArray | None = None
    ) -> ChargePathOracle:
        """Longest paths, where the level (L + 1,) that is left over at the end is worth `end_value`."""


class Plain(Protocol):
    """A rule in plain numpy, free of compiled code, for one problem: what certificates are verified with."""

    @property
    def largest_charge(self) -> float:
        """The most that one handover costs."""

    def terms(self, tasks: IntArray) -> FloatArray:
        """Benefit and handover (2, T, n) of every pair of a plan (T, n) of tasks, each without a rounding error."""

    def path_values(self, prices: FloatArray) -> FloatArray:
        """Value (n,) of every agent's longest path under task prices (T, m)."""


class LocalRule(Protocol):
    """What happens to one agent by one rule (`sapopt.dynamics.AgentLocal`)."""

    def rule(
        self, k: int, agent: IntArray, local: IntArray, task: IntArray, benefit: FloatArray
    ) -> tuple[FloatArray, IntArray]:
        """Handover and local state after, for moves of agents in local states; see `AgentLocal.rule`."""


@runtime_checkable
class Dynamics(Protocol):
    """State model of a sequential assignment problem: any class with these three methods, its *rule*.

    The state can be any object; `transition` returns a new one and never changes the old one.

    A class may say more, and gains by it. The names, with what is done without them, are those of `Model`:
    ``handover_at``, ``handover_limit``, ``handover_floor``, ``interval``, ``key``, ``fingerprint``, ``bind``,
    ``validate``, ``interaction`` (with ``marginal`` and ``serves``), ``path_oracle``, ``window_oracle``,
    ``local_model``, ``charge_of``, ``features``, ``agent_columns`` (with ``of_columns``). Each must tell of this very
    rule. A subclass that changes the rule of its base therefore loses what the base says of it, and has to say it anew:
    see `sapopt.dynamics.capabilities`.
    """

    def initial_state(self, problem: Setting) -> Any:
        """State before the first step; ``problem.initial_assignment`` may be None."""

    def handover(self, k: int, state: Any) -> FloatArray:
        """Handover matrix eta(s_k), shape ``(n, m)``, added to the benefits of step k (0-based)."""

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """State after `assignment` (task of every agent, shape ``(n,)``) was held at step k."""


class Model(ABC):
    """A state model with an answer to every question: what ``problem.model`` is.

    A class needs the three abstract methods. What it overrides beyond them is believed, as long as no subclass changes
    what it rests on (`sapopt.dynamics.capabilities`).
    """

    extended_by: ClassVar[frozenset[str]] = frozenset()
    """Names that a subclass may define without making stale what this very class says: all of it calls them."""

    handover_limit: float | None = None
    """The most that one agent can gain by handover and interaction at a step (0.0 for costs); None: not known.

    Without it, or paths, nothing can be proven about the optimum.
    """
    handover_floor: float | None = None
    """The least entry that the handover matrix can have; None: not known. For the a-priori guarantees."""
    idles_freely: ClassVar[bool] = False
    """Whether a task of no benefit is idleness by the rule itself, so that ``idle=True`` needs no rule of its own."""
    capacity: float = 1.0
    """The greatest value of `charge_of`."""

    # The rule

    @abstractmethod
    def initial_state(self, problem: Setting) -> Any:
        """State before the first step; ``problem.initial_assignment`` may be None."""

    @abstractmethod
    def handover(self, k: int, state: Any) -> FloatArray:
        """Handover matrix eta(s_k), shape ``(n, m)``, added to the benefits of step k (0-based)."""

    @abstractmethod
    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """State after `assignment` (task of every agent, shape ``(n,)``) was held at step k; a new object."""

    @property
    def interacts(self) -> bool:
        """Whether a step has terms that depend on the whole assignment, and that no matrix holds."""
        return False

    def interaction(self, k: int, state: Any, assignments: IntArray) -> FloatArray:
        """What every agent gains in a state by the whole assignment at step k, beyond the matrix.

        With it benefits are the general beta_hat(s, x) of Holder (2024), section 7.2. `assignments` has shape (..., n),
        and so has the answer. A part of the rule: plans are scored with it.
        """
        return np.zeros(np.shape(assignments))

    # What belongs to a problem

    def bind(self, benefits: Benefits) -> Self:
        """A copy that knows the benefits, for a rule that depends on them."""
        return self

    def validate(self, problem: Setting) -> None:  # noqa: B027  # nothing to check by default
        """Raise a ValueError if the parameters do not fit the problem."""

    @property
    def called(self) -> str:
        """The name of the user's class, for messages; with what it changes of a base that is therefore not believed."""
        return type(self).__name__

    def real_tasks(self, m: int) -> IntArray:
        """A number for each of m tasks, equal for copies of one: going from copy to copy is no real change of task."""
        return np.arange(m)

    # Said beyond the rule: one step

    def handover_at(self, k: int, state: Any, assignment: IntArray) -> FloatArray:
        """Handover and interaction of every agent under an assignment, shape ``(n,)``."""
        eta = np.asarray(self.handover(k, state)[np.arange(len(assignment)), assignment])
        return eta + self.interaction(k, state, assignment) if self.interacts else eta

    def interval(self, windows: WindowSums, start: int, stop: int, state: Any) -> Matrix:
        """Benefit of holding one assignment over ``start .. stop - 1``; the window sum plus the handover at `start`.

        A model may return it in sparse form, or count what happens inside the interval.
        """
        eta = checked_handover(self.handover(start, state), start, windows.n, windows.m)
        return windows.dense(start, stop) + eta

    def key(self, state: Any) -> Hashable:
        """What makes two states equal, so that equal ones are solved once; by default their contents."""
        return frozen(state)

    def agent_columns(self, state: Any) -> AgentColumns | None:
        """The state as one row for each agent, for `sapopt.Session`; None if it cannot be taken apart like this."""
        return None

    def of_columns(self, columns: AgentColumns) -> Any:
        """The state of these rows: those of `agent_columns`, in another order, some gone and some new.

        It is that before the first step of the benefits that the model knows.
        """
        raise ValueError(f"dynamics: {self!r} has no method of_columns(columns) to build its state from rows")

    def marginal(self, k: int, state: Any, activity: FloatArray) -> FloatArray:
        """Interaction (n, m) of every pair if the other agents serve task j with ``activity[i, j]`` together.

        The sum over the pairs of an assignment counts every interaction twice, as a linearisation must.
        """
        raise ValueError(
            f"dynamics: {self!r} has no method marginal(k, state, activity) that tells of its interaction"
        )

    def serves(self, k: int, state: Any, assignment: IntArray) -> np.ndarray:
        """Whether every agent counts as active on the task it holds at step k, shape ``(n,)``."""
        return np.ones(len(assignment), dtype=bool)

    # Said beyond the rule: the agents' paths

    @property
    def is_agent_local(self) -> bool:
        """Whether the state splits into one finite state per agent: there are longest paths of single agents."""
        kind = type(self)
        return (
            kind.path_oracle is not Model.path_oracle or kind.local_model is not Model.local_model
        ) and not self.interacts

    @property
    def has_places(self) -> bool:
        """Whether `path_oracle` tells of agents that share a state in groups.

        Its prices then have n more columns: what every agent's place in its group costs.
        """
        return False

    @property
    def takes_prices(self) -> bool:
        """Whether prices take the agents, or groups of them, apart into longest paths."""
        return self.is_agent_local or self.has_places

    def price_columns(self, n: int, m: int) -> int:
        """How many prices a step has: one for every task, and with groups of agents one for every agent's place."""
        return m + n if self.has_places else m

    def path_oracle(self, benefits: Benefits, state: Any) -> PathOracle | None:
        """The agents' longest priced paths over a window; None: a `local_model` tells them, or nothing does."""
        return None

    def window_oracle(self, benefits: Benefits, state: Any) -> PathOracle | None:
        """The same where the problem goes on and the state at the end has a value; for receding horizons, no proofs."""
        return None

    def local_model(self, benefits: Benefits, state: Any) -> LocalModel | None:
        """The agents' finite states in plain form."""
        return None

    # What kind of rule it is

    def switching(self) -> Switching | None:
        """The parameters of the plain switching rule if this is that very rule, else None."""
        return None

    def disturbed(self) -> Disturbed | None:
        """The pairs of tasks that disturb each other, if all interaction is such a pair's loss where both are served.

        A task is served where an agent of positive benefit holds it.
        """
        return None

    def by_rule(self) -> LocalRule | None:
        """The rule that all else is derived from, where agents have a state of their own and idle without benefit."""
        return None

    def entering(self) -> Entering | None:
        """The parameters of the rule if every task is one task and every agent one agent, else None."""
        return None

    def copies(self) -> SyntheticSwitching | None:
        """The rule of copies of agents if this is that very rule, else None."""
        return None

    def batteries(self) -> Batteries | None:
        """The agents' batteries, None if they have none."""
        return None

    def charge_of(self, state: Any) -> FloatArray | None:
        """Charge of every agent, shape ``(n,)``, at most `capacity`; None if there are no charges."""
        return None

    def features(self, state: Any) -> FloatArray | None:
        """What a learner may know of every agent's state beyond beta_hat, shape ``(n, F)``, each of a size about 1."""
        return None

    def plain(self, problem: Setting) -> Plain | None:
        """The rule once more for verifying; None: the three methods and `local_model` are plain enough."""
        return None


def checked_handover(eta: Any, k: int, n: int, m: int) -> FloatArray:
    """A handover matrix as a float array (n, m).

    Raises
    ------
    ValueError
        If it has another shape, or holds NaN or +inf.
    """
    matrix = real_array(eta, "dynamics.handover")
    if matrix.shape != (n, m):
        raise ValueError(f"dynamics.handover returned shape {matrix.shape} at step {k}, expected {(n, m)}")
    if np.isnan(matrix).any() or np.isposinf(matrix).any():
        raise ValueError(f"dynamics.handover returned NaN or +inf at step {k}")
    return matrix
