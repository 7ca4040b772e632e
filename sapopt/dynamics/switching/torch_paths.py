"""The path recursions of `SwitchingCost` in torch, all agents at once: for the dual on a GPU.

The mathematics is that of `sapopt.dynamics.switching.hard` and `switching_paths_soft`: every agent has its own
nodes only for the tasks it ever sees (its *slots*, padded to a common number), and parks on all others by intervals
whose prices are shared. The time steps follow one after the other; within a step everything is one tensor over agents
and slots. The soft recursion works with logarithms, and its usage is the gradient by the prices, by automatic
differentiation. Results agree with the compiled kernels to rounding.

This is the one module outside `sapopt.learning` that needs torch, and it imports it when an oracle is made.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.base import Model
from sapopt.dynamics.paths import oracles as local
from sapopt.dynamics.paths.oracles import PathOracle
from sapopt.dynamics.switching.paths import StrictSwitching

_ROWS = 4096
"""Parked stretches whose task is looked for at a time, each a row over all tasks."""

KERNELS = "cpu"
"""The device that means the compiled kernels, without torch."""

TORCH_ON_CPU = "torch-cpu"
"""Torch on the processor: for tests, the kernels are faster."""


def path_oracle(model: Model, benefits: Any, state: Any, device: str = KERNELS) -> PathOracle:
    """The path oracle of a dynamics on a device.

    Parameters
    ----------
    model : Model
    benefits : Benefits or (T, n, m) float array
    state : object
        State before the window.
    device : str
        "cpu": the dynamics' own kernels; else a torch device such as "cuda" or "cuda:1", or "torch-cpu".

    Raises
    ------
    ValueError
        If the device is not there, or the dynamics has no recursion for it.
    ImportError
        Without torch.
    """
    if device == KERNELS:
        return local.path_oracle(model, benefits, state)
    rule = model.switching()
    if rule is None or rule.uniform_cost is None or rule.idle_is_free:
        raise ValueError(
            f"device {device!r}: only a SwitchingCost with one cost for every move has a torch recursion, "
            f"not {model!r}; leave device at 'cpu'"
        )
    return TorchSwitching(benefits, rule.uniform_cost, state, device)


def torch_device(name: str) -> Any:
    """The torch device of a name.

    Raises
    ------
    ValueError
        If there is no such device here.
    ImportError
        Without torch.
    """
    try:
        import torch
    except ImportError:
        raise ImportError(f"device {name!r} needs torch: pip install 'sapopt[learn]'") from None
    if not isinstance(name, str):
        raise ValueError(f"device must be a name such as 'cpu' or 'cuda', got {name!r}")
    try:
        device = torch.device("cpu" if name == TORCH_ON_CPU else name)
        torch.zeros(1, dtype=torch.float64, device=device)
    except (RuntimeError, AssertionError, TypeError, NotImplementedError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ValueError(f"device {name!r} is not available here ({reason}); use 'cpu'") from None
    return device


class TorchSwitching:
    """Longest and soft paths under one cost for every change of task; a `SoftPathOracle`.

    Parameters
    ----------
    benefits : Benefits or (T, n, m) float array
    cost : float
    state : (n,) int array or None
        Tasks held before the first step; None makes the first step free.
    device : str
        See `path_oracle`.

    Notes
    -----
    Memory: about ``n * slots`` numbers for the paths themselves and ``T * n * slots`` bytes to trace them back; the
    soft paths keep some ``5 * T * n * slots`` numbers for the gradient. Double precision throughout.
    """

    def __init__(self, benefits: Any, cost: float, state: Any, device: str) -> None:
        self.device = torch_device(device)
        import torch

        self._torch = torch
        own = self._own = StrictSwitching(benefits, cost, state)
        self.cost = own.cost
        T, n, m = own.shape
        counts = np.diff(own.slots.ptr)
        size = self._size = int(counts.max(initial=1))
        slots = np.zeros((n, size), dtype=np.int64)
        real = np.arange(size) < counts[:, None]
        slots[real] = own.slots.task
        self._slots = self._tensor(slots)
        self._padding = self._tensor(np.where(real, 0.0, -np.inf))
        starts_in = (slots == own.window.held[:, None]) & real & (own.window.held[:, None] >= 0)
        self._held = self._tensor(np.where(starts_in, 0.0, -np.inf))
        # Entering at the first step is free without a task before it.
        self._first_cost = self._tensor(np.where(starts_in.any(axis=1), self.cost, 0.0))
        step_ptr = own.window.indptr[np.arange(T + 1) * n]
        agent = np.repeat(np.arange(T * n) % n, np.diff(own.window.indptr))
        place = self._tensor(agent * size + own.slots.entry)
        data = self._tensor(own.window.data)
        self._entries = [(place[a:b], data[a:b]) for a, b in pairwise(step_ptr)]
        self._excluded = self._tensor(np.where(own.excluded, np.inf, 0.0))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(T, n, m) of the window."""
        return self._own.shape

    @property
    def scale(self) -> float:
        """Typical size of a benefit."""
        return self._own.scale

    @property
    def coldest(self) -> float:
        """Lowest temperature of `soft_paths`; the same as that of the kernels, so that both take the same steps."""
        return self._own.coldest

    def best_path(self, agent: int, prices: FloatArray) -> tuple[float, IntArray]:
        """Value and path (T,) of one agent; a single path is quickest on the processor."""
        return self._own.best_path(agent, prices)

    def best_paths(self, prices: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values (n,) and plan (T, n) of all agents under `prices` (T, m)."""
        torch = self._torch
        T, n, _ = self.shape
        p = self._tensor(self._own._prices(prices))
        table, table_task = self._parking_table(p) if self._own.park else (None, None)
        V, best = self._held, torch.zeros(n, dtype=torch.float64, device=self.device)
        entered = torch.empty((T, n), dtype=torch.float64, device=self.device)
        moved, choice = [], []
        for k in range(T):
            enter = best - (self._first_cost if k == 0 else self.cost)
            moved.append(enter[:, None] > V)
            V = torch.maximum(V, enter[:, None]) + self._net(p, k)
            best, arg = V.max(dim=1)
            if table is not None:
                entered[k] = enter
                parked, since = (entered[: k + 1] - table[: k + 1, k + 1, None]).max(dim=0)
                better = parked > best
                best = torch.where(better, parked, best)
                arg = torch.where(better, self._size + since, arg)
            choice.append(arg)
        plan = self._trace(p, table, table_task, moved, choice)
        return best.cpu().numpy(), plan.cpu().numpy()

    def soft_paths(self, prices: FloatArray, temperature: float) -> tuple[FloatArray, FloatArray]:
        """Soft values (n,) and expected usage (T, m) at `prices`, which must be finite."""
        torch = self._torch
        T, n, _ = self.shape
        p = self._tensor(self._own._prices(prices)).requires_grad_()
        eps = float(temperature)
        parking = self._soft_parking(p, eps) if self._own.park else None
        A = self._held / eps
        log_z = torch.zeros(n, dtype=torch.float64, device=self.device)
        entered: list[Any] = []
        for k in range(T):
            enter = log_z - (self._first_cost if k == 0 else self.cost) / eps
            A = torch.logaddexp(A, enter[:, None]) + self._net(p, k) / eps
            if parking is None:
                log_z = torch.logsumexp(A, dim=1)
                continue
            entered.append(enter)
            parked = torch.stack(entered) + parking[k]
            log_z = torch.logsumexp(torch.cat([A, parked.T], dim=1), dim=1)
        values = eps * log_z
        (slope,) = torch.autograd.grad(values.sum(), p)
        return values.detach().cpu().numpy(), -slope.cpu().numpy()

    def _tensor(self, array: Any) -> Any:
        return self._torch.as_tensor(np.ascontiguousarray(array), device=self.device)

    def _net(self, p: Any, k: int) -> Any:
        """Benefit less price of every slot at step k, shape (n, slots); -inf in the padding."""
        place, data = self._entries[k]
        benefit = self._padding.clone()
        benefit.view(-1).index_add_(0, place, data)
        return benefit - p[k][self._slots]

    def _parking_table(self, p: Any) -> tuple[Any, Any]:
        """P (T, T+1): least price of one task over the steps a..b-1, and the task (T, T+1)."""
        torch = self._torch
        T = len(p)
        table = torch.zeros((T, T + 1), dtype=torch.float64, device=self.device)
        task = torch.zeros((T, T + 1), dtype=torch.int64, device=self.device)
        for a in range(T):
            paid = torch.cumsum(p[a:], dim=0) + self._excluded
            table[a, a + 1 :], task[a, a + 1 :] = paid.min(dim=1)
        return table, task

    def _soft_parking(self, p: Any, eps: float) -> list[Any]:
        """For every step k the logarithms (k+1, 1) of the weights of parking since step a, up to and with k."""
        torch = self._torch
        T = len(p)
        since = [torch.logsumexp(-torch.cumsum(p[a:], dim=0) / eps - self._excluded, dim=1) for a in range(T)]
        return [torch.stack([since[a][k - a] for a in range(k + 1)])[:, None] for k in range(T)]

    def _trace(self, p: Any, table: Any, table_task: Any, moved: list[Any], choice: list[Any]) -> Any:
        """The plan (T, n), step by step backwards."""
        torch = self._torch
        T, n, m = self.shape
        plan = torch.empty((T, n), dtype=torch.int64, device=self.device)
        everyone = torch.arange(n, device=self.device)
        at = choice[T - 1]
        until = torch.full((n,), T, device=self.device)  # end of the stretch an agent is parked in
        stretches = []
        for k in range(T - 1, -1, -1):
            parked = at >= self._size
            slot = torch.where(parked, 0, at)
            plan[k] = torch.where(parked, -1, self._slots[everyone, slot])
            begins = parked & (at - self._size == k)
            if table is not None and bool(begins.any()):
                who = everyone[begins]
                stretches.append(torch.stack([who, torch.full_like(who, k), until[begins]]))
            leaves = torch.where(parked, begins, moved[k][everyone, slot])
            if k > 0:
                at = torch.where(leaves, choice[k - 1], at)
                until = torch.where(leaves, k, until)
        if stretches:
            agent, a, b = torch.cat(stretches, dim=1)
            task = self._parking_tasks(p, table, table_task, agent, a, b)
            for q in range(T):
                inside = (a <= q) & (q < b)
                plan[q, agent[inside]] = task[inside]
        return plan

    def _parking_tasks(self, p: Any, table: Any, table_task: Any, agent: Any, a: Any, b: Any) -> Any:
        """Tasks to park on: the cheapest, but free ones are spread over the agents, as in the kernels."""
        torch = self._torch
        m = p.shape[1]
        costly = torch.cumsum((p > 0.0).to(torch.int32), dim=0)
        costly = torch.cat([torch.zeros_like(costly[:1]), costly])
        out = table_task[a, b]
        (free,) = torch.nonzero(table[a, b] <= 0.0, as_tuple=True)
        tasks = torch.arange(m, device=self.device)
        for rows in free.split(_ROWS):
            is_open = (costly[b[rows]] == costly[a[rows]]) & (self._excluded == 0.0)
            distance = (tasks - (agent[rows, None] * 7919) % m) % m
            out[rows] = torch.where(is_open, distance, m).argmin(dim=1)
        return out
