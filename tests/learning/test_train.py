"""Training REDA: it repeats, it goes on after a kill as if nothing had happened, and it learns."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sapopt import SAP, SwitchingCost, solve
from sapopt.domains.chance import Failures
from sapopt.domains.instances import instance
from sapopt.domains.power import WalkerShell, power_constellation
from sapopt.learning import REDA, Environment, ObservationSpec, ThesisObservation, TrainOptions, train
from sapopt.learning.learner import Learner
from sapopt.learning.replay import Replay, replayed
from sapopt.learning.train import Training
from sapopt.running.control import Run
from sapopt.solvers import AssignmentPolicy, myopic

OPTIONS = TrainOptions(
    episodes=6, gradient_steps=3, stretches=2, stretch=3, memory=4, hidden=(8, 8), evaluate_every=2, evaluations=1,
    checkpoint_every=1, spec=ObservationSpec(6, 4, 2, charge=False),
)  # fmt: skip
THESIS = TrainOptions.thesis(
    episodes=4, stretches=2, memory=3, target_every=10, hidden=(8, 8), evaluate_every=2, evaluations=1,
    checkpoint_every=1, spec=ThesisObservation(6, 4, 2, charge=False),
)  # fmt: skip
PER_TASK = TrainOptions.per_task_values(
    episodes=4, gradient_steps=3, stretch=3, memory=3, hidden=(8, 8), evaluate_every=2, evaluations=1,
    checkpoint_every=1, spec=ThesisObservation(6, 4, 2, charge=False),
)  # fmt: skip
GUIDE = AssignmentPolicy(myopic)


def problems(seed: int) -> SAP:
    """Small constellations with free idling."""
    return instance("constellation-toy", seed, idle_is_free=True, steps=8)


def on_batteries(seed: int) -> SAP:
    """Small constellations on batteries."""
    made = power_constellation(WalkerShell(4, 6, 58.0, 1200.0), tasks=30, steps=8, seed=seed)
    return made.problem()


def weights(training: Training) -> list[np.ndarray]:
    """All weights."""
    return [tensor.numpy() for tensor in training.network.state_dict().values()]


CHANCE = replace(OPTIONS, spec=ObservationSpec(6, 4, 2), chance=Failures(0.1))


@pytest.mark.parametrize(
    "options", [OPTIONS, THESIS, PER_TASK, CHANCE], ids=["default", "thesis", "per task", "chance"]
)
def test_seeds_repeat_and_a_kill_changes_nothing(options: TrainOptions, tmp_path: Path) -> None:
    """The same seed gives the same weights bit for bit, killed and resumed or not; another seed gives others."""
    made = on_batteries if options.chance else problems
    whole = train(made, GUIDE, options, tmp_path / "whole")
    for stop in (1, 3):
        folder = tmp_path / f"killed{stop}"
        part = train(made, GUIDE, options, folder, Run(callback=lambda p, stop=stop: p.done >= stop))
        assert part.episodes == stop
        resumed = train(made, GUIDE, options, folder)
        assert resumed.value == whole.value
        assert all(map(np.array_equal, weights(resumed), weights(whole)))
        logs = []
        for name in ("whole", folder.name):
            with (tmp_path / name / "log.csv").open() as file:
                logs.append(
                    [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]
                )
        assert logs[0] == logs[1]
        assert len(logs[0]) == options.episodes
    other = train(made, GUIDE, replace(options, seed=1), tmp_path / "other")
    assert not all(map(np.array_equal, weights(other), weights(whole)))


def test_other_options_are_refused(tmp_path: Path) -> None:
    """A folder of another run, or a damaged checkpoint, is not taken over."""
    train(problems, GUIDE, replace(OPTIONS, episodes=1), tmp_path)
    with pytest.raises(ValueError, match="discount"):
        train(problems, GUIDE, replace(OPTIONS, episodes=1, discount=0.5), tmp_path)
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ValueError, match="damaged checkpoint"):
        train(problems, GUIDE, replace(OPTIONS, episodes=1), tmp_path)


def test_memory_shows_what_was_seen() -> None:
    """Observations made again from the memory are those of the play."""
    problem = problems(0)
    plan = solve(problem, GUIDE).plan
    episode = replayed(0, problem, plan)
    env = Environment(problem)
    for k in range(problem.T):
        np.testing.assert_array_equal(env.observe(OPTIONS.spec)[0], episode.observe(k, OPTIONS.spec)[0])
        env.step(plan[k])
    assert episode.rewards.sum() == pytest.approx(problem.evaluate(plan).value, rel=1e-5)


def test_standardised_rewards() -> None:
    """Per agent: mean 0 and deviation 1; in common: one number for all."""
    replay = Replay(2, OPTIONS.spec)
    problem = problems(0)
    replay.add(replayed(0, problem, solve(problem, GUIDE).plan))
    rewards = replay.episodes[0].rewards
    mean, deviation = replay.reward_scale("agent")
    busy = rewards.std(axis=0) > 1e-3
    np.testing.assert_allclose(((rewards - mean) / deviation)[:, busy].std(axis=0), 1.0, atol=1e-3)
    mean, deviation = replay.reward_scale("common")
    assert not mean.any()
    assert len(set(deviation)) == 1


def test_targets_follow_the_assignment() -> None:
    """With the discount 0 the network learns the rewards themselves: the loss falls far below its start."""
    learner = Learner(problems, GUIDE, replace(OPTIONS, discount=0.0, gradient_steps=1, hidden=(32, 32)))
    learner.play_and_learn()
    scale = learner.replay.reward_scale("common")
    losses = [learner._learn(learner.replay.sample(2, 3, learner.rng), *scale) for _ in range(600)]
    assert np.mean(losses[-50:]) < 0.2 * np.mean(losses[:10])


def test_algorithm_4_learns_at_every_step() -> None:
    """One gradient step for each time step; the target network changes at whole multiples of `target_every` alone."""
    learner = Learner(problems, GUIDE, THESIS)
    start = [tensor.clone() for tensor in learner.target.parameters()]
    episode = learner._begun(0)
    learner.replay.add(episode)
    for step, _ in enumerate(learner._steps(episode, 1.0), start=1):
        learner._gradient_steps()
        assert learner.updates == episode.played == step
    assert all(map(torch.equal, start, learner.target.parameters()))
    row = learner.play_and_learn()
    assert row["gradient_steps"] == 2 * episode.problem.T
    assert not any(map(torch.equal, start, learner.target.parameters()))


def test_a_batch_holds_what_was_played() -> None:
    """While an episode is played its steps can be drawn, up to the last that was played, and no other."""
    replay = Replay(2, OPTIONS.spec)
    problem = problems(0)
    full = replayed(0, problem, solve(problem, GUIDE).plan)
    replay.add(full)
    part = replace(full, seed=1, states=full.states[:3], rewards=np.full_like(full.rewards, 7.0))
    replay.add(part)
    assert (full.played, part.played) == (problem.T, 2)
    batch = replay.sample(400, 1, np.random.default_rng(0))
    from_part = batch.rewards[:, 0, 0] == 7.0
    assert from_part.mean() == pytest.approx(2 / (problem.T + 2), abs=0.06)
    assert batch.going[from_part].all()
    assert not batch.going.all()


def test_perturbed_pairs() -> None:
    """The thesis' noise falls on every pair of agent and task: agents that list nothing are shuffled as well."""
    learner = Learner(problems, GUIDE, THESIS)
    n, m = 5, 9
    values, listed = np.ones((n, 7)), np.full((n, 6), -1)
    drawn = {tuple(learner._explored(values, listed, m, 1.0)) for _ in range(50)}
    assert len(drawn) > 40
    assert all(len(set(row)) == n for row in drawn)
    assert len({tuple(learner._explored(values, listed, m, 0.0)) for _ in range(3)}) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("episodes", 0), ("explore", 2.0), ("standardise", "twice"), ("noise", -1.0), ("target_every", -1),
        ("after", "never"), ("perturb", "agents"),
    ],
)  # fmt: skip
def test_bad_options_are_named(name: str, value: object) -> None:
    """An option out of range is refused by its name."""
    with pytest.raises(ValueError, match=name):
        TrainOptions(**{name: value})  # type: ignore[arg-type]


def test_generator_needs_the_right_state() -> None:
    """Weights trained with charges do not run on a problem without."""
    from sapopt.learning.network import new_network

    problem = SAP(np.ones((2, 2, 2)), SwitchingCost(0.1))
    with pytest.raises(ValueError, match="charges"):
        solve(problem, AssignmentPolicy(REDA(new_network(ObservationSpec(), 0))))
