"""The page on the architecture: its picture and the list of layers in CONTRIBUTING say what the code does."""

from __future__ import annotations

import ast
import importlib.util
import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import sapopt
from sapopt import SAP, SwitchingCost, bound, certify, solve, verify
from sapopt.solvers import HAAL

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(sapopt.__file__).resolve().parent


def tool() -> Any:
    """The script that draws, as a module."""
    spec = importlib.util.spec_from_file_location("architecture", ROOT / "tools" / "architecture.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


ARCHITECTURE = tool()


def guarded_layers() -> Any:
    """`LAYERS` of the test that guards the imports."""
    tree = ast.parse((ROOT / "tests" / "test_package.py").read_text(encoding="utf-8"))
    (value,) = (
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and any(getattr(t, "id", "") == "LAYERS" for t in node.targets)
    )
    return ast.literal_eval(value)


def folders_run(call: Callable[[], object]) -> set[str]:
    """The folders of sapopt whose functions run in a call; what modules do while they are imported is left out."""
    seen = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        path = Path(code.co_filename)
        if event == "call" and code.co_flags & inspect.CO_OPTIMIZED and path.is_relative_to(PACKAGE):
            seen.add(path.relative_to(PACKAGE).with_suffix("").parts[0])

    earlier = sys.getprofile()
    sys.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(earlier)
    return seen - {"__init__"}


def test_layers_agree() -> None:
    """The picture shows the layers that the imports obey."""
    assert guarded_layers() == ARCHITECTURE.LAYERS
    assert {name for names in ARCHITECTURE.LAYERS for name in names} == set(ARCHITECTURE.ABOUT)


def test_contributing_agrees() -> None:
    """CONTRIBUTING lists the same layers in the same order."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    (listed,) = re.findall(r"`cli` →.*?`kernels`", text, flags=re.DOTALL)
    layers = tuple(tuple(re.findall(r"`(\w+)`", part)) for part in listed.split("→"))
    assert layers == ARCHITECTURE.LAYERS


def test_picture_is_up_to_date() -> None:
    """The picture in the documentation is what the script draws."""
    assert ARCHITECTURE.TARGET.read_text(encoding="utf-8") == ARCHITECTURE.drawing()


@pytest.mark.parametrize("name", ARCHITECTURE.JOURNEYS)
def test_journeys(name: str) -> None:
    """A call runs the code of the folders that the picture names, and of no others.

    A profile sees neither compiled code nor the reading of attributes, so these two folders may be used without it.
    """
    problem = SAP(np.random.default_rng(0).random((8, 6, 9)), SwitchingCost(0.3))
    result = solve(problem, HAAL(4))
    prices = bound(problem, time_limit=5).prices
    certificate = certify(problem, result, prices=prices)
    calls: dict[str, Callable[[], object]] = {
        "solve": lambda: solve(problem, HAAL(4)),
        "bound": lambda: bound(problem, time_limit=5),
        "certify": lambda: certify(problem, result, prices=prices),
        "verify": lambda: verify(certificate, problem),
    }
    run, named = folders_run(calls[name]), set(ARCHITECTURE.JOURNEYS[name])
    assert run <= named
    assert named - run <= {"kernels", "problem"}
