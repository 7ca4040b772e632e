"""Algorithm 4 on the dictator with a table in place of the network: what decides whether it reaches 60 (thesis, 6.1).

    python -m experiments.dictator_table [--seeds 3] [--quick] [--out results/dictator_table]

Guide, noise and targets are those of Algorithm 4; epsilon is 0 from half of the 20 000 steps on. What varies is
whether agents see the number of the step beside the state, how many transitions are remembered, and the guide.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Sequence

import numpy as np

from experiments import common
from sapopt.domains.dictator import VALUES

ROWS = np.array(list(itertools.permutations(range(3))))
AGENTS = np.arange(3)
HORIZON, BATCH, RATE, DISCOUNT, TARGET_EVERY = 10, 8, 0.1, 0.99, 100

SETTINGS = [
    ("greedy", True, 20_000), ("greedy", True, 1_000), ("greedy", True, 100), ("greedy", False, 20_000),
    ("greedy", False, 1_000), ("greedy", False, 100), ("random", False, 20_000),
]  # fmt: skip
"""Guide, whether the step is seen, transitions remembered."""


def alpha(values: np.ndarray) -> np.ndarray:
    """Assignment (3,) of the greatest total of values (3, 3)."""
    return ROWS[np.argmax(values[AGENTS, ROWS].sum(axis=1))]


GREEDY = [alpha(values) for values in VALUES]


def play(table: np.ndarray, shows_step: bool) -> tuple[float, list[list[int]]]:
    """Value and plan of a table, tasks counted from 1."""
    state, value, plan = 0, 0.0, []
    for k in range(HORIZON):
        tasks = alpha(table[k if shows_step else 0, state])
        value += float(VALUES[state, AGENTS, tasks].sum())
        plan.append((tasks + 1).tolist())
        state = int(tasks[0])
    return value, plan


def train(seed: int, guide: str, shows_step: bool, memory: int, steps: int) -> tuple[float, list[list[int]]]:
    """One run: the value and plan of the last table."""
    rng = np.random.default_rng(seed)
    table = np.zeros((HORIZON + 1 if shows_step else 1, 3, 3, 3))  # step, state, agent, task
    target = table.copy()
    remembered: deque[tuple[int, int, np.ndarray, np.ndarray]] = deque(maxlen=memory)
    state = 0
    for step in range(steps):
        k = step % HORIZON
        state = state if k else 0
        epsilon = max(0.0, 1.0 - 2.0 * step / steps)
        if rng.random() < epsilon:
            tasks = GREEDY[state] if guide == "greedy" else ROWS[rng.integers(len(ROWS))]
        else:
            values = table[k if shows_step else 0, state]
            tasks = alpha(values + rng.standard_normal((3, 3)) * 2.0 * epsilon * np.abs(values).mean())
        remembered.append((k, state, tasks, VALUES[state, AGENTS, tasks]))
        for slot in rng.integers(len(remembered), size=BATCH):
            at, before, chosen, goal = remembered[slot]
            if at < HORIZON - 1:
                now, after = at + 1 if shows_step else 0, chosen[0]
                goal = goal + DISCOUNT * target[now, after][AGENTS, alpha(table[now, after])]
            row = table[at if shows_step else 0, before]
            row[AGENTS, chosen] += RATE * (goal - row[AGENTS, chosen])
        if (step + 1) % TARGET_EVERY == 0:
            target = table.copy()
        state = int(tasks[0])
    return play(table, shows_step)


def main(argv: Sequence[str] | None = None) -> None:
    run = common.begin(__doc__, "dictator_table", argv, seeds=3, quick_seeds=1)
    records = []
    for guide, shows_step, memory in SETTINGS:
        for seed in run.seeds:
            value, plan = train(seed, guide, shows_step, memory, 500 if run.quick else 20_000)
            records.append(
                {
                    "guide": guide,
                    "step": shows_step,
                    "memory": memory,
                    "seed": seed,
                    "value": value,
                    "plan": plan,
                }
            )
        values = ", ".join(f"{record['value']:.1f}" for record in records[-len(run.seeds) :])
        sees = "state and step" if shows_step else "state"
        run.say(f"{guide} guide, {sees}, {memory} transitions remembered: {values}")
    run.write_json({"runs": records})


if __name__ == "__main__":
    main()
