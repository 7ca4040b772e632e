"""Power stations against a demand that rises and falls: unit commitment as a sequential assignment problem (7.1.3).

How demand becomes tasks. The demand of a step is cut into blocks, one after the other; each block is a task, namely
to put out just that much power. Its value is the energy at a price, the cost of the fuel taken off. A unit takes
one block, spins without a load, or is off; a block goes to one unit or is not served. So every step is an assignment of
n units to B blocks, n places to spin (one for each unit) and n to be off: n <= m = B + 2 n. The sizes of the blocks are
the discrete levels of output; where the demand ends inside a block, only that part of it is on offer.

What the model leaves out: ramps (how fast a running unit may change its output), reserve, the grid, and outputs between
the blocks. A plan that serves all of the demand here may shed some of it in a plant with ramps; `PowerSystem.dispatch`
tells how much, for the units that a plan has running.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.domains.scenario import refuse_idle_rule

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sapopt.domains.dispatch import Dispatch
    from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class PowerSystem:
    """Units and the demand they meet.

    Attributes
    ----------
    least_mw, most_mw : ndarray, shape (n,)
        Least and greatest output of a unit that runs.
    fuel_per_mwh, running_per_h : ndarray, shape (n,)
        Cost of a megawatt hour, and of every hour that the unit runs, whatever it puts out.
    start_up : ndarray, shape (n,)
        Cost of a start.
    minimum_up, minimum_down, initial : ndarray of int64, shape (n,)
        In steps; `initial` is positive for a unit that has been on, negative for one that has been off.
    demand_mw : ndarray, shape (T,)
    block_mw : ndarray, shape (B,)
        Sizes of the blocks into which the demand is cut, in this order.
    price_per_mwh : float
        Value of a megawatt hour that is served.
    step_h : float
        Hours of a step.
    shut_down : float or ndarray, shape (n,)
        Cost of a stop.
    """

    least_mw: FloatArray
    most_mw: FloatArray
    fuel_per_mwh: FloatArray
    running_per_h: FloatArray
    start_up: FloatArray
    minimum_up: IntArray
    minimum_down: IntArray
    initial: IntArray
    demand_mw: FloatArray
    block_mw: FloatArray
    price_per_mwh: float
    step_h: float = 1.0
    shut_down: FloatArray | float = 0.0

    def __post_init__(self) -> None:
        n = len(self.least_mw)
        if np.ndim(self.shut_down) == 0:
            object.__setattr__(self, "shut_down", np.full(n, self.shut_down, dtype=np.float64))
        for name in (
            "least_mw", "most_mw", "fuel_per_mwh", "running_per_h", "start_up", "shut_down", "minimum_up",
            "minimum_down", "initial",
        ):  # fmt: skip
            values = np.asarray(getattr(self, name))
            if values.shape != (n,):
                raise ValueError(
                    f"{name} must have one entry for each of {n} units, got shape {values.shape}"
                )
            object.__setattr__(self, name, values)
        for name in ("demand_mw", "block_mw"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or (values < 0).any():
                raise ValueError(f"{name} must be a list of finite numbers, not negative")
            object.__setattr__(self, name, values)
        if not ((self.least_mw >= 0) & (self.most_mw >= self.least_mw)).all():
            raise ValueError("least_mw must not be negative and not exceed most_mw")
        if not (np.isfinite(self.step_h) and self.step_h > 0):
            raise ValueError(f"step_h must be a positive number of hours, got {self.step_h!r}")
        # As cut, and as the demand fills them: one that the demand never reaches is no mistake in the cutting.
        sizes = np.append(self.blocks_mw, self.block_mw)
        smallest = sizes[sizes > 0].min(initial=np.inf)
        small = np.flatnonzero(np.asarray(self.most_mw) < smallest)
        if len(small) and np.isfinite(smallest):
            raise ValueError(
                f"block_mw: units {', '.join(map(str, small[:5]))} ({len(small)} in all) put out less than the "
                f"smallest block, {smallest:g} MW, and could never serve; add blocks of at most "
                f"{np.min(self.most_mw):g} MW"
            )

    @property
    def blocks_mw(self) -> FloatArray:
        """Size of every block at every step, shape (T, B): what of the demand falls into it, perhaps nothing."""
        below = np.cumsum(self.block_mw) - self.block_mw
        return np.clip(self.demand_mw[:, None] - below, 0.0, self.block_mw)

    @property
    def spinning(self) -> FloatArray:
        """Cost of a step of every unit that runs at its least output without serving anything, shape (n,)."""
        return self.step_h * (self.fuel_per_mwh * self.least_mw + self.running_per_h)

    def gains(self) -> FloatArray:
        """What each unit gains from each block at each step, shape (T, n, B); 0 where it cannot take it.

        A unit can take a block that is not larger than its greatest output. If the block is smaller than its least
        output, it burns the fuel of that nevertheless.
        """
        size = self.blocks_mw[:, None, :]
        output = np.maximum(size, self.least_mw[:, None])
        cost = self.fuel_per_mwh[:, None] * output + self.running_per_h[:, None]
        gain = self.step_h * (self.price_per_mwh * size - cost)
        return np.where((size > 0) & (size <= self.most_mw[:, None]), gain, 0.0)

    def problem(self, cost: Any = 1.0, *, idle_is_free: bool | None = None) -> SAP:
        """The sequential assignment problem: B blocks, then a place to spin and a place to be off for every unit.

        Parameters
        ----------
        cost : float
            Factor on the start-up and shut-down costs.
        idle_is_free : bool, optional
            Refused: what a unit pays is its start, its stop and the power it makes.
        """
        import scipy.sparse as sp

        from sapopt.dynamics import UnitCommitment
        from sapopt.problem.sap import SAP

        refuse_idle_rule(idle_is_free, "a unit pays for its start, its stop and the power it makes")
        if np.ndim(cost) or not (np.isfinite(cost) and cost >= 0):
            raise ValueError(
                f"cost is a factor on the start-up and shut-down costs, one finite number, got {cost!r}"
            )
        n, B = len(self.least_mw), len(self.block_mw)
        rule = UnitCommitment(
            float(cost) * np.asarray(self.start_up, dtype=np.float64), self.minimum_up, self.minimum_down,
            self.spinning, self.initial, float(cost) * np.asarray(self.shut_down, dtype=np.float64),
        )  # fmt: skip
        benefits = np.zeros((len(self.demand_mw), n, B + 2 * n))
        benefits[:, :, :B] = self.gains()
        benefits[:, np.arange(n), B + np.arange(n)] = -self.spinning
        labels = [f"block {b}: {size:g} MW" for b, size in enumerate(self.block_mw)]
        labels += [f"{what} {i}" for what in ("spin", "off") for i in range(n)]
        steps = [sp.csr_array(step) for step in benefits]
        return SAP(steps, rule, agents=[f"unit {i}" for i in range(n)], tasks=labels)

    def output_mw(self, plan: IntArray, cost: float = 1.0) -> FloatArray:
        """What of the demand every unit serves at every step of a plan, shape (T, n); no ramps, no reserve."""
        problem = self.problem(cost)
        plan = problem.check_plan(plan)
        B = len(self.block_mw)
        sizes = np.pad(self.blocks_mw, ((0, 0), (0, problem.m - B)))
        served = np.take_along_axis(sizes, plan, axis=1) * (problem.benefits.at(plan) != 0)
        state = problem.initial_state()
        for k, row in enumerate(plan):
            state = problem.transition(k, state, row)
            served[k] *= state.local > 0
        return served

    def running(self, plan: IntArray, cost: float = 1.0) -> np.ndarray:
        """Whether each unit runs at each step of a plan, shape (T, n)."""
        problem = self.problem(cost)
        state, on = problem.initial_state(), []
        for k, row in enumerate(problem.check_plan(plan)):
            state = problem.transition(k, state, row)
            on.append(state.local > 0)
        return np.array(on)

    def dispatch(self, plan: IntArray, *, ramp_mw: Any = None, reserve_mw: Any = None) -> Dispatch:
        """What the running units of a plan can serve at best, with what the model leaves out.

        The plan decides which units run; their outputs are free between least and greatest, not only at the blocks.

        Parameters
        ----------
        plan : ndarray of int64, shape (T, n)
        ramp_mw : float or array_like, shape (n,), optional
            Most that a unit changes from one step to the next while it runs; a start or a stop may use the least output
            in addition. No limit if omitted.
        reserve_mw : float or array_like, shape (T,), optional
            What running units must be able to add at once.

        Raises
        ------
        ValueError
            If a limit is negative or has a wrong shape.
        """
        from sapopt.domains.dispatch import dispatch

        return dispatch(self, self.running(plan), ramp_mw, reserve_mw)

    def draw(self, plan: IntArray, ax: Axes | None = None) -> Axes:
        """Draw the output of the units, stacked from the cheapest fuel to the dearest, against the demand."""
        from sapopt.plotting.style import PALETTE, axes_or_new, despine

        ax = axes_or_new(ax, (8.0, 3.8))
        served = self.output_mw(plan)
        order = np.argsort(self.fuel_per_mwh, kind="stable")
        hours = np.arange(len(served) + 1) * self.step_h
        groups = np.array_split(order, min(3, len(order)))
        below = np.zeros(len(served) + 1)
        for number, group in enumerate(groups):
            above = below + np.append(served[:, group].sum(axis=1), served[-1, group].sum())
            low, high = self.fuel_per_mwh[group].min(), self.fuel_per_mwh[group].max()
            label = f"{len(group)} units, fuel {low:.0f} to {high:.0f} per MWh"
            ax.fill_between(
                hours, below, above, step="post", color=PALETTE[number], alpha=0.75, lw=0, label=label
            )
            below = above
        ax.step(
            hours,
            np.append(self.demand_mw, self.demand_mw[-1]),
            where="post",
            color="#222222",
            lw=1.5,
            label="demand",
        )
        ax.set_xlim(0, hours[-1])
        ax.set_ylim(bottom=0)
        ax.set_xlabel("hour")
        ax.set_ylabel("MW")
        ax.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0, 1.01), ncols=2)
        despine(ax)
        return ax


def random_power_system(
    units: int = 40, steps: int = 48, seed: int = 0, *, shut_down: float = 0.0
) -> PowerSystem:
    """A made-up system: a quarter of slow and cheap units, half of middling ones, a quarter of quick and dear ones.

    The demand has a peak in the morning and a higher one in the evening, and at most nine tenths of what all units can
    put out together. It is cut into one block for every unit, the large ones first, which are always wanted.

    Parameters
    ----------
    units, steps : int
        n and T; a step is one hour.
    seed : int
    shut_down : float
        Cost of stopping a unit as a share of that of starting it.

    Raises
    ------
    ValueError
        If a number is too small.
    """
    if not (np.isfinite(shut_down) and shut_down >= 0):
        raise ValueError(f"shut_down must be a finite share, not negative, got {shut_down!r}")
    for name, value in (("units", units), ("steps", steps)):
        if int(value) != value or value < 1:
            raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
    rng = np.random.default_rng(seed)
    kind = np.minimum(np.arange(units) * 4 // units, 3)
    kind = np.array([0, 1, 1, 2])[kind]
    around = rng.uniform(0.9, 1.1, (3, units))
    most = np.array([400.0, 150.0, 50.0])[kind]
    demand = _daily_demand(steps, rng) * 0.9 * most.sum()
    blocks = np.concatenate([most[kind == 0], rng.permutation(most[kind > 0])])
    up = np.array([8, 4, 1])[kind]
    down = np.array([8, 3, 1])[kind]
    on = kind == 0
    start_up = (np.array([9000.0, 1800.0, 120.0])[kind] * around[2]).round(2)
    return PowerSystem(
        least_mw=np.array([200.0, 50.0, 10.0])[kind],
        most_mw=most,
        fuel_per_mwh=(np.array([18.0, 32.0, 55.0])[kind] * around[0]).round(2),
        running_per_h=(np.array([900.0, 400.0, 60.0])[kind] * around[1]).round(2),
        start_up=start_up,
        minimum_up=up,
        minimum_down=down,
        initial=np.where(on, up, -down),
        demand_mw=demand.round(1),
        block_mw=blocks,
        price_per_mwh=80.0,
        shut_down=shut_down * start_up,
    )


def _daily_demand(steps: int, rng: np.random.Generator) -> FloatArray:
    """Share of the highest demand at every hour, at most 1."""
    hour = np.arange(steps) % 24
    morning = 0.25 * np.exp(-0.5 * ((hour - 9.0) / 2.0) ** 2)
    evening = 0.4 * np.exp(-0.5 * ((hour - 19.0) / 2.5) ** 2)
    return np.clip(0.55 + morning + evening + rng.normal(0.0, 0.02, steps), 0.0, 1.0)
