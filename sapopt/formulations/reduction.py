"""What the modules of this package have in common: a problem is written as a programme, and a point read as a plan.

`milp`, `network`, `qap` and `stays` are formulations of the whole problem, each a module with the three functions of
`Formulation`; whoever takes any of them takes the module: ``forms: dict[str, Formulation[Any]] = {"qap": qap}``.
(`intervals` writes one step of Algorithm 2; `robust` and `relaxation` have questions of their own.)
"""

from __future__ import annotations

from typing import Protocol, TypeVar

from sapopt.data.types import FloatArray, IntArray
from sapopt.formulations.highs import Programme
from sapopt.problem.sap import SAP


class Form(Protocol):
    """A problem, formulated."""

    def programme(self) -> Programme:
        """The mixed-integer programme whose best point is a best plan."""


F = TypeVar("F", bound=Form)


class Formulation(Protocol[F]):
    """A way to write a problem as a mixed-integer programme."""

    def refusal(self, problem: SAP) -> str | None:
        """None, or the reason why the problem cannot be written so."""

    def formulate(self, problem: SAP) -> F:
        """The problem in this form; a ValueError if it is not accepted."""

    def recover(self, form: F, x: FloatArray) -> IntArray:
        """The plan (T, n) that an integral point of ``form.programme()`` stands for."""
