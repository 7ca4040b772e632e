"""What a state model must offer, and what it may."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from sapopt.data.benefits import Benefits
from sapopt.data.types import FloatArray, IntArray


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


@runtime_checkable
class Dynamics(Protocol):
    """State model of a sequential assignment problem: any class with these three methods.

    The state can be any object; `transition` returns a new one and never changes the old one.

    A model may say more, and gains by it:

    - ``interval(windows, start, stop, state)``: the benefit matrix of holding one assignment over the steps
      ``start .. stop - 1`` in sparse form (see `sapopt.data.windows.WindowSums`); without it the dense sum of benefits
      plus ``handover(start, state)`` is used.
    - ``handover_at(k, state, assignment)``: only the entries of an assignment, shape ``(n,)``.
    - ``handover_limit``: the largest entry the handover matrix can have (0.0 for costs); without it, or a
      ``path_oracle``, nothing can be proven about the optimum.
    - ``key(state)``: a hashable fingerprint, so that equal states are solved once.
    - ``fingerprint()``: a text, or a list of texts, numbers and arrays, with everything that decides its values (a
      version of its code among them), so that a certificate can tell the problem from any other.
    - ``bind(benefits)``: a copy that knows the benefits, for a handover that depends on them.
    - ``interaction(k, assignments)``: terms of a step that depend on the whole assignment and that no matrix can hold
      (`sapopt.dynamics.joint.interference.Interacting`); ``handover_at`` must then contain them.
    - ``path_oracle(benefits, state)``: the agents' longest priced paths (`sapopt.dynamics.paths.oracles.PathOracle`) of
      an agent-local model; gives bounds and dual solvers.
    - ``window_oracle(benefits, state)``: the same for a window after which the problem goes on, where the state at the
      end has a value; for receding horizons.
    """

    def initial_state(self, problem: Setting) -> Any:
        """State before the first step; ``problem.initial_assignment`` may be None."""

    def handover(self, k: int, state: Any) -> FloatArray:
        """Handover matrix eta(s_k), shape ``(n, m)``, added to the benefits of step k (0-based)."""

    def transition(self, k: int, state: Any, assignment: IntArray) -> Any:
        """State after `assignment` (task of every agent, shape ``(n,)``) was held at step k."""
