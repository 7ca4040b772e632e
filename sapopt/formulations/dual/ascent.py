"""Minimise the Lagrangian dual: `ascend(oracle) -> DualResult`.

Two stages. Where the oracle can soften its paths, the smooth descent does nearly all of the work; subgradient steps
follow until they change nothing. What other methods achieve is measured in `experiments/benchmarks/dual_ascent.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from sapopt.data.types import FloatArray
from sapopt.dynamics.paths.oracles import PathOracle, SoftPathOracle
from sapopt.formulations.dual.lagrangian import DualValue, dual_value
from sapopt.formulations.dual.smooth import SmoothDescent, SmoothState
from sapopt.formulations.dual.subgradient import Subgradient, SubgradientState
from sapopt.kernels import clock

_USUAL = 200
"""Smooth steps where nothing else is said."""

_MOST = 3 * _USUAL
"""Smooth steps with time to spare; so many are worth some 0.05 %."""

_SMOOTH_SHARE = 0.8
"""Share of the iterations allowed that may be smooth ones; subgradient steps follow them."""

_EVERY = 10
"""Smooth steps between two looks at the dual itself, and between two renewals of the cheaper oracle."""

_PAST = 0.85
"""Weight of the past in the running mean of a step's time: a mean over some seven steps follows the load of the machine
without being thrown by a single slow step."""

_DEAREST_RENEWAL = 10.0
"""Steps that a renewal counts for at most: what took longer was an accident that need not happen again."""

_PLANNED = 0.9
"""Share of the time left that steps are planned for; they get dearer and cheaper on the way."""

_COOLING_SHARE = 0.4
"""Share of the steps there is time for that the first plan of the cooling takes; the rest is for subgradient steps."""

_CHANGE = 0.15
"""Relative change of the number of steps left, below which the cooling goes on as it was planned."""

Callback = Callable[[int, float, FloatArray], bool | None]


@dataclass(frozen=True, eq=False)
class DualState:
    """Where an ascent stopped; `ascend(oracle, state=...)` goes on as if it had not."""

    smooth: SmoothState | None
    descent: SmoothDescent
    subgradient: SubgradientState | None


@dataclass(frozen=True, eq=False)
class DualResult:
    """Outcome of an ascent.

    Attributes
    ----------
    prices : (T, m) float array
        The best prices found, all >= 0.
    bound : float
        Proven upper bound of the problem's optimum at `prices`.
    iterations : int
        Evaluations of all agents' paths, soft or not.
    history : (records, 3) float array
        Seconds since the start, value of the dual, best bound so far.
    state : DualState
        To resume from.
    converged : bool
        Whether it ended because nothing changed any more (or the target was met), not at a limit.
    """

    prices: FloatArray
    bound: float
    iterations: int
    history: FloatArray = field(repr=False)
    state: DualState = field(repr=False)
    converged: bool


@dataclass
class _Watch:
    """The best prices so far, and the reasons to stop."""

    stop_at: float
    max_iterations: int
    target: float | None
    tolerance: float
    callback: Callback | None
    begin: float = field(default_factory=clock.now)
    prices: FloatArray | None = None
    bound: float = np.inf
    iterations: int = 0
    history: list[tuple[float, float, float]] = field(default_factory=list)
    met: bool = False

    def look(self, here: DualValue) -> None:
        """Take notice of an evaluation."""
        if self.prices is None or here.value < self.bound:
            bound = here.bound
            if self.prices is None or bound < self.bound:
                self.prices, self.bound = here.prices, bound
        self.history.append((clock.now() - self.begin, here.value, self.bound))
        if self.target is not None and self.bound - self.target <= self.tolerance * abs(self.target):
            self.met = True

    def stop(self) -> bool:
        """Whether to stop now; called once an iteration."""
        self.iterations += 1
        assert self.prices is not None
        asked = self.callback is not None and self.callback(self.iterations - 1, self.bound, self.prices)
        over = self.iterations >= self.max_iterations or clock.now() >= self.stop_at
        return bool(asked) or over or self.met


def ascend(
    oracle: PathOracle,
    prices: FloatArray | None = None,
    *,
    state: DualState | None = None,
    time_limit: float | None = None,
    max_iterations: int | None = None,
    target: float | None = None,
    tolerance: float = 1e-6,
    callback: Callback | None = None,
) -> DualResult:
    """Minimise D(mu) over mu >= 0. Nothing is drawn at random: without a time limit a run reproduces exactly.

    Parameters
    ----------
    oracle : PathOracle
        Gives every agent's longest path under prices; a `SoftPathOracle` makes it faster by far.
    prices : (T, m) float array, optional
        Prices to start from; the result is never worse than they are.
    state : DualState, optional
        State of an earlier result, to go on from exactly there (`prices` may add better ones).
    time_limit : float, optional
        Seconds. The temperature falls faster or slower as the time allows.
    max_iterations : int, optional
        Most evaluations of all agents' paths (default 2000).
    target : float, optional
        Value of the best plan known; the ascent stops when the bound meets it within the relative `tolerance`.
    callback : callable, optional
        Called as callback(iteration, bound, best prices); a true answer stops the ascent.

    Returns
    -------
    DualResult

    Raises
    ------
    ValueError
        If the prices are negative, not finite, or of a wrong shape.
    """
    T, n, m = oracle.shape
    begin = clock.now()
    stop_at = begin + (np.inf if time_limit is None else time_limit)
    watch = _Watch(
        stop_at, 2000 if max_iterations is None else max_iterations, target, tolerance, callback, begin
    )
    start = np.zeros((T, m)) if prices is None else np.asarray(prices, dtype=np.float64)
    if start.shape != (T, m) or not np.isfinite(start).all() or (start < 0.0).any():
        raise ValueError(f"prices: expected finite numbers >= 0 of shape {(T, m)}")
    first = dual_value(oracle, start)
    watch.look(first)
    soft = isinstance(oracle, SoftPathOracle)
    scale = oracle.scale if isinstance(oracle, SoftPathOracle) else _scale(first, n, T)
    options = Subgradient() if soft else Subgradient(length=0.5, shortest=1e-5)
    if state is None:
        descent = SmoothDescent(iterations=min(_USUAL, max(1, int(_SMOOTH_SHARE * watch.max_iterations))))
        if prices is not None:
            descent = replace(descent, hot=0.05, iterations=min(100, descent.iterations))
        smooth = descent.begin(start) if soft else None
        state = DualState(smooth, descent, None)
    if watch.stop():
        return _result(watch, state, converged=watch.met)
    if isinstance(oracle, SoftPathOracle) and state.smooth is not None:
        state = _descend(oracle, state, watch)
        if state.smooth is not None:
            return _result(watch, state, converged=watch.met)
    assert watch.prices is not None
    sub = state.subgradient or options.begin(watch.prices, scale)
    while not watch.met:
        sub, here = options.step(oracle, sub)
        watch.look(here)
        if watch.stop() or options.converged(sub, scale):
            break
    done = watch.met or options.converged(sub, scale)
    return _result(watch, DualState(None, state.descent, sub), converged=done)


def _descend(oracle: SoftPathOracle, state: DualState, watch: _Watch) -> DualState:
    """The smooth stage; `smooth` of the returned state is None if it came to its end."""
    smooth, descent = state.smooth, state.descent
    assert smooth is not None
    wanted = descent.iterations
    cheaper, was_wide = None, False
    began, pace, renewal = clock.now(), 0.0, 0.0
    while smooth.iteration < descent.iterations:
        wide = descent.is_wide(oracle, smooth.iteration)
        renewed = smooth.iteration % _EVERY == 0 or cheaper is None or wide != was_wide
        if renewed:
            cheaper, smooth = descent.cheaper(oracle, smooth)
            was_wide = wide
        smooth = descent.step(oracle, smooth, cheaper)
        now = clock.now()
        done, spent, began = smooth.iteration, now - began, now
        if renewed:  # took the time of making the oracle too
            pace, renewal = 0.0, spent if done > 1 else 0.0
        elif np.isfinite(watch.stop_at):
            pace = spent if pace == 0.0 else _PAST * pace + (1.0 - _PAST) * spent
            mean = (
                pace + (min(renewal, _DEAREST_RENEWAL * pace) - pace) / _EVERY
            )  # one step in so many is a renewal
            cost = mean * descent.mean_cost(oracle, done - 1)
            affordable = _PLANNED * (watch.stop_at - now) / max(cost, 1e-9)
            if done == 2 and wanted == _USUAL:
                most = min(_MOST, _SMOOTH_SHARE * watch.max_iterations)
                wanted = int(np.clip(_COOLING_SHARE * affordable, _USUAL, most))
            remaining = max(0, min(wanted - done, int(affordable)))
            if abs(done + remaining - descent.iterations) > _CHANGE * (descent.iterations - done):
                descent = descent.replanned(done, remaining)
                smooth = replace(smooth, rate=max(smooth.rate, descent.first_rate))
        last = smooth.iteration >= descent.iterations
        looked = smooth.iteration % _EVERY == 0 or last
        if looked:
            watch.look(dual_value(oracle, smooth.prices))
        if watch.stop():
            if not looked:
                watch.look(dual_value(oracle, smooth.prices))
            return DualState(None if last else smooth, descent, None)
    return DualState(None, descent, None)


def _scale(first: DualValue, n: int, T: int) -> float:
    """A typical benefit, as far as path values tell: the mean value of an agent and step."""
    return max(abs(first.value) / max(1, n * T), 5e-324)


def _result(watch: _Watch, state: DualState, *, converged: bool) -> DualResult:
    assert watch.prices is not None
    return DualResult(
        watch.prices, watch.bound, watch.iterations, np.array(watch.history).reshape(-1, 3), state, converged
    )
