"""One function that values every task: the order of the list does not count, and files of it come back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from sapopt.learning import ObservationSpec, ThesisObservation, load_network, save_network
from sapopt.learning.network import Network, listing, new_network

SPEC = ThesisObservation(4, 3, 2)


def reordered(seen: np.ndarray, order: np.ndarray, spec: ThesisObservation) -> np.ndarray:
    """Observations (n, size) whose listed tasks come in another order."""
    M, N, L = spec.tasks, spec.neighbours, spec.steps
    n = len(seen)
    own, rivals, flags, charges = np.split(seen, np.cumsum([M * L, N * M * L, (1 + N) * M]), axis=1)
    return np.concatenate(
        [
            own.reshape(n, M, L)[:, order].reshape(n, -1),
            rivals.reshape(n, N, M, L)[:, :, order].reshape(n, -1),
            flags.reshape(n, 1 + N, M)[:, :, order].reshape(n, -1),
            charges,
        ],
        axis=1,
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.permutations(range(4)), st.booleans())
def test_the_place_in_the_list_does_not_count(seed: int, order: list[int], charge: bool) -> None:
    """If the listed tasks change places, so do their values, and that of any other task stays."""
    spec = ThesisObservation(4, 3, 2, charge=charge)
    network = new_network(spec, seed, (8, 6), per_task=True)
    seen = np.random.default_rng(seed).random((5, spec.size), dtype=np.float32)
    values = network.values(seen)
    assert values.shape == (5, spec.actions)
    np.testing.assert_allclose(
        network.values(reordered(seen, np.array(order), spec)), values[:, [*order, 4]], rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize("charge", [True, False])
def test_everything_seen_counts(charge: bool) -> None:
    """Each number of the observation changes some value: no block is left out."""
    spec = ThesisObservation(3, 2, 2, charge=charge)
    network = new_network(spec, 0, (64, 16), per_task=True)
    seen = torch.rand(20, spec.size, generator=torch.Generator().manual_seed(1), requires_grad=True)
    network(seen).pow(2).sum().backward()
    assert (seen.grad.abs().max(dim=0).values > 0).all()


def test_round_trip(tmp_path: Path) -> None:
    """Weights come back as they were, and the file says what kind of network they are of."""
    network = new_network(SPEC, 3, (8, 6, 4), per_task=True)
    save_network(network, tmp_path / "w.safetensors", {"seed": 3})
    loaded, about = load_network(tmp_path / "w.safetensors")
    assert (loaded.per_task, loaded.hidden, about) == (True, (8, 6, 4), {"seed": 3})
    seen = np.random.default_rng(0).random((5, SPEC.size), dtype=np.float32)
    np.testing.assert_array_equal(loaded.values(seen), network.values(seen))


def test_files_that_do_not_say_are_of_one_perceptron(tmp_path: Path) -> None:
    """A file without the word, as written before, is read as before; a wrong word or layers that do not fit are not."""
    path = tmp_path / "w.safetensors"
    save_network(new_network(SPEC, 3, (8, 6)), path)
    tensors = load_file(path)
    with safe_open(str(path), framework="pt") as file:
        meta = file.metadata()
    del meta["per_task"]
    save_file(tensors, str(path), metadata=meta)
    assert not load_network(path)[0].per_task
    for key, text in (("per_task", "true"), ("per_task", "7"), ("hidden", json.dumps([8] * 9))):
        save_file(tensors, str(path), metadata=meta | {key: text})
        with pytest.raises(ValueError, match=r"do not fit|damaged description"):
            load_network(path)


def test_what_it_is_not_for() -> None:
    """Another observation, other outputs and a single layer are refused."""
    with pytest.raises(ValueError, match="ThesisObservation"):
        new_network(ObservationSpec(), 0, per_task=True)
    with pytest.raises(ValueError, match="not 1"):
        Network(SPEC, (8, 6), outputs=1, per_task=True)
    with pytest.raises(ValueError, match="at least two"):
        Network(SPEC, (8,), per_task=True)


def test_longer_lists() -> None:
    """The same weights value a longer list, in which empty places change nothing; those of a perceptron do not."""
    short = new_network(SPEC, 0, (8, 6), per_task=True)
    M, N, L = SPEC.tasks, SPEC.neighbours, SPEC.steps
    rng = np.random.default_rng(0)
    own, rivals, flags = rng.random((5, M, L)), rng.random((5, N, M, L)), rng.random((5, 1 + N, M))
    own[:, -1], rivals[:, :, -1], flags[:, :, -1] = 0, 0, 0  # the short list has an empty place, too
    charges = rng.random((5, 1 + N))

    def seen(more: int) -> np.ndarray:
        blocks = [
            np.pad(own, ((0, 0), (0, more), (0, 0))),
            np.pad(rivals, ((0, 0), (0, 0), (0, more), (0, 0))),
            np.pad(flags, ((0, 0), (0, 0), (0, more))),
            charges,
        ]
        return np.concatenate([block.reshape(5, -1) for block in blocks], axis=1).astype(np.float32)

    values = listing(short, 6).values(seen(2))
    np.testing.assert_allclose(values[:, [0, 1, 2, 3, 6]], short.values(seen(0)), rtol=1e-5, atol=1e-6)
    with pytest.raises(ValueError, match="values per task"):
        listing(new_network(SPEC, 0), 6)
