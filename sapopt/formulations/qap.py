"""The sequential assignment problem as a Koopmans-Beckmann quadratic assignment problem (thesis, eq. 1.4).

Facilities are the nT pairs (step, agent), locations the mT pairs (step, task); a facility may only go to a location
of its own step, so every solution is block-diagonal:

    maximise  sum a[p, r] b[q, s] x[p, q] x[r, s]  +  sum c[p, q] x[p, q]

``a`` joins an agent to itself one step later, ``b`` holds the cost between tasks of successive steps, ``c`` the
benefits (with the handover of the first step) and -inf outside the blocks. Where idling is free, whether a move is
charged depends on the agent and not only on the tasks; such a task gets two locations, a charged and a free one,
and ``a`` and ``b`` punish using both.

A `sapopt.formulations.reduction.Formulation`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sapopt.data.files import write_text
from sapopt.data.textfile import lines_of, plain_number, read_text
from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.adams_johnson import adams_johnson
from sapopt.formulations.highs import Programme
from sapopt.problem.sap import SAP


@dataclass(frozen=True, eq=False)
class QAP:
    """``maximise sum a[p, r] b[q, s] x[p, q] x[r, s] + sum c[p, q] x[p, q]``, each facility at its own location.

    Attributes
    ----------
    a : ndarray, shape (facilities, facilities)
    b : ndarray, shape (locations, locations)
    c : ndarray, shape (facilities, locations)
        -inf where a facility may not go.
    shape : (T, n, m)
        Of the sequential problem; (1, facilities, locations) for a problem that came from a file.
    task : ndarray of int64, shape (locations,)
        Task of each location.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    shape: tuple[int, int, int]
    task: IntArray = field(repr=False)

    def value(self, locations: IntArray) -> float:
        """Objective of the assignment of facility p to ``locations[p]``."""
        p = np.arange(len(self.a))
        return float((self.a * self.b[np.ix_(locations, locations)]).sum() + self.c[p, locations].sum())

    def locations(self, plan: IntArray) -> IntArray:
        """Locations (facilities,) that stand for a plan (T, n)."""
        T, n, _ = self.shape
        out = np.empty(T * n, dtype=np.int64)
        for p, j in enumerate(np.asarray(plan).ravel()):
            out[p] = np.flatnonzero((self.task == j) & np.isfinite(self.c[p]))[0]
        return out

    def plan(self, locations: IntArray) -> IntArray:
        """The plan (T, n) that ``locations`` (facilities,) stand for."""
        T, n, _ = self.shape
        return self.task[np.asarray(locations)].reshape(T, n)

    def programme(self) -> Programme:
        """The linearisation of Adams and Johnson (1994), see `sapopt.formulations.adams_johnson`.

        Exact with the integrality of x. Without it, it is the strongest of the usual linear relaxations: on QAPLIB's
        nug5, nug7, chr12a and tai8a its value is the optimum (50, 148, 9552, 77502), on nug12 522.9 of 578.
        """
        return adams_johnson(self.a, self.b, self.c)

    def write_qaplib(self, path: str | Path) -> None:
        """Write the problem in QAPLIB's form: n, then A, B and (the linear extension) C, to be minimised.

        QAPLIB wants square matrices and finite numbers: facilities without weight fill up, and a forbidden place
        costs more than any plan can gain. Numbers are written so that they read back exactly.
        """
        size = len(self.b)
        short = size - len(self.a)
        finite = np.isfinite(self.c)
        swing = np.abs(self.c[finite]).sum() + np.abs(self.a).sum() * np.abs(self.b).max(initial=0.0)
        c = np.zeros((size, size))
        c[: len(self.a)] = np.where(finite, -self.c, 4.0 * swing if swing > 0 else 1.0)
        matrices = (np.pad(self.a, (0, short)), -self.b + 0.0, c + 0.0)
        lines = [str(size)]
        for matrix in matrices:
            lines += ["", *(" ".join(f"{v:.17g}" for v in row) for row in matrix)]
        write_text(path, "\n".join(lines) + "\n")


def read_qaplib(path: str | Path) -> QAP:
    """Read a QAPLIB file (n, A, B and optionally C, to be minimised) as a `QAP` to be maximised.

    Parameters
    ----------
    path : str or Path
        The header is ``n`` or ``n value``, as some collections have it; the value (of the best known solution) is not
        kept. The sign is turned: ``-read_qaplib(path).value(locations)`` is the cost.

    Raises
    ------
    ValueError
        If the file does not hold n and two or three n x n matrices of finite numbers; the message names the path.
    """
    lines = list(_number_lines(path))
    header = next((numbers for numbers in lines if numbers), [])
    numbers = np.array([number for line in lines for number in line][1:])
    if not header or not header[0].is_integer() or header[0] < 1:
        raise ValueError(f"{path}: not a QAPLIB file (it must begin with n, a whole number of at least 1)")
    size = int(header[0])
    if len(header) == 2 and len(numbers) - 1 in (2 * size**2, 3 * size**2):
        numbers = numbers[1:]
    if len(numbers) not in (2 * size**2, 3 * size**2):
        raise ValueError(
            f"{path}: not a QAPLIB file ({len(numbers)} numbers after n = {size}, expected {2 * size**2} or "
            f"{3 * size**2})"
        )
    a, b, *c = numbers.reshape(-1, size, size)
    linear = -c[0] + 0.0 if c else np.zeros((size, size))
    return QAP(a, -b + 0.0, linear, (1, size, size), np.arange(size))


def read_qaplib_solution(path: str | Path) -> tuple[float, IntArray]:
    """Read a QAPLIB solution (``.sln``: n, the cost, and a permutation of 1..n).

    Returns
    -------
    cost : float
        To be minimised, as the file states it.
    locations : ndarray of int64, shape (n,)
        Location of each facility, from 0. Some files of QAPLIB state the inverse permutation (the facility at each
        location), and nothing in them tells which.

    Raises
    ------
    ValueError
        If the file is something else; the message names the path.
    """
    numbers = [number for line in _number_lines(path) for number in line]
    size = int(numbers[0]) if numbers and numbers[0].is_integer() else 0
    if size < 1 or len(numbers) != size + 2 or sorted(numbers[2:]) != list(range(1, size + 1)):
        raise ValueError(f"{path}: not a QAPLIB solution (n, the cost, and a permutation of 1..n)")
    return numbers[1], np.array(numbers[2:], dtype=np.int64) - 1


def read_assignment(path: str | Path) -> FloatArray:
    """Read an assignment problem as the OR-Library has it (``assign100.txt``): n, then the cost of every pair.

    Returns
    -------
    ndarray, shape (n, n)
        To be minimised: ``SAP(-read_assignment(path)[None])`` is the problem, of one step.

    Raises
    ------
    ValueError
        If the file does not hold n and n x n numbers; the message names the path.
    """
    numbers = [number for line in _number_lines(path) for number in line]
    size = int(numbers[0]) if numbers and numbers[0].is_integer() else 0
    if size < 1 or len(numbers) != size**2 + 1 or not np.isfinite(numbers).all():
        raise ValueError(f"{path}: not an assignment problem (n, then n x n finite costs)")
    return np.array(numbers[1:]).reshape(size, size)


def _number_lines(path: str | Path) -> Iterator[list[float]]:
    """The numbers of each line; some files have commas between them."""
    for line, text in enumerate(lines_of(read_text(path)), start=1):
        try:
            yield [plain_number(word) for word in text.replace(",", " ").split()]
        except ValueError as error:
            raise ValueError(f"{path}, line {line}: not a QAPLIB file ({error})") from None


def refusal(problem: SAP) -> str | None:
    """None, or the reason why the problem has no Koopmans-Beckmann form."""
    if problem.model.switching() is not None:
        return None
    return (
        f"{problem.model.called} charges more than the move from one task to the next; "
        "only SwitchingCost fits eq. 1.4"
    )


def formulate(problem: SAP) -> QAP:
    """The problem as a `QAP`.

    Raises
    ------
    ValueError
        If the dynamics is not a `SwitchingCost`.
    """
    reason = refusal(problem)
    if reason:
        raise ValueError(f"dynamics: {reason}")
    T, n, m = problem.benefits.shape
    benefits = problem.benefits.dense()
    rule = problem.model.switching()
    assert rule is not None
    first = problem.handover(0, problem.initial_state())
    cost = np.asarray(rule.cost, dtype=np.float64)
    if cost.ndim == 0:
        cost = cost * (1.0 - np.eye(m))

    positive: np.ndarray = benefits > 0
    charge = np.asarray(positive.any(axis=1)) if rule.idle_is_free else np.ones((T, m), dtype=bool)
    free = np.asarray(~positive.all(axis=1)) if rule.idle_is_free else np.zeros((T, m), dtype=bool)
    charge[0], free[0] = True, False  # the first step's handover is in c
    place = [(k, j, True) for k in range(T) for j in range(m) if charge[k, j]]
    place += [(k, j, False) for k in range(T) for j in range(m) if free[k, j]]
    place.sort(key=lambda spot: (spot[0], spot[1], not spot[2]))
    step, task = np.array([p[0] for p in place]), np.array([p[1] for p in place])
    paid = np.array([p[2] for p in place])

    a = np.zeros((T * n, T * n))
    later = np.arange(n, T * n)
    a[later - n, later] = 1.0
    successive = step[:, None] + 1 == step[None, :]
    b = np.where(successive & paid[None, :], -cost[np.ix_(task, task)], 0.0) + 0.0
    c = np.full((T * n, len(place)), -np.inf)
    for p in range(T * n):
        k, i = divmod(p, n)
        here = (step == k) & (~(free[k] & charge[k])[task] | (paid == positive[k, i, task]))
        c[p, here] = benefits[k, i, task[here]] + (first[i, task[here]] if k == 0 else 0.0)
    double = (step[:, None] == step) & (task[:, None] == task) & (paid[:, None] != paid)
    if double.any():
        finite = np.isfinite(c)
        swing = np.ptp(np.where(finite, c, 0.0), axis=1).sum() + T * n * cost.max(initial=0.0)
        # Twice what it could ever gain, in the size of the benefits; met twice, once in each order.
        b[double] = -swing if swing > 0 else -1.0
        same_step = np.arange(T * n)[:, None] // n == np.arange(T * n)[None, :] // n
        a[same_step & ~np.eye(T * n, dtype=bool)] = 1.0
    return QAP(a, b, c, (T, n, m), task)


def recover(qap: QAP, x: FloatArray) -> IntArray:
    """Plan (T, n) of an integral point of ``qap.programme()``."""
    return qap.plan(locations_of(qap, x))


def locations_of(qap: QAP, x: FloatArray) -> IntArray:
    """Locations (facilities,) of an integral point of ``qap.programme()``."""
    p, q = np.nonzero(np.isfinite(qap.c))
    chosen = x[: len(p)] > 0.5
    out = np.zeros(len(qap.a), dtype=np.int64)
    out[p[chosen]] = q[chosen]
    return out
