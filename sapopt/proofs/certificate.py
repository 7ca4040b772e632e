"""Proven upper bounds, and certificates that anyone can check.

A certificate holds a plan, which proves a lower bound of the optimal value, and task prices, which prove an upper one:
for any prices mu >= 0 on "at most one agent holds task j at step k",

    optimum <= sum_i (value of agent i's best path under the prices) + sum_kj mu[k, j].

`verify` computes both sides anew from the definitions (see `sapopt.proofs.plain`): the value rounded down, the bound
rounded up. A claim must not go beyond that by a single bit; there is no slack.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from sapopt.data.files import Entry, read_npz, write_npz
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.registry import is_own
from sapopt.problem.sap import SAP
from sapopt.proofs.guarantees import guarantee
from sapopt.proofs.plain import check_local_model, handover_weight, plain_bound, plain_value
from sapopt.proofs.plain_guarantee import plain_guarantee
from sapopt.proofs.plain_limits import limited_bound, limited_value, limited_weight, price_count
from sapopt.proofs.promises import Guarantee

_FORMAT = "sapopt-certificate-1"
_ENTRIES = {
    "plan": Entry("iu", (None, None)),
    "prices": Entry("f", (None, None)),
    "limit_prices": Entry("f", (None,), optional=True),
    "team_prices": Entry("f", (None,), optional=True),
}
_MOST_BYTES = 512 * 2**20
"""Most bytes of plan and prices together in a file: 1000 steps of 30 000 agents and tasks."""
_SPARE = 8.0 * float(np.finfo(np.float64).eps)
"""Share of its handovers by which a fresh claim stays within what is proven, for rules of which other machines may
compute a handover differently in the last bits (an angle, say). Sums, differences and maxima are alike everywhere."""


class CertificateError(ValueError):
    """A certificate was changed, belongs to another problem, or claims more than it proves."""


@dataclass(frozen=True, eq=False)
class Bound:
    """A proven upper bound of the optimal value of a problem.

    Attributes
    ----------
    value : float
        No plan is worth more.
    prices : ndarray, shape (T, m), or None
        Task prices mu >= 0 that prove it; None for a bound that needs none. Where agents are copies of one another,
        n further columns hold what the place of every agent costs (docs/certificates.md).
    method : str
        How it was proven.
    limit_prices : ndarray, shape (rows,), or None
        Multipliers of the limits, one for each row of ``problem.rows``: positive for ``at_most``, negative for
        ``at_least``. What one unit more of the limit is worth at most, nearly. Where tasks disturb each other, T more
        for every pair.
    team_prices : ndarray, shape (teams,), or None
        What a team pays each of its helpers, for every team and step.
    """

    value: float
    prices: FloatArray | None = field(default=None, repr=False)
    method: str = ""
    limit_prices: FloatArray | None = field(default=None, repr=False)
    team_prices: FloatArray | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven about a plan.

    Attributes
    ----------
    value : float
        Value of the plan.
    bound : float
        No plan of this problem is worth more.
    plan : ndarray of int64, shape (T, n)
    prices : ndarray, shape (T, m)
        Task prices mu >= 0 that prove the bound; with copies of agents (T, m + n), see `Bound`.
    fingerprint : str
        `SAP.fingerprint` of the problem.
    guarantee : Guarantee
        What is promised a priori (theorem 3.5.1 and the refined ratio), and for which algorithms.
    solver : str
        Method that found the plan.
    limit_prices, team_prices : ndarray
        Multipliers of limits and teams; empty where the problem has none.
    """

    value: float
    bound: float
    plan: IntArray = field(repr=False)
    prices: FloatArray = field(repr=False)
    fingerprint: str
    guarantee: Guarantee = field(repr=False)
    solver: str = ""
    limit_prices: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    team_prices: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)

    @property
    def gap(self) -> float:
        """``(bound - value) / |bound|``: the plan is at most this share of the bound below the optimum."""
        if self.bound == 0:
            return 0.0 if self.value == 0 else float("inf")
        return (self.bound - self.value) / abs(self.bound)

    @property
    def c(self) -> float:
        """c of theorem 3.5.1: least benefit of an assignment over the most that handovers can cost in a step."""
        return self.guarantee.c

    @property
    def ratio(self) -> float:
        """c / (1 + c)."""
        return self.guarantee.ratio

    @property
    def theorem(self) -> str:
        """What is promised a priori, and for which algorithms."""
        return self.guarantee.statement

    def save(self, path: str | Path) -> None:
        """Write the certificate to an ``.npz`` file."""
        meta = {
            "format": _FORMAT, "value": self.value, "bound": self.bound, "fingerprint": self.fingerprint,
            "solver": self.solver, "guarantee": asdict(self.guarantee), "digest": self._digest(),
        }  # fmt: skip
        arrays = {"plan": self.plan, "prices": self.prices}
        arrays |= {name: array for name, array in self._more().items() if len(array)}
        write_npz(path, meta, arrays)

    def _more(self) -> dict[str, FloatArray]:
        return {"limit_prices": self.limit_prices, "team_prices": self.team_prices}

    @classmethod
    def load(cls, path: str | Path) -> Certificate:
        """Read a certificate, without checking what it claims (`verify` does).

        Raises
        ------
        CertificateError
            If the file is damaged, was changed, or holds something else.
        """
        return cls._read(path, _ENTRIES)

    @classmethod
    def _read(cls, path: str | Path, entries: dict[str, Entry]) -> Certificate:
        try:
            meta, arrays = read_npz(path, _FORMAT, entries, _MOST_BYTES)
            out = cls(
                _number(meta["value"], "value"), _number(meta["bound"], "bound"), arrays["plan"], arrays["prices"],
                str(meta["fingerprint"]), Guarantee.from_dict(meta["guarantee"]), str(meta["solver"]),
                arrays.get("limit_prices", np.zeros(0)), arrays.get("team_prices", np.zeros(0)),
            )  # fmt: skip
            digest = meta["digest"]
        except (KeyError, TypeError, AttributeError) as error:
            raise CertificateError(f"{path}: damaged certificate file ({error})") from None
        except ValueError as error:
            raise CertificateError(str(error)) from None
        if digest != out._digest():
            raise CertificateError(f"{path}: the file was changed after it was written")
        return out

    def _digest(self) -> str:
        promised = json.dumps(asdict(self.guarantee), sort_keys=True, default=float)
        said = (_FORMAT, float(self.value), float(self.bound), self.fingerprint, self.solver, promised)
        digest = hashlib.sha256(repr(said).encode("utf-8", "backslashreplace"))
        more = [array for array in self._more().values() if len(array)]
        for array in (self.plan, self.prices, *more):
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def prove(
    problem: SAP,
    plan: IntArray,
    prices: FloatArray,
    solver: str = "",
    limit_prices: FloatArray | None = None,
    team_prices: FloatArray | None = None,
) -> Certificate:
    """Make the certificate of a plan and prices; both claims are computed from the definitions.

    Parameters
    ----------
    problem : SAP
    plan : ndarray of int, shape (T, n)
    prices : ndarray, shape (T, m)
        Finite, not negative.
    solver : str
        Method that found the plan.
    limit_prices, team_prices : ndarray, optional
        Multipliers of limits and teams; zero by default.

    Raises
    ------
    CertificateError
        If the plan is not feasible, the prices prove nothing, or the dynamics is user-defined and has no
        ``fingerprint``.
    """
    count, teams = price_count(problem), len(problem.rows.team_cell)
    y = np.zeros(count) if limit_prices is None else limit_prices
    more = (y, np.zeros(teams) if team_prices is None else team_prices)
    proven = _proven(problem, plan, prices, solver, guarantee, more)
    spare = _SPARE * (
        handover_weight(problem, proven.plan, proven.prices) if _is_plain(problem)
        else limited_weight(problem, proven.plan)
    )  # fmt: skip
    return replace(
        proven,
        value=proven.value if spare == 0 else math.nextafter(proven.value - spare, -math.inf),
        bound=proven.bound if spare == 0 else math.nextafter(proven.bound + spare, math.inf),
    )


def _is_plain(problem: SAP) -> bool:
    """Whether task prices are all there is."""
    return problem.is_plain and problem.model.disturbed() is None


def _proven(
    problem: SAP,
    plan: IntArray,
    prices: FloatArray,
    solver: str,
    promise: Callable[[SAP], Guarantee],
    more: tuple[FloatArray, FloatArray],
) -> Certificate:
    """What plan, prices and the prices of limits and teams prove on this machine, and what `promise` promises."""
    try:
        if _is_plain(problem):
            value = plain_value(problem, plan)
            bound = plain_bound(problem, prices)
        else:
            value = limited_value(problem, plan)
            bound = limited_bound(problem, prices, *more)
        if is_own(problem.dynamics):
            check_local_model(problem.core, problem.placed(np.asarray(plan)))
        fingerprint = problem.fingerprint
        promised = promise(problem)
    except ValueError as error:
        raise CertificateError(str(error)) from None
    plan = np.asarray(plan).astype(np.int64)
    mu = np.asarray(prices, dtype=np.float64)
    return Certificate(
        value, bound, plan, mu, fingerprint, promised, solver,
        *(np.asarray(values, dtype=np.float64) for values in more),
    )  # fmt: skip


def verify(certificate: Certificate | str | Path, problem: SAP) -> Certificate:
    """Check a certificate against a problem, from the definitions alone.

    Value and bound are computed anew by a plain implementation that shares no code with the solvers, each rounded to
    the safe side, and the claims are compared with them bit by bit. The guarantee is computed anew by code that shares
    nothing with what made it.

    Parameters
    ----------
    certificate : Certificate or path
        Of a file, at most 512 MiB are unpacked, and nothing whose size does not fit the problem.
    problem : SAP
        The problem the certificate is said to be about.

    Returns
    -------
    Certificate
        With the recomputed value and bound, which are at least as good as the claimed ones.

    Raises
    ------
    CertificateError
        If the file is damaged or was changed, belongs to another problem, or claims more than it proves.
    FileNotFoundError
        If there is no such file.
    """
    if isinstance(certificate, Certificate):
        claim = certificate
    else:
        sizes: dict[str, tuple[int, ...]] = {
            "plan": (problem.T, problem.n), "prices": (problem.T, problem.model.price_columns(problem.n, problem.m)),
            "limit_prices": (price_count(problem),), "team_prices": (len(problem.rows.team_cell),),
        }  # fmt: skip
        claim = Certificate._read(
            certificate, {name: replace(entry, shape=sizes[name]) for name, entry in _ENTRIES.items()}
        )
    try:
        fingerprint = problem.fingerprint
    except ValueError as error:
        raise CertificateError(str(error)) from None
    if claim.fingerprint != fingerprint:
        raise CertificateError(
            "the certificate belongs to another problem: "
            f"its fingerprint is {str(claim.fingerprint)[:12]}..., the problem's is {fingerprint[:12]}..."
        )
    if not isinstance(claim.guarantee, Guarantee):
        raise CertificateError("the certificate holds no guarantee")
    value, bound = _number(claim.value, "value"), _number(claim.bound, "bound")
    more = (claim.limit_prices, claim.team_prices)
    proven = _proven(problem, claim.plan, claim.prices, claim.solver, plain_guarantee, more)
    if not value <= proven.value:
        raise CertificateError(f"the plan is worth {proven.value!r}, not the claimed {value!r}")
    if not bound >= proven.bound:
        raise CertificateError(f"the prices prove a bound of {proven.bound!r}, not the claimed {bound!r}")
    excess = claim.guarantee.excess(proven.guarantee)
    if excess:
        raise CertificateError(f"the problem promises a {excess} only")
    return proven


def _number(value: object, name: str) -> float:
    """A claimed number, which must be finite."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise CertificateError(f"the claimed {name} is no finite number")
