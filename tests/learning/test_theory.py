"""The theory behind REDA on random small problems: values split into the agents' own (Theorem 5.2.1 of Holder 2024),
and the update towards the assigned next value converges in a table (Lemma 5.4.1)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from sapopt import SAP
from sapopt.learning import TrainOptions
from sapopt.learning.global_observation import GlobalSpec
from sapopt.learning.learner import Learner, traced
from sapopt.solvers import AssignmentPolicy, myopic


@dataclass(frozen=True)
class SmallMDP:
    """A discounted problem with one state for all agents, as plain tables."""

    rewards: np.ndarray  # (S, n, m): beta_hat
    follows: np.ndarray  # (S, X): probability-free next state of every assignment
    rows: list[tuple[int, ...]]  # the X assignments
    discount: float = 0.9

    @property
    def own(self) -> np.ndarray:
        """Reward (S, X, n) of every agent."""
        n = self.rewards.shape[1]
        return np.stack([self.rewards[:, np.arange(n), row] for row in self.rows], axis=1)

    def optimal_policy(self) -> np.ndarray:
        """Best assignment (S,) by value iteration on the total."""
        values = np.zeros(len(self.follows))
        for _ in range(600):
            q = self.own.sum(axis=2) + self.discount * values[self.follows]
            values = q.max(axis=1)
        return np.asarray(q.argmax(axis=1))

    def agents_values(self, policy: np.ndarray) -> np.ndarray:
        """Q^i (S, X, n) when `policy` is followed after the first step: one linear system for each agent."""
        S = len(self.follows)
        states = np.arange(S)
        step = np.zeros((S, S))
        step[states, self.follows[states, policy]] = 1.0
        state_values = np.linalg.solve(np.eye(S) - self.discount * step, self.own[states, policy])
        return self.own + self.discount * state_values[self.follows]


def random_mdp(seed: int) -> SmallMDP:
    """Four states, two agents, three tasks."""
    rng = np.random.default_rng(seed)
    rows = list(itertools.permutations(range(3), 2))
    return SmallMDP(rng.normal(size=(4, 2, 3)), rng.integers(4, size=(4, len(rows))), rows)


@pytest.mark.parametrize("seed", range(20))
def test_values_split_into_the_agents_own(seed: int) -> None:
    """Under any policy the agents' own values add up to the total's; under the best one, their sum finds it again."""
    mdp = random_mdp(seed)
    states = np.arange(4)
    best = mdp.optimal_policy()
    for policy in (best, np.random.default_rng(seed).integers(len(mdp.rows), size=4)):
        total = np.zeros(4)
        for _ in range(600):
            total = (mdp.own.sum(axis=2) + mdp.discount * total[mdp.follows])[states, policy]
        whole = mdp.own.sum(axis=2) + mdp.discount * total[mdp.follows]
        np.testing.assert_allclose(mdp.agents_values(policy).sum(axis=2), whole, atol=1e-9)
    np.testing.assert_array_equal(mdp.agents_values(best).sum(axis=2).argmax(axis=1), best)


def test_own_values_do_not_follow_from_own_maxima() -> None:
    """The split is of the joint policy's value: agents that maximise for themselves do not find it."""
    gaps = []
    for seed in range(20):
        mdp = random_mdp(seed)
        best = mdp.optimal_policy()
        alone = np.zeros((4, 2))
        for _ in range(600):
            alone = (mdp.own + mdp.discount * alone[mdp.follows]).max(axis=1)
        gaps.append((alone.sum(axis=1) - mdp.agents_values(best).sum(axis=2).max(axis=1)).max())
    assert max(gaps) > 0.1
    assert min(gaps) > -1e-9


@pytest.mark.parametrize("seed", range(5))
def test_updates_converge_in_a_table(seed: int) -> None:
    """Beyond the lemma, with joint tables and alpha of the present values: the learner's one-step targets, each agent's
    own, converge to the values of the best policy."""
    mdp = random_mdp(seed)
    rng = np.random.default_rng(seed)
    wanted = mdp.agents_values(mdp.optimal_policy())
    table = rng.normal(size=wanted.shape)
    for _ in range(700):
        state, x = rng.integers(4, size=16), rng.integers(len(mdp.rows), size=16)
        following = mdp.follows[state, x]
        assigned = table[following].sum(axis=2).argmax(axis=1)  # alpha of the present values, by enumeration
        goal = traced(
            torch.from_numpy(mdp.own[state, x][:, None]),
            torch.from_numpy(table[following, assigned][:, None]),
            mdp.discount,
            0.0,
        )[:, 0].numpy()
        for s, a, target in zip(state, x, goal, strict=True):
            table[s, a] += 0.7 * (target - table[s, a])
    np.testing.assert_allclose(table, wanted, atol=1e-3)


def test_the_split_holds_for_the_policys_own_assignment_alone() -> None:
    """(5.1) by the thesis' own definition, whose next state is that of the policy whatever agent i is assigned: the
    sum over the agents is the joint value for x = pi(s), and in general for no other x."""
    wrong = 0
    for seed in range(10):
        mdp = random_mdp(seed)
        states = np.arange(4)
        policy = np.random.default_rng(seed).integers(len(mdp.rows), size=4)
        real = mdp.agents_values(policy)
        later = (real - mdp.own)[states, policy]  # (S, n): what follows pi(s), for every agent
        defined = (mdp.own + later[:, None]).sum(axis=2)
        joint = real.sum(axis=2)
        np.testing.assert_allclose(defined[states, policy], joint[states, policy], atol=1e-9)
        wrong += int((np.abs(defined - joint) > 1e-6).sum())
    assert wrong > 50


def target_update(mdp: SmallMDP, values: np.ndarray, policy: np.ndarray, agent: int) -> np.ndarray:
    """F of Lemma 5.4.1 for one agent's table (states, tasks): R_i(s, j) + gamma Q_i(s', x'^i) with s' after pi(s) and
    x' = pi(s'). Agents see the state."""
    states = np.arange(4)
    following = mdp.follows[states, policy]
    tasks = np.array([mdp.rows[policy[s]][agent] for s in following])
    return mdp.rewards[:, agent] + mdp.discount * values[following, tasks][:, None]


@pytest.mark.parametrize("seed", range(10))
def test_lemma_5_4_1_for_a_constant_policy(seed: int) -> None:
    """F contracts by gamma, and from any start leads to the agent's own values under the policy, by definition."""
    mdp, rng = random_mdp(seed), np.random.default_rng(seed)
    policy = rng.integers(len(mdp.rows), size=4)
    states = np.arange(4)
    later = (mdp.agents_values(policy) - mdp.own)[states, policy]  # what follows pi(s)
    for agent in range(2):
        q, other = 5 * rng.normal(size=(2, 4, 3))
        for _ in range(200):
            gap = np.abs(q - other).max()
            q, other = (target_update(mdp, values, policy, agent) for values in (q, other))
            assert np.abs(q - other).max() <= mdp.discount * gap + 1e-12
        np.testing.assert_allclose(q, mdp.rewards[:, agent] + later[:, agent, None], atol=1e-6)


def test_lemma_5_4_1_needs_the_constant_policy() -> None:
    """REDA's policy is alpha of the values themselves. Then the update contracts nothing: tables that are close, but on
    two sides of a tie, are led apart by more than gamma, and by more than they were."""
    mdp, rng = random_mdp(0), np.random.default_rng(0)

    def update(q: np.ndarray) -> np.ndarray:
        sums = np.array([[q[0, s, row[0]] + q[1, s, row[1]] for row in mdp.rows] for s in range(4)])
        return np.stack([target_update(mdp, q[i], sums.argmax(axis=1), i) for i in range(2)])

    growth = []
    for _ in range(2000):
        q = rng.normal(size=(2, 4, 3))
        other = q + 0.05 * rng.normal(size=q.shape)
        growth.append(np.abs(update(q) - update(other)).max() / np.abs(q - other).max())
    assert max(growth) > 5.0
    assert np.median(growth) <= mdp.discount + 1e-9  # where both say the same policy, the lemma is true


def played(values: np.ndarray) -> tuple[int, ...]:
    """alpha of a matrix of values, by enumeration."""
    rows = itertools.permutations(range(values.shape[1]), values.shape[0])
    return max(rows, key=lambda row: sum(values[i, j] for i, j in enumerate(row)))


def test_a_lie_pays_in_alpha_until_training_corrects_it() -> None:
    """The assignment alone is no mechanism against lies: an agent that overstates a task gets it and earns more. What
    section 5.4 claims holds for values that are trained: what the agent earns pulls the lie down to the truth."""
    truth = np.array([[2.0, 0.0], [1.9, 1.0]])
    assert played(truth) == (0, 1)  # agent 1 earns 1.0
    said = truth.copy()
    said[1, 0] = 5.0
    assert played(said) == (1, 0)  # agent 1 earns 1.9, and all together 1.9 in place of 3.0
    plays = []
    for _ in range(60):
        row = played(said)
        plays.append(row)
        for i, j in enumerate(row):  # Algorithm 4, lines 17 and 23, for episodes of one step
            said[i, j] += 0.2 * (truth[i, j] - said[i, j])
    assert plays[0] == (1, 0)
    assert plays[-30:] == [(0, 1)] * 30
    assert truth[1, 0] < said[1, 0] < 3.0  # exactly as far as it takes to lose the task


class Still:
    """One state for ever, and no handovers."""

    def initial_state(self, problem: Any) -> int:
        return 0

    def handover(self, k: int, state: int) -> np.ndarray:
        return np.zeros((2, 2))

    def transition(self, k: int, state: int, assignment: np.ndarray) -> int:
        return 0


@pytest.mark.parametrize("seed", range(3))
def test_reda_unlearns_a_lie(seed: int) -> None:
    """The same with `Learner`, Algorithm 4 itself: agent 1's network is made to overstate task 0 by 5. It gets the task
    at first, and earns more by the lie; trained on, its value falls to what it earns, and all earn most again. (Where
    nothing is explored this need not be: what one agent unlearns moves the others' values too, for they share weights,
    and a task that nobody tries is not learned anew.)"""
    truth = np.array([[2.0, 0.0], [1.9, 1.0]])
    spec = GlobalSpec(1, 2, 2, 0)
    options = TrainOptions.thesis(
        episodes=60, hidden=(), learning_rate=0.05, discount=0.0, explore=0.5, memory=3, seed=seed, spec=spec
    )
    learner = Learner(lambda _: SAP(np.tile(truth, (5, 1, 1)), Still()), AssignmentPolicy(myopic), options)
    told = truth.copy()
    told[1, 0] += 5.0
    with torch.no_grad():  # a linear network: state, agent 0, agent 1 -> task 0, task 1, any other
        learner.online.layers[0].weight.zero_()
        learner.online.layers[0].bias.zero_()
        learner.online.layers[0].weight[:2, 1:] = torch.from_numpy(told.T.astype(np.float32))
    assert learner.evaluate() == pytest.approx(5 * 1.9)
    values = [learner.play_and_learn()["value"] for _ in range(options.episodes)]
    assert values[-10:] == [pytest.approx(15.0)] * 10
    said = learner.online.values(np.eye(3, dtype=np.float32)[1:] + np.eye(3, dtype=np.float32)[:1])
    assert said[[0, 1], [0, 1]] == pytest.approx([2.0, 1.0], abs=0.01)  # what is played is known exactly
    assert said[1, 0] < truth[1, 0] + 0.05


def test_traces_end_in_the_return() -> None:
    """With trace 1 the target is the discounted return, with trace 0 one step and the value that follows."""
    rewards, later = torch.tensor([[[1.0], [2.0], [4.0]]]), torch.tensor([[[10.0], [20.0], [30.0]]])
    assert traced(rewards, later, 0.5, 0.0).flatten().tolist() == [6.0, 12.0, 19.0]
    assert traced(rewards, later, 0.5, 1.0).flatten().tolist() == [6.75, 11.5, 19.0]
