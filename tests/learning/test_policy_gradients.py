"""IPPO, COMA and what they learn from: a tiny problem is learned, runs repeat and resume, misfits are refused."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sapopt import SAP, SwitchingCost
from sapopt.learning.coma import COMAOptions, others_choices, train_coma
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.ippo import PPOOptions, advantages, train_ippo
from sapopt.learning.network import new_network
from sapopt.learning.observation import ObservationSpec
from sapopt.learning.sampling import masked_logits, sample_episode
from sapopt.learning.train import Training
from sapopt.running.control import Progress, Run

SPEC = ObservationSpec(2, 1, 1, charge=False)


def problems(seed: int) -> SAP:
    """Two agents, of which each has a task of its own, worth 2, and one that both see, worth 1.5 to one of them."""
    step = np.array([[2.0, 0.0, 1.5, 0.0], [0.0, 2.0, 1.5, 0.0]])
    return SAP(np.stack([step] * 4), SwitchingCost(0.1, idle_is_free=True), [0, 1])


PPO = PPOOptions(
    episodes=6, epochs=2, batch=8, learning_rate=3e-3, hidden=(8,), spec=SPEC, evaluate_every=2, evaluations=1,
    checkpoint_every=1,
)  # fmt: skip
COMA = COMAOptions(
    episodes=12, gathered=2, critic_steps=1, hidden=(8,), spec=SPEC, evaluate_every=4, checkpoint_every=2
)
TRAINERS: dict[str, tuple[Callable[..., Training], Any]] = {
    "ippo": (train_ippo, PPO),
    "coma": (train_coma, COMA),
}


def weights(training: Training) -> list[np.ndarray]:
    """All weights of the best network."""
    return [tensor.numpy() for tensor in training.network.state_dict().values()]


def log(folder: Path) -> list[dict[str, str]]:
    """The log without the clock."""
    with (folder / "log.csv").open() as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


@pytest.mark.parametrize("name", TRAINERS)
def test_runs_repeat_and_a_kill_changes_nothing(name: str, tmp_path: Path) -> None:
    """Stopped anywhere and resumed, a run ends with the same weights, value and log, bit for bit."""
    train, options = TRAINERS[name]
    whole = train(problems, options, tmp_path / "whole")
    assert whole.episodes == options.episodes
    for stop in (options.episodes // 3, 2 * options.episodes // 3):
        folder = tmp_path / f"stopped {stop}"

        def enough(progress: Progress, stop: int = stop) -> bool:
            return progress.done >= stop

        part = train(problems, options, folder, Run(callback=enough))
        assert part.episodes == stop
        resumed = train(problems, options, folder)
        assert (resumed.episodes, resumed.value) == (whole.episodes, whole.value)
        assert all(map(np.array_equal, weights(resumed), weights(whole)))
        assert log(folder) == log(tmp_path / "whole")
    again = train(problems, options, tmp_path / "whole")
    assert all(map(np.array_equal, weights(again), weights(whole)))
    other = train(problems, replace(options, seed=1), tmp_path / "other")
    assert not all(map(np.array_equal, weights(other), weights(whole)))


@pytest.mark.parametrize("name", TRAINERS)
def test_a_stop_before_the_first_episode(name: str, tmp_path: Path) -> None:
    """A run without time plays nothing and says so; the next one begins at the beginning."""
    train, options = TRAINERS[name]
    nothing = train(problems, options, tmp_path, Run(time_limit=0.0))
    assert nothing.episodes == 0
    assert train(problems, options, tmp_path).episodes == options.episodes


@pytest.mark.parametrize("name", TRAINERS)
def test_strange_checkpoints_are_refused(name: str, tmp_path: Path) -> None:
    """Other options, other shapes, damage and the file of the other method: one clear ValueError."""
    train, options = TRAINERS[name]
    short = replace(options, episodes=2)
    train(problems, short, tmp_path)
    with pytest.raises(ValueError, match="belongs to a run with another learning_rate"):
        train(problems, replace(short, learning_rate=1.0), tmp_path)
    with pytest.raises(ValueError, match="another hidden"):
        train(problems, replace(short, hidden=(9,)), tmp_path)
    train_other, options_other = TRAINERS["coma" if name == "ippo" else "ippo"]
    with pytest.raises(ValueError, match=r"belongs to a run with another .*method"):
        train_other(problems, options_other, tmp_path)
    path = tmp_path / "checkpoint.npz"
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(ValueError, match="damaged"):
        train(problems, short, tmp_path)


@pytest.mark.parametrize("name", TRAINERS)
def test_weights_that_do_not_fit(name: str, tmp_path: Path) -> None:
    """A file whose options agree and whose weights do not is refused by its shapes."""
    from sapopt.data.files import read_npz, write_npz

    train, options = TRAINERS[name]
    short = replace(options, episodes=2)
    train(problems, short, tmp_path)
    path = tmp_path / "checkpoint.npz"
    meta, arrays = read_npz(path, "sapopt-policy-checkpoint-1", {}, 2**20, prefix="")
    key = next(key for key in arrays if key.startswith("actor/") and arrays[key].ndim == 2)
    for bad in (arrays[key][:, :-1], np.full_like(arrays[key], np.nan)):
        write_npz(path, meta, arrays | {key: bad})
        with pytest.raises(ValueError, match=r"weights of actor .* do not fit this run"):
            train(problems, short, tmp_path)


@pytest.mark.parametrize(
    ("train", "options"),
    [
        (train_ippo, replace(PPO, episodes=40, epochs=4, batch=64, learning_rate=2e-2, evaluate_every=10)),
        (
            train_coma,
            replace(COMA, episodes=160, gathered=8, critic_steps=4, learning_rate=1e-2, evaluate_every=40),
        ),
    ],
    ids=["ippo", "coma"],
)
def test_a_tiny_problem_is_learned(train: Any, options: Any, tmp_path: Path) -> None:
    """Each agent learns to take the task that is worth 2 to it: 16 in four steps, and chance earns less than 12."""
    fresh = new_network(SPEC, options.seed, options.hidden)
    rng = np.random.default_rng(0)
    chance = np.mean([sample_episode(problems(0), fresh, rng, explore=1.0).rewards.sum() for _ in range(40)])
    assert chance < 12
    trained = train(problems, options, tmp_path)
    assert sample_episode(problems(0), trained.network, None).rewards.sum() == pytest.approx(16.0)


def test_samples_are_what_was_played() -> None:
    """Rewards, masks and tasks of a sampled episode are those of the environment; the likeliest choices are greedy."""
    actor = new_network(SPEC, 3, (8,))
    problem = problems(0)
    played = sample_episode(problem, actor, np.random.default_rng(5), explore=0.5)
    assert played.observations.shape == (4, 2, SPEC.size)
    assert played.mask.shape == (4, 2, SPEC.actions)
    assert np.take_along_axis(played.mask, played.choices[..., None], axis=2).all()
    for k in range(4):
        if len(set(played.plan[k])) == 2:
            whole = problem.evaluate(np.tile(played.plan[k], (4, 1)))
            assert whole.value <= 16.0
    best = sample_episode(problem, actor, None)
    values = actor.values(best.observations[0])
    assert np.array_equal(best.choices[0], np.where(best.mask[0], values, -np.inf).argmax(axis=1))
    same = sample_episode(problem, actor, np.random.default_rng(5), explore=0.5)
    assert np.array_equal(same.plan, played.plan)


def test_masked_logits() -> None:
    """Allowed choices share all the probability in the given proportions; others have none."""
    logs = masked_logits(torch.tensor([[1.0, 2.0, 3.0]]), np.array([[True, False, True]])).exp()
    assert logs[0, 1] == 0
    assert float(logs.sum()) == pytest.approx(1.0)
    assert float(logs[0, 2] / logs[0, 0]) == pytest.approx(np.exp(2.0), rel=1e-5)


def test_advantages_by_hand() -> None:
    """The recursion is the sum of discounted surprises; with trace 1 it is the return less the value."""
    rng = np.random.default_rng(0)
    rewards, values = rng.random((5, 2)), rng.random((5, 2))
    later = np.vstack([values[1:], np.zeros((1, 2))])
    surprise = rewards + 0.9 * later - values
    for trace in (0.0, 0.5, 1.0):
        want = [sum((0.9 * trace) ** (s - k) * surprise[s] for s in range(k, 5)) for k in range(5)]
        np.testing.assert_allclose(advantages(rewards, values, 0.9, trace), want)
    returns = [sum(0.9 ** (s - k) * rewards[s] for s in range(k, 5)) for k in range(5)]
    np.testing.assert_allclose(advantages(rewards, values, 0.9, 1.0), np.array(returns) - values)


def test_choices_of_the_others() -> None:
    """Each agent sees the others' choices one-hot, and nothing of its own."""
    shown = others_choices(np.array([[2, 0, 1]]), 3).reshape(3, 3, 3)
    for i in range(3):
        assert not shown[i, i].any()
        for j, choice in enumerate((2, 0, 1)):
            if j != i:
                assert shown[i, j].tolist() == [float(a == choice) for a in range(3)]


def test_observations_that_do_not_fit() -> None:
    """A network for another number of agents or tasks refuses the problem by name."""
    actor = new_network(GlobalSpec(3, 5, 5, 4), 0, (4,))
    with pytest.raises(ValueError, match="is for 5 agents, 5 tasks and 4 steps, not for 2, 4"):
        sample_episode(problems(0), actor, None)
    with pytest.raises(ValueError, match="charges"):
        sample_episode(problems(0), new_network(ObservationSpec(2, 1, 1), 0, (4,)), None)


@pytest.mark.parametrize(
    ("options", "changes", "message"),
    [
        (PPO, {"epochs": 0}, "epochs must be at least 1"),
        (PPO, {"checkpoint_every": 0}, "checkpoint_every must be at least 1"),
        (PPO, {"ratio": 1.5}, "ratio must lie between 0 and 1"),
        (COMA, {"gathered": 0}, "gathered must be at least 1"),
    ],
)
def test_bad_options_are_named(options: Any, changes: dict[str, Any], message: str) -> None:
    """An option out of range is refused by its name."""
    with pytest.raises(ValueError, match=message):
        replace(options, **changes)
