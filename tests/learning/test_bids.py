"""Bids as actions: always an assignment, repeatable, resumable; what agents learn to say depends on their pay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sapopt import SAP, solve
from sapopt.domains.instances import instance
from sapopt.learning import REDA
from sapopt.learning.bids import BidOptions, play_bids, train_bids
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.network import new_network
from sapopt.learning.observation import ThesisObservation
from sapopt.learning.resume import Standing
from sapopt.running.control import Run
from sapopt.solvers import AssignmentPolicy

TRUTH = np.array([[2.0, 0.0], [1.9, 1.0]])
"""Agent 1 would rather have task 0, which is worth more to all if agent 0 has it: 3.0 against 1.9."""
OPTIONS = BidOptions(
    episodes=160, gathered=8, learning_rate=1e-2, hidden=(8,), spec=GlobalSpec(1, 2, 2, 0), evaluations=1,
    checkpoint_every=8, evaluate_every=40,
)  # fmt: skip


class Still:
    """One state for ever, and no handovers."""

    def initial_state(self, problem: Any) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.zeros((2, 2))

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return 0


def problems(seed: int) -> SAP:
    return SAP(np.tile(TRUTH, (5, 1, 1)), Still())


def weights(network: Any) -> list[np.ndarray]:
    return [tensor.numpy() for tensor in network.state_dict().values()]


def test_runs_repeat_and_a_kill_changes_nothing(tmp_path: Path) -> None:
    """Stopped and resumed, a run ends with the same weights bit for bit; another seed ends with others."""
    options = replace(OPTIONS, episodes=36)  # the last improvement has fewer episodes
    whole = train_bids(problems, options, tmp_path / "whole")
    part = train_bids(problems, options, tmp_path / "part", Run(callback=lambda p: p.done >= 16))
    assert part.episodes == 16
    again = train_bids(problems, options, tmp_path / "part")
    assert (again.episodes, again.value) == (36, whole.value)
    assert all(map(np.array_equal, weights(again.last), weights(whole.last)))
    assert (tmp_path / "part/log.csv").read_text().count("\n") == 6
    other = train_bids(problems, replace(options, seed=1), tmp_path / "other")
    assert not all(map(np.array_equal, weights(other.last), weights(whole.last)))
    with pytest.raises(ValueError, match="spread"):
        train_bids(problems, replace(options, spread=0.5), tmp_path / "whole")


def test_a_checkpoint_never_knows_more_than_the_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whenever a checkpoint is written, the log on disk already has its last episode: a kill after it loses nothing."""
    seen: list[tuple[int, int]] = []
    save = Standing.save

    def watched(self: Standing, state: dict[str, Any]) -> None:
        last = (tmp_path / "log.csv").read_text().splitlines()[-1]
        seen.append((state["episode"], int(last.split(",")[0])))
        save(self, state)

    monkeypatch.setattr(Standing, "save", watched)
    train_bids(problems, replace(OPTIONS, episodes=24, checkpoint_every=8), tmp_path)
    assert [episode for episode, _ in seen] == [episode for _, episode in seen]
    assert len(seen) >= 3


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_what_agents_say_depends_on_their_pay(seed: int, tmp_path: Path) -> None:
    """Paid for what all earn together, agent 1 leaves task 0 to the other by its bids, and alpha of them earns 3 at
    every step, where the untrained bids earned 1.9; paid for itself it claims the task, whoever gets it."""
    bids = {}
    for reward in ("common", "own"):
        options = replace(OPTIONS, seed=seed, reward=reward)
        training = train_bids(problems, options, tmp_path / reward)
        played = play_bids(problems(0), training.last)
        bids[reward] = played.bids[0]
        if reward == "common":
            untrained = new_network(options.spec, seed, options.hidden)
            assert play_bids(problems(0), untrained).rewards.sum() == pytest.approx(9.5)
            assert played.rewards.sum() == pytest.approx(15.0)
    assert bids["common"][1, 0] < bids["common"][1, 1]
    assert bids["own"][1, 0] > bids["own"][1, 1]


def test_bids_are_played_like_values(tmp_path: Path) -> None:
    """On a constellation every draw is an assignment, and the network plays as a generator what it plays here."""
    problem = instance("constellation-toy", 1, idle_is_free=True, steps=6)
    actor = new_network(ThesisObservation(6, 4, 2, charge=False), 3, (8,))
    drawn = play_bids(problem, actor, 0.5, np.random.default_rng(0))  # the environment refuses anything else
    assert drawn.bids.shape == (6, problem.n, 7)
    plain = play_bids(problem, actor)
    assert plain.rewards.sum() == pytest.approx(solve(problem, AssignmentPolicy(REDA(actor))).value)
    assert plain.rewards.sum() != drawn.rewards.sum()


def test_bad_options() -> None:
    for changes in ({"episodes": 0}, {"spread": 0.0}, {"discount": 1.5}, {"reward": "mine"}):
        with pytest.raises(ValueError, match=next(iter(changes))):
            BidOptions(**changes)
