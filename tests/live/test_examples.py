"""The examples run as they stand."""

from __future__ import annotations

import asyncio
import importlib.util
from pathlib import Path
from typing import Any

import pytest

from sapopt import Session

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def module(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_asyncio_loop(capsys: pytest.CaptureFixture[str]) -> None:
    """Every forecast gets its decision, while the loop serves others."""
    example = module("asyncio_loop")
    turns = 0

    async def others() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0.001)
            turns += 1

    async def both() -> Any:
        serving = asyncio.create_task(others())
        found = await example.main()
        serving.cancel()
        return found

    decisions = asyncio.run(both())
    assert [decision.step for decision in decisions] == list(range(example.STEPS))
    assert turns > 0
    assert capsys.readouterr().out.count("sat") > example.STEPS


def test_service_goes_on_from_its_file(tmp_path: Path) -> None:
    """The service takes up the session of its file."""
    pytest.importorskip("fastapi")
    example = module("service")
    path = tmp_path / "session.npz"
    session = Session(example.DualLookahead(2), 0.1)
    session.step([[[1.0, 0.0]]], agents=["a"], tasks=["x", "y"])
    session.save(path)
    assert example.session_of(path).assignment == {"a": "x"}
