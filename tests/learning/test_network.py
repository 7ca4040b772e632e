"""Weights on disk: what is written comes back, and what is damaged or foreign is refused with the reason."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from safetensors.torch import load_file, save_file

from sapopt.learning import ObservationSpec, load_network, save_network
from sapopt.learning.network import new_network
from sapopt.learning.reda import REDA

SPEC = ObservationSpec(4, 3, 2, charge=False)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file of random weights."""
    path = tmp_path / "w.safetensors"
    save_network(new_network(SPEC, 3, (8, 8)), path, {"seed": 3})
    return path


def test_round_trip(path: Path) -> None:
    """Weights, sizes and notes come back as they were."""
    network, about = load_network(path)
    assert about == {"seed": 3}
    assert network.spec == SPEC
    seen = np.random.default_rng(0).random((5, SPEC.size), dtype=np.float32)
    np.testing.assert_array_equal(network.values(seen), new_network(SPEC, 3, (8, 8)).values(seen))


def test_seed_alone_decides() -> None:
    """New weights depend on the seed and leave torch's own generator alone."""
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    first = new_network(SPEC, 1)
    assert torch.equal(torch.rand(3), expected)
    assert torch.equal(first.layers[0].weight, new_network(SPEC, 1).layers[0].weight)
    assert not torch.equal(first.layers[0].weight, new_network(SPEC, 2).layers[0].weight)


def test_damage_is_refused(path: Path) -> None:
    """A file cut short, and one with a changed header."""
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="damaged"):
        load_network(path)
    path.write_bytes(whole.replace(b"sapopt-network-1", b"sapopt-network-9"))
    with pytest.raises(ValueError, match="sapopt-network-9"):
        load_network(path)


def test_pickle_is_never_loaded(path: Path, tmp_path: Path) -> None:
    """A pickle is refused and its code does not run."""
    trap = tmp_path / "trap"

    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path.touch, (str(trap),))

    path.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(ValueError, match="not a safetensors file"):
        REDA.load(path)
    assert not trap.exists()


def test_mismatch_is_refused(path: Path) -> None:
    """Weights of other sizes than the file names, weights that are no numbers, a damaged description."""
    tensors = load_file(path)
    from safetensors import safe_open

    with safe_open(str(path), framework="pt") as file:
        meta = file.metadata()
    save_file(tensors, str(path), metadata=meta | {"hidden": json.dumps([9, 8])})
    with pytest.raises(ValueError, match="do not fit"):
        load_network(path)
    save_file(tensors, str(path), metadata=meta | {"spec": json.dumps({"colour": 1})})
    with pytest.raises(ValueError, match="description"):
        load_network(path)
    for key in ("spec", "hidden", "outputs", "about"):
        for text in ("null", "[null]", "{", "[" * 10_000, "1e999", "nan", '{"kind": []}'):
            save_file(tensors, str(path), metadata=meta | {key: text})
            try:
                load_network(path)
            except ValueError as error:
                assert str(path) in str(error)  # noqa: PT017
    for key, text in (("hidden", "[1000000000, 1000000000]"), ("outputs", "-5"), ("hidden", "[]")):
        save_file(tensors, str(path), metadata=meta | {key: text})
        with pytest.raises(ValueError, match="do not fit"):  # and nothing of that size is built
            load_network(path)
    tensors["layers.0.bias"][0] = float("nan")
    save_file(tensors, str(path), metadata=meta)
    with pytest.raises(ValueError, match=r"layers\.0\.bias"):
        load_network(path)


def test_unknown_name() -> None:
    """A name that is neither built in nor a file."""
    with pytest.raises(FileNotFoundError, match="no built-in weights"):
        REDA.load("no-such-weights")


def test_outputs_must_be_choices(tmp_path: Path) -> None:
    """A critic is no REDA."""
    path = tmp_path / "critic.safetensors"
    save_network(new_network(SPEC, 0, outputs=1), path)
    with pytest.raises(ValueError, match="outputs"):
        REDA.load(path)
