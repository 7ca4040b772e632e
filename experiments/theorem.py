"""Algorithms 1 and 2 and the optimum in exact arithmetic, on sequential assignment problems of any state model.

Line 2 of Algorithm 2 sets the window at step k = 1 .. T to L' = min(L, T - k) steps. To the letter that leaves no step
at k = T, and the last L windows one step short of what can be known; appendix A and the prose mean min(L, T - k + 1).
Both readings are followed here. The instances refute the theorem in the second one. With one step appended in which
every pair is worth B/n, which changes neither B nor c, B2, B, C and G1 refute it in both.

No verdict here rests on sapopt, and no number is rounded: benefits, costs and values are integers or fractions.
Assignments are tuples, all of them are enumerated, and where several are equally good *all* ways to break the ties
can be followed, so that a claim does not rest on how ties are broken.

    python -m experiments.theorem [tests/data/theorem_counterexamples.json] [--out results/theorem]

Nothing is random and all instances are small: `--seeds` and `--quick` change nothing.
"""

from __future__ import annotations

import argparse
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import permutations
from pathlib import Path
from typing import Any

Assignment = tuple[int, ...]
KNOWN = Path(__file__).resolve().parents[1] / "tests" / "data" / "theorem_counterexamples.json"


@dataclass
class Model(ABC):
    """A problem in exact numbers; subclasses say what a state is.

    benefits[k][i][j] is the benefit of agent i for task j at step k.
    """

    benefits: list[list[list[Fraction]]]
    start: Any
    choices: list[Assignment] = field(init=False)

    def __post_init__(self) -> None:
        self.benefits = [[[Fraction(x) for x in row] for row in step] for step in self.benefits]
        self.T, self.n, self.m = len(self.benefits), len(self.benefits[0]), len(self.benefits[0][0])
        self.choices = list(permutations(range(self.m), self.n))
        self._best: dict[Any, list[Assignment]] = {}

    @abstractmethod
    def eta(self, state: Any, choice: Assignment) -> Fraction:
        """Handover of an assignment in a state."""

    @abstractmethod
    def after(self, state: Any, choice: Assignment) -> Any:
        """Next state."""

    @abstractmethod
    def worst_handover(self) -> Fraction:
        """|H|, the most that handovers of one step can differ from none."""

    def static(self, k: int, choice: Assignment) -> Fraction:
        """Benefit of an assignment at step k."""
        return sum((self.benefits[k][i][j] for i, j in enumerate(choice)), Fraction(0))

    def value(self, plan: list[Assignment], state: Any = None, first: int = 0) -> Fraction:
        """Value of a plan from step `first` on."""
        state = self.start if state is None else state
        total = Fraction(0)
        for k, choice in enumerate(plan, first):
            total += self.static(k, choice) + self.eta(state, choice)
            state = self.after(state, choice)
        return total

    def interval(self, start: int, stop: int, state: Any) -> list[Assignment]:
        """All optimal assignments of the summed benefits of ``start .. stop - 1`` plus eta(state) (lines 8 and 9)."""
        key = (start, stop, state)
        if key not in self._best:
            worth = [
                sum((self.static(k, x) for k in range(start, stop)), Fraction(0)) + self.eta(state, x)
                for x in self.choices
            ]
            top = max(worth)
            self._best[key] = [x for x, w in zip(self.choices, worth, strict=True) if w == top]
        return self._best[key]

    def played(self, start: int, stop: int, state: Any, choice: Assignment) -> tuple[Fraction, Any]:
        """What an assignment held over ``start .. stop - 1`` brings, and the state it leads to, step by step."""
        total = Fraction(0)
        for k in range(start, stop):
            total += self.static(k, choice) + self.eta(state, choice)
            state = self.after(state, choice)
        return total, state

    def appended(self) -> Model:
        """The same with one more step, in which every pair is worth B/n: no assignment there is worth less than B."""
        longer = copy(self)
        share = self.least() / self.n
        longer.benefits = [*self.benefits, [[share] * self.m for _ in range(self.n)]]
        longer.T = self.T + 1
        longer._best = {}
        return longer

    def least(self) -> Fraction:
        """B-underbar: the least benefit of any assignment at any step."""
        return min(self.static(k, x) for k in range(self.T) for x in self.choices)


class Simple(Model):
    """The simple handover model: every change of task costs `cost`, the state is the last assignment."""

    def __init__(self, benefits: Any, cost: Any, start: Any) -> None:
        self.cost = Fraction(cost)
        super().__init__(benefits, None if start is None else tuple(start))

    def eta(self, state: Any, choice: Assignment) -> Fraction:
        return -self.cost * sum(a != b for a, b in zip(state, choice, strict=True)) if state else Fraction(0)

    def after(self, state: Any, choice: Assignment) -> Any:
        return choice

    def worst_handover(self) -> Fraction:
        return self.n * self.cost


class General(Model):
    """One agent; a state s has ``eta[s][j]`` and leads to ``moves[s][j]``."""

    def __init__(self, benefits: Any, moves: Any, eta: Any, start: int) -> None:
        self.moves, self.table = moves, eta
        super().__init__(benefits, start)

    def eta(self, state: Any, choice: Assignment) -> Fraction:
        return Fraction(self.table[state][choice[0]])

    def after(self, state: Any, choice: Assignment) -> Any:
        return self.moves[state][choice[0]]

    def worst_handover(self) -> Fraction:
        flat = [Fraction(x) for row in self.table for x in row]
        return max(flat) - min(flat)


def optimum(model: Model) -> Fraction:
    """Greatest value of any plan."""
    layer: dict[Any, Fraction] = {model.start: Fraction(0)}
    for k in range(model.T):
        following: dict[Any, Fraction] = {}
        for state, value in layer.items():
            for x in model.choices:
                total = value + model.static(k, x) + model.eta(state, x)
                target = model.after(state, x)
                if target not in following or total > following[target]:
                    following[target] = total
        layer = following
    return max(layer.values())


def window_end(model: Model, lookahead: int, k: int, to_the_letter: bool = False) -> int:
    """One past the last step that the window of step k (0-based) holds, in either reading of line 2; at least k + 1."""
    return min(k + lookahead, model.T) if not to_the_letter else max(min(k + lookahead, model.T - 1), k + 1)


def haal_values(model: Model, lookahead: int, to_the_letter: bool = False) -> set[Fraction]:
    """Values of Algorithm 2 under every way to break ties (between assignments and between sequences)."""
    ends: set[tuple[Any, Fraction]] = {(model.start, Fraction(0))}
    for k in range(model.T):
        stop = window_end(model, lookahead, k, to_the_letter)
        memo: dict[Any, set[tuple[Fraction, Assignment]]] = {}
        ends = {
            (model.after(state, x), value + model.static(k, x) + model.eta(state, x))
            for state, value in ends
            for _, x in _outcomes(model, k, stop, state, memo)
        }
    return {value for _, value in ends}


def _outcomes(
    model: Model, start: int, stop: int, state: Any, memo: dict[Any, set[tuple[Fraction, Assignment]]]
) -> set[tuple[Fraction, Assignment]]:
    """(value, first assignment) of the sequences that may come out best from here, ties broken in all ways."""
    if (start, state) in memo:
        return memo[start, state]
    by_cut = []
    for cut in range(start + 1, stop + 1):
        found = set()
        for x in model.interval(start, cut, state):
            value, after = model.played(start, cut, state, x)
            if cut == stop:
                found.add((value, x))
                continue
            found |= {(value + rest, x) for rest, _ in _outcomes(model, cut, stop, after, memo)}
        by_cut.append(found)
    # an outcome can win if the other cuts can, ties broken against them, do no better
    floor = max(min(value for value, _ in found) for found in by_cut)
    memo[start, state] = {pair for found in by_cut for pair in found if pair[0] >= floor}
    return memo[start, state]


def haal_plan(model: Model, lookahead: int, keep_plan: bool = False) -> list[Assignment]:
    """Algorithm 2 with the first of equal choices; with `keep_plan`, HAAL+.

    HAAL+ also evaluates, at every step, the unexecuted rest of the plan it made one step earlier, plus one greedy
    step.
    """
    state, tail = model.start, []
    plan: list[Assignment] = []
    for k in range(model.T):
        stop = min(k + lookahead, model.T)
        best = max(_sequences(model, k, stop, state), key=lambda candidate: model.value(candidate, state, k))
        if keep_plan and plan:
            kept = list(tail)
            if len(kept) < stop - k:
                inner = state
                for x in kept:
                    inner = model.after(inner, x)
                kept.append(model.interval(stop - 1, stop, inner)[0])
            if model.value(kept, state, k) > model.value(best, state, k):
                best = kept
        plan.append(best[0])
        tail = best[1:]
        state = model.after(state, best[0])
    return plan


def _sequences(model: Model, start: int, stop: int, state: Any) -> Iterator[list[Assignment]]:
    if start == stop:
        yield []
        return
    for cut in range(start + 1, stop + 1):
        x = model.interval(start, cut, state)[0]
        for rest in _sequences(model, cut, stop, model.played(start, cut, state, x)[1]):
            yield [x] * (cut - start) + rest


def load(path: Path = KNOWN) -> list[dict[str, Any]]:
    """The known instances, each with its `model` added."""
    out = []
    for entry in json.loads(path.read_text(encoding="utf-8"))["instances"]:
        if "general_model" in entry:
            g = entry["general_model"]
            model: Model = General(g["beta"], g["trans"], g["eta"], g["s1"])
            known = {
                "lookahead": g["L"], "optimal_value": g["result"]["Vopt"],
                "haal_values": g["result"]["VH_all_tiebreaks"], "haa_values": g["result"]["V_HAA_L1"],
            }  # fmt: skip
        else:
            model = Simple(entry["benefits"], entry["cost"], entry["initial_assignment"])
            known = {
                "lookahead": entry["lookahead"], "optimal_value": entry["optimal_value"],
                "haal_values": [entry["haal_value"]], "haa_values": [entry["haa_value"]],
            }  # fmt: skip
        out.append({**entry, **known, "model": model})
    return out


def main(argv: Sequence[str] | None = None) -> None:
    from experiments import common  # the command line and the file of results; no verdict depends on it

    def add(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("file", nargs="?", type=Path, default=KNOWN)

    run = common.begin(__doc__, "theorem", argv, add=add)
    rows = []
    print(
        f"{'instance':38} {'L':>2} {'optimum':>8} {'HAAL':>8} {'letter':>8} {'HAA':>8} {'HAAL+':>8} "
        f"{'ratio':>7} {'c/(1+c)':>8}"
    )
    known = [(entry["name"], entry["model"], entry["lookahead"]) for entry in load(run.options.file)]
    known += [(f"{name}+1", model.appended(), lookahead) for name, model, lookahead in known]
    for name, model, lookahead in known:
        best = optimum(model)
        haal, haa = haal_values(model, lookahead), haal_values(model, 1)
        letter = haal_values(model, lookahead, to_the_letter=True)
        plus = model.value(haal_plan(model, lookahead, keep_plan=True))
        c = model.least() / model.worst_handover()
        broken = [max(values) < c / (1 + c) * best for values in (haal, letter)]
        mark = "  violated" + (" in both readings" if all(broken) else "") if any(broken) else ""
        print(
            f"{name:38} {lookahead:>2} {best!s:>8} {'/'.join(map(str, sorted(haal))):>8} "
            f"{'/'.join(map(str, sorted(letter))):>8} {'/'.join(map(str, sorted(haa))):>8} {plus!s:>8} "
            f"{float(max(haal) / best):>7.4f} {float(c / (1 + c)):>8.4f}{mark}"
        )
        rows.append(
            {
                "name": name, "lookahead": lookahead, "optimum": str(best),
                "haal": [str(v) for v in sorted(haal)], "haal_to_the_letter": [str(v) for v in sorted(letter)],
                "haa": [str(v) for v in sorted(haa)], "haal_plus": str(plus), "promised": str(c / (1 + c)),
                "violated": broken[0], "violated_to_the_letter": broken[1],
            }
        )  # fmt: skip
    run.write_json({"instances": rows})


if __name__ == "__main__":
    main()
