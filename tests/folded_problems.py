"""Problems whose limits fold into a plain one."""

from __future__ import annotations

from sapopt import SAP
from sapopt.formulations.limited.folded import Folded, folded


def plain(problem: SAP) -> Folded:
    """The problem folded."""
    found = folded(problem.core)
    assert found is not None
    return found
