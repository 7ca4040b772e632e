"""Problems in files and their fingerprints: what is written comes back, and what was changed is refused."""

from __future__ import annotations

import dataclasses
import itertools
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from strategies import FORMS, Instance, as_form, instances

from sapopt import SAP, Benefits, SwitchingCost, dynamics

CUBE = np.random.default_rng(0).random((4, 3, 5)).round(2)
PLAN = np.array([[0, 1, 2], [0, 1, 3], [4, 1, 3], [4, 2, 3]])
COST = np.ones((5, 5)) - np.eye(5)


def models(m: int) -> list[Any]:
    """An instance of every option of every dynamics that can be saved."""
    rng = np.random.default_rng(0)
    matrix = rng.random((m, m))
    np.fill_diagonal(matrix, 0.0)
    return [
        SwitchingCost(0.0),
        SwitchingCost(1 / 3),
        SwitchingCost(0.5, True),
        SwitchingCost(matrix),
        SwitchingCost(matrix, True),
        dynamics.Battery(0.0),
        dynamics.Battery(0.25, 0.5, 0.25, 2.0, pay_for="entries", initial_charge=1.5),
        dynamics.Interference([[0, 1]], 0.5),
        dynamics.Interference([[0, 1], [1, 2]], [0.5, 0.25], 0.75, True),
        dynamics.SyntheticSwitching(0.0),
        dynamics.SyntheticSwitching(
            0.5, 0.25, agent_of=[0, 1, 1], task_of=np.arange(m) // 2, idle_is_free=True, needs_sight=True
        ),
    ]


SHAPED_BY_A_DOMAIN = {
    dynamics.AtMostInARow, dynamics.Dictator, dynamics.Jobs, dynamics.RideHailing, dynamics.SlewCost,
    dynamics.UnitCommitment, dynamics.WaitingRides,
}  # fmt: skip
"""Models with data of a domain: `tests/domains/test_scenario.py` writes and reads them with their instances."""


def saved_fields(model: Any) -> list[str]:
    """Fields that a file must bring back."""
    return [f.name for f in dataclasses.fields(model) if f.name != "benefits"]


def test_every_dynamics_is_among_the_models() -> None:
    """The round trip below leaves no dynamics and no field at one value."""
    named = {getattr(dynamics, name) for name in dynamics.__all__}
    wanted = {kind for kind in named if dataclasses.is_dataclass(kind) and hasattr(kind, "handover")}
    wanted -= SHAPED_BY_A_DOMAIN | {dynamics.AgentLocal}  # the last one is the base of others
    assert wanted == {type(model) for model in models(3)}
    for kind in wanted:
        mine = [model for model in models(3) if type(model) is kind]
        for field in saved_fields(mine[0]):
            assert len({repr(getattr(model, field)) for model in mine}) > 1, f"{kind.__name__}.{field}"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("index", range(len(models(5))))
def test_round_trip(tmp_path: Path, index: int, form: str) -> None:
    """Every field of every dynamics, benefits of every form, labels and initial assignment come back equal."""
    values = CUBE * (CUBE > 0.5)
    values[0, 0, 0] = -np.inf
    model = models(5)[index]
    for initial, agents, tasks in ((None, None, None), ([4, 0, 2], ["é", "b", ""], list("vwxyz"))):
        problem = SAP(as_form(values, form), model, initial, agents=agents, tasks=tasks)
        problem.save(tmp_path / "p.npz")
        again = SAP.load(tmp_path / "p.npz")
        assert type(again.dynamics) is type(model)
        for name in saved_fields(model):
            np.testing.assert_array_equal(getattr(again.dynamics, name), getattr(model, name))
            assert type(getattr(again.dynamics, name)) is type(getattr(model, name))
        np.testing.assert_array_equal(again.benefits.dense(), values)
        assert again.benefits.is_sparse == problem.benefits.is_sparse
        assert (again.agents, again.tasks) == (problem.agents, problem.tasks)
        if initial is None:
            assert again.initial_assignment is None
        else:
            np.testing.assert_array_equal(again.initial_assignment, initial)
        assert again.fingerprint == problem.fingerprint
        assert again.evaluate(PLAN[:, [1, 0, 2]]).value == problem.evaluate(PLAN[:, [1, 0, 2]]).value
    assert [path.name for path in tmp_path.iterdir()] == ["p.npz"]


@given(instances(forbid=True))
def test_fingerprint_looks_at_values_only(instance: Instance) -> None:
    """All forms of one problem have one fingerprint."""
    prints = {instance.problem(form).fingerprint for form in FORMS}
    labelled = SAP(
        instance.benefits,
        SwitchingCost(instance.cost, instance.idle_is_free),
        instance.initial,
        agents=["a"] * instance.benefits.shape[1],
    )
    assert prints == {labelled.fingerprint}


def test_fingerprint_tells_problems_apart() -> None:
    """Everything that decides the value of a plan changes the fingerprint."""
    nudged = CUBE.copy()
    nudged[3, 2, 4] = np.nextafter(nudged[3, 2, 4], 1)
    cost = COST.copy()
    cost[0, 1] = 2.0
    variants = [
        SAP(CUBE, 0.5), SAP(CUBE, 0.25), SAP(nudged, 0.5), SAP(CUBE, SwitchingCost(0.5, True)),
        SAP(CUBE, SwitchingCost(COST)), SAP(CUBE, SwitchingCost(cost)), SAP(CUBE, SwitchingCost(cost.T)),
        SAP(CUBE, 0.5, [0, 1, 2]), SAP(CUBE, 0.5, [1, 0, 2]), SAP(CUBE[:3], 0.5), SAP(CUBE[:, :2], 0.5),
        SAP(CUBE[:, :, :4], 0.5), SAP(CUBE.transpose(0, 2, 1)[:, :3, :], 0.5),
        SAP.with_idle_tasks(CUBE, 0.5), SAP(CUBE[:, ::-1], 0.5), SAP(CUBE[::-1], 0.5),
    ]  # fmt: skip
    assert len({problem.fingerprint for problem in variants}) == len(variants)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A small saved problem, held sparse."""
    path = tmp_path / "p.npz"
    SAP(CUBE * (CUBE > 0.6), SwitchingCost(COST), [0, 1, 2], agents=list("abc")).save(path)
    return path


def rewrite(
    path: Path, header: dict[str, Any] | None = None, drop: tuple[str, ...] = (), **arrays: Any
) -> None:
    """Change the header or the arrays of a saved problem."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files if name not in drop}
    content |= arrays
    names = sorted(content.keys() - {"meta"})
    if "meta" in drop:
        np.savez(path, **content)
        return
    content["meta"] = np.array(
        json.dumps(json.loads(str(content["meta"])) | {"arrays": names} | (header or {}))
    )
    np.savez(path, **content)


CHANGES: dict[str, dict[str, Any]] = {
    "no header": {"drop": ("meta",)},
    "an array too few": {
        "header": {"arrays": ["data", "dynamics.cost", "indices", "indptr", "initial_assignment", "x"]}
    },
    "an array too many": {"header": {"arrays": ["data", "dynamics.cost", "indices", "indptr"]}},
    "no list of arrays": {"header": {"arrays": None}},
    "no indices": {"drop": ("indices",)},
    "no cost": {"drop": ("dynamics.cost",)},
    "dynamics unknown": {"header": {"dynamics": "Teleport"}},
    "dynamics is the protocol": {"header": {"dynamics": "Dynamics"}},
    "dynamics is a dunder": {"header": {"dynamics": "__name__"}},
    "dynamics is a list": {"header": {"dynamics": ["SwitchingCost"]}},
    "dynamics is missing": {"header": {"dynamics": None}},
    "option unknown": {"header": {"dynamics.color": 1}},
    "shape": {"header": {"shape": [4, 3]}},
    "shape is none": {"header": {"shape": None}},
    "shape of words": {"header": {"shape": ["a", "b", "c"]}},
    "shape too large": {"header": {"shape": [5, 3, 5]}},
    "labels": {"header": {"agents": ["a"]}},
    "labels are a number": {"header": {"agents": 7}},
    "format of later": {"header": {"format": "sapopt-problem-99"}},
    "a result": {"header": {"format": "sapopt-result-1"}},
    "cost": {"dynamics.cost": -COST},
    "cost of another size": {"dynamics.cost": np.zeros((2, 2))},
    "cost is text": {"dynamics.cost": np.array("much")},
    "initial assignment": {"initial_assignment": np.array([0, 0, 1])},
    "initial assignment of words": {"initial_assignment": np.array(["a", "b", "c"])},
    "offsets": {"indptr": np.array([0, 1])},
    "tasks out of range": {"indices": np.full(27, 5)},
    "NaN": {"data": np.full(27, np.nan)},
    "dense of one axis": {"dense": np.zeros(3)},
    "dense of words": {"dense": np.array([[["a"]]])},
}


@pytest.mark.parametrize("name", CHANGES)
def test_changed_files(saved: Path, name: str) -> None:
    """A file whose content is no problem is a ValueError, whatever was changed."""
    change = dict(CHANGES[name])
    rewrite(saved, change.pop("header", None), change.pop("drop", ()), **change)
    with pytest.raises(ValueError):
        SAP.load(saved)


def test_truncated_files(saved: Path) -> None:
    """A file cut anywhere is a ValueError that names it."""
    content = saved.read_bytes()
    for length in itertools.chain(range(0, len(content), 37), [len(content) - 1]):
        saved.write_bytes(content[:length])
        with pytest.raises(ValueError, match=r"p\.npz"):
            SAP.load(saved)


def test_flipped_bytes(saved: Path) -> None:
    """A changed byte anywhere is a ValueError, or does not matter."""
    content = saved.read_bytes()
    fingerprint = SAP.load(saved).fingerprint
    directory = content.index(b"PK\x01\x02")
    for place in itertools.chain(range(0, directory, 5), range(directory, len(content))):
        saved.write_bytes(content[:place] + bytes([content[place] ^ 0xFF]) + content[place + 1 :])
        try:
            again = SAP.load(saved)
        except ValueError:
            continue
        assert again.fingerprint == fingerprint


class Trap:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> Any:
        return open, (self.path, "w")


def test_pickles_are_never_loaded(saved: Path, tmp_path: Path) -> None:
    """Neither a pickle nor an object array inside an .npz is executed."""
    sprung = tmp_path / "sprung"
    trap = np.array([Trap(sprung)], dtype=object)
    pickled = tmp_path / "pickle.npz"
    pickled.write_bytes(pickle.dumps(Trap(sprung)))
    np.save(tmp_path / "array.npy", trap, allow_pickle=True)
    with np.load(saved) as file:
        content = {name: file[name] for name in file.files}
    for name in ("meta", "data", "extra"):
        np.savez(tmp_path / f"{name}.npz", **(content | {name: trap}))
    for file_name in ("pickle.npz", "array.npy", "meta.npz", "data.npz", "extra.npz"):
        with pytest.raises(ValueError, match=file_name):
            SAP.load(tmp_path / file_name)
    assert not sprung.exists()


def test_foreign_files(tmp_path: Path) -> None:
    """Files of another kind are a ValueError; a file that is not there is a FileNotFoundError."""
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "text.npz").write_text("hello")
    np.save(tmp_path / "array.npy", CUBE)
    np.savez(tmp_path / "arrays.npz", CUBE)
    np.savez(tmp_path / "number.npz", meta=np.array(3))
    np.savez(tmp_path / "list.npz", meta=np.array("[1]"))
    np.savez(tmp_path / "deep.npz", meta=np.array("[" * 200_000))
    np.savez(tmp_path / "bare.npz", meta=np.array('{"format": "sapopt-problem-1"}'))
    with zipfile.ZipFile(tmp_path / "zip.npz", "w") as file:
        file.writestr("meta", "not an array")
    (tmp_path / "folder.npz").mkdir()
    for path in tmp_path.iterdir():
        with pytest.raises(ValueError, match=path.name):
            SAP.load(path)
    with pytest.raises(FileNotFoundError):
        SAP.load(tmp_path / "nothing.npz")


def test_a_failed_save_leaves_the_old_file(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A save that fails half-way changes nothing and leaves no remains."""
    content = saved.read_bytes()

    def fail(file: Any, *_: Any, **__: Any) -> None:
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np.lib.format, "write_array", fail)
    with pytest.raises(OSError, match="disk full"):
        SAP(CUBE, 0.5).save(saved)
    assert saved.read_bytes() == content
    assert list(saved.parent.iterdir()) == [saved]


def test_save_keeps_the_name(tmp_path: Path) -> None:
    """The file has the given name, with or without a suffix, as text or as a path."""
    SAP(CUBE, 0.5).save(str(tmp_path / "problem"))
    assert SAP.load(str(tmp_path / "problem")).fingerprint == SAP(Benefits(CUBE), 0.5).fingerprint
