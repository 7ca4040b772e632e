"""Proven upper bounds, and certificates that anyone can check.

A certificate holds a plan, which proves a lower bound of the optimal value, and task prices, which prove an upper one:
for any prices mu >= 0 on "at most one agent holds task j at step k",

    optimum <= sum_i (value of agent i's best path under the prices) + sum_kj mu[k, j].

`verify` computes both sides anew from the definitions (see `sapopt.proofs.plain`).
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from sapopt.data.files import read_npz, write_npz
from sapopt.data.types import FloatArray, IntArray
from sapopt.dynamics.registry import is_own
from sapopt.problem.sap import SAP
from sapopt.proofs.guarantees import Guarantee, guarantee
from sapopt.proofs.plain import check_local_model, plain_bound, plain_value

_FORMAT = "sapopt-certificate-1"
_SLACK = 1e-9  # relative; two machines may round a sum differently, no more


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
        Task prices mu >= 0 that prove it; None for a bound that needs none.
    method : str
        How it was proven.
    """

    value: float
    prices: FloatArray | None = field(default=None, repr=False)
    method: str = ""


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
        Task prices mu >= 0 that prove the bound.
    fingerprint : str
        `SAP.fingerprint` of the problem.
    guarantee : Guarantee
        What is promised a priori (theorem 3.5.1 and the refined ratio), and for which algorithms.
    solver : str
        Method that found the plan.
    """

    value: float
    bound: float
    plan: IntArray = field(repr=False)
    prices: FloatArray = field(repr=False)
    fingerprint: str
    guarantee: Guarantee = field(repr=False)
    solver: str = ""

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
        write_npz(path, meta, {"plan": self.plan, "prices": self.prices})

    @classmethod
    def load(cls, path: str | Path) -> Certificate:
        """Read a certificate, without checking what it claims (`verify` does).

        Raises
        ------
        CertificateError
            If the file is damaged, was changed, or holds something else.
        """
        try:
            meta, arrays = read_npz(path, _FORMAT)
            out = cls(
                float(meta["value"]), float(meta["bound"]), arrays["plan"], arrays["prices"],
                str(meta["fingerprint"]), Guarantee.from_dict(meta["guarantee"]), str(meta["solver"]),
            )  # fmt: skip
            digest = meta["digest"]
        except (KeyError, TypeError) as error:
            raise CertificateError(f"{path}: damaged certificate file ({error})") from None
        except ValueError as error:
            raise CertificateError(str(error)) from None
        if digest != out._digest():
            raise CertificateError(f"{path}: the file was changed after it was written")
        return out

    def _digest(self) -> str:
        digest = hashlib.sha256(
            repr((_FORMAT, self.value, self.bound, self.fingerprint, self.solver)).encode()
        )
        for array in (self.plan, self.prices):
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def prove(problem: SAP, plan: IntArray, prices: FloatArray, solver: str = "") -> Certificate:
    """Make the certificate of a plan and prices; both claims are computed from the definitions.

    Parameters
    ----------
    problem : SAP
    plan : ndarray of int, shape (T, n)
    prices : ndarray, shape (T, m)
        Finite, not negative.
    solver : str
        Method that found the plan.

    Raises
    ------
    CertificateError
        If the plan is not feasible, the prices prove nothing, or the dynamics is user-defined and has no
        ``fingerprint``.
    """
    try:
        value = plain_value(problem, plan)
        bound = plain_bound(problem, prices)
        if is_own(problem.dynamics):
            check_local_model(problem, np.asarray(plan))
        fingerprint = problem.fingerprint
    except ValueError as error:
        raise CertificateError(str(error)) from None
    plan = np.asarray(plan).astype(np.int64)
    mu = np.asarray(prices, dtype=np.float64)
    return Certificate(value, bound, plan, mu, fingerprint, guarantee(problem), solver)


def verify(certificate: Certificate | str | Path, problem: SAP) -> Certificate:
    """Check a certificate against a problem, from the definitions alone.

    Value and bound are computed anew by a plain implementation that shares no code with the solvers, with the rounding
    error of the bound on the safe side.

    Parameters
    ----------
    certificate : Certificate or path
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
    """
    claim = certificate if isinstance(certificate, Certificate) else Certificate.load(certificate)
    if claim.fingerprint != problem.fingerprint:
        raise CertificateError(
            "the certificate belongs to another problem: "
            f"its fingerprint is {claim.fingerprint[:12]}..., the problem's is {problem.fingerprint[:12]}..."
        )
    proven = prove(problem, claim.plan, claim.prices, claim.solver)
    slack = _SLACK * max(1.0, abs(proven.value), abs(proven.bound))
    # `not (a <= b)` so that a claim of NaN is refused as well.
    if not claim.value <= proven.value + slack:
        raise CertificateError(f"the plan is worth {proven.value!r}, not the claimed {claim.value!r}")
    if not claim.bound >= proven.bound - slack:
        raise CertificateError(
            f"the prices prove a bound of {proven.bound!r}, not the claimed {claim.bound!r}"
        )
    # A ratio that is not promised is stored as 0, so the comparison covers all cases.
    for name in ("ratio", "refined_ratio"):
        if not getattr(claim.guarantee, name) <= getattr(proven.guarantee, name) + _SLACK:
            raise CertificateError(
                f"the problem promises a {name} of {getattr(proven.guarantee, name)!r} only"
            )
    return replace(proven, solver=claim.solver)
