"""alpha: every backend against scipy, against enumeration, and against the other backends, plan for plan."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from strategies import arrays, full_assignment_exists, instances, quarters, sparse_quarters

from sapopt import SAP, Benefits, GainMatrix, InfeasibleError, assign
from sapopt.data.assignment import best_assignment
from sapopt.data.feasibility import explain_infeasible
from sapopt.data.windows import WindowSums

BACKENDS: tuple[Any, ...] = ("auto", "kernel", "scipy-sparse", "scipy-dense")


def total(matrix: np.ndarray, tasks: np.ndarray) -> float:
    """Benefit of an assignment."""
    return float(matrix[np.arange(len(matrix)), tasks].sum())


def is_assignment(tasks: np.ndarray, n: int, m: int) -> bool:
    """Whether every agent has a task in range and no task is taken twice."""
    return tasks.shape == (n,) and len(set(tasks.tolist())) == n and tasks.min() >= 0 and tasks.max() < m


def best_by_enumeration(matrix: np.ndarray) -> float:
    """Greatest total over all assignments."""
    n, m = matrix.shape
    return max(total(matrix, np.array(row)) for row in itertools.permutations(range(m), n))


def documented_choice(matrix: np.ndarray, order: list[int]) -> list[int]:
    """The plan that the module documentation promises.

    The lexicographically smallest best matching of positive gain (idle counts as after the last task), then the idle
    agents in ascending index on the first free task of the order.
    """
    n, m = matrix.shape
    options = [[j for j in range(m) if matrix[i, j] > 0] + [m] for i in range(n)]
    best: tuple[float, tuple[int, ...]] | None = None
    for row in itertools.product(*options):
        taken = [j for j in row if j < m]
        if len(set(taken)) == len(taken):
            gain = sum(matrix[i, j] for i, j in enumerate(row) if j < m)
            if best is None or (-gain, row) < best:
                best = (-gain, row)
    assert best is not None
    free = [j for j in order if j not in best[1]]
    return [j if j < m else free.pop(0) for j in best[1]]


def fuzzed(count: int, seed: int) -> Any:
    """Matrices with many ties: few distinct values, many zeros, square ones among them."""
    rng = np.random.default_rng(seed)
    for index in range(count):
        n = int(rng.integers(1, 9))
        m = n if index % 4 == 0 else int(rng.integers(n, 13))
        levels = (2, 3, 5, 1000)[index % 4]
        matrix = rng.integers(0, levels, (n, m)) / 4.0
        matrix[rng.random((n, m)) < rng.choice([0.0, 0.5, 0.8])] = 0.0
        yield matrix


def test_ten_thousand_problems_with_ties() -> None:
    """On 10 000 small problems full of ties the kernel finds scipy's objective."""
    order = [np.arange(m) for m in range(13)]
    for matrix in fuzzed(10_000, seed=1):
        found = best_assignment(matrix, order[matrix.shape[1]], "kernel")
        assert is_assignment(found.tasks, *matrix.shape), matrix
        rows, columns = linear_sum_assignment(matrix, maximize=True)
        best = matrix[rows, columns].sum()
        assert abs(total(matrix, found.tasks) - best) <= 1e-9, matrix
        assert abs(found.value - best) <= 1e-9, matrix


def test_backends_agree_on_the_plan() -> None:
    """On 1000 problems full of ties all backends return one plan, from an array and from a sparse matrix."""
    rng = np.random.default_rng(2)
    for matrix in fuzzed(1000, seed=3):
        parking = rng.permutation(matrix.shape[1])
        plans = [assign(matrix, backend=backend, parking=parking) for backend in BACKENDS]
        plans.append(assign(sp.csr_array(matrix), parking=parking))
        for plan in plans[1:]:
            np.testing.assert_array_equal(plan, plans[0], err_msg=repr(matrix))


def test_larger_sparse_problems() -> None:
    """At 60 x 80, sparse and tied, objective and plan agree over all backends as well."""
    rng = np.random.default_rng(4)
    for levels in (2, 4, 10**9) * 8:
        matrix = rng.integers(1, levels + 1, (60, 80)) * (rng.random((60, 80)) < 0.06) / levels
        best = matrix[linear_sum_assignment(matrix, maximize=True)].sum()
        plans = [assign(matrix, backend=backend) for backend in BACKENDS]
        assert abs(total(matrix, plans[0]) - best) <= 1e-9
        for plan in plans[1:]:
            np.testing.assert_array_equal(plan, plans[0])


@given(st.data())
def test_the_plan_is_the_documented_one(data: st.DataObject) -> None:
    """The choice among ties and the parking are those of the documentation, by enumeration."""
    n = data.draw(st.integers(1, 4))
    m = data.draw(st.integers(n, 5))
    matrix = data.draw(arrays((n, m), st.sampled_from([0.0, 0.0, 1.0, 2.0])))
    order = data.draw(st.permutations(range(m)))
    expected = documented_choice(matrix, order)
    for backend in BACKENDS:
        assert assign(matrix, backend=backend, parking=np.array(order)).tolist() == expected, backend


@given(st.data())
def test_any_matrix_against_enumeration(data: st.DataObject) -> None:
    """Negative entries and forbidden pairs, dense or sparse: the best of all, or an error if there is none."""
    n = data.draw(st.integers(1, 4))
    m = data.draw(st.integers(n, 5))
    matrix = data.draw(arrays((n, m), st.one_of(quarters, sparse_quarters, st.just(-np.inf))))
    for values in (matrix, sp.csr_array(matrix), GainMatrix.from_matrix(matrix)):
        if full_assignment_exists(matrix > -np.inf):
            tasks = assign(values)
            assert is_assignment(tasks, n, m)
            assert total(matrix, tasks) == best_by_enumeration(matrix)
        else:
            with pytest.raises(InfeasibleError, match="no full assignment exists"):
                assign(values)


@given(instances(most=(3, 5, 6), forbid=True), st.data())
def test_gain_matrices_with_held_tasks(instance: Any, data: st.DataObject) -> None:
    """Beta_hat of a sparse problem in its short form: all backends agree, on the objective with scipy as well."""
    problem = instance.problem("sparse")
    n, m, steps = problem.n, problem.m, problem.T
    state = data.draw(st.none() | st.permutations(range(m)).map(lambda p: np.array(p[:n])))
    start = data.draw(st.integers(0, steps - 1))
    stop = data.draw(st.integers(start + 1, steps))
    matrix = problem.model.interval(WindowSums(problem.benefits), start, stop, state)
    dense = matrix.toarray() if isinstance(matrix, GainMatrix) else matrix
    order = np.array(data.draw(st.permutations(range(m))))
    if not full_assignment_exists(dense > -np.inf):
        with pytest.raises(InfeasibleError):
            best_assignment(matrix, order)
        return
    best = dense[linear_sum_assignment(dense, maximize=True)].sum()
    plans = []
    for backend in BACKENDS if isinstance(matrix, GainMatrix) else ("auto", "scipy-dense"):
        found = best_assignment(matrix, order, backend)
        assert is_assignment(found.tasks, n, m)
        assert abs(total(dense, found.tasks) - best) <= 1e-9
        assert abs(found.value - best) <= 1e-9
        plans.append(found.tasks.tolist())
    assert plans.count(plans[0]) == len(plans)


@given(st.data())
def test_relabelling(data: st.DataObject) -> None:
    """Another order of agents and tasks leaves the value as it is, and with no ties the pairs as well."""
    n = data.draw(st.integers(1, 6))
    m = data.draw(st.integers(n, 8))
    matrix = np.random.default_rng(data.draw(st.integers(0, 10**6))).random((n, m))
    rows = np.array(data.draw(st.permutations(range(n))))
    columns = np.array(data.draw(st.permutations(range(m))))
    tasks = assign(matrix)
    moved = assign(matrix[rows][:, columns])
    np.testing.assert_array_equal(columns[moved], tasks[rows])


def test_scaling_does_not_matter() -> None:
    """Gains far from one, very small and very large, are told apart as well."""
    rng = np.random.default_rng(5)
    for scale in (1e-12, 1e-6, 1e6, 1e12):
        for _ in range(50):
            matrix = rng.integers(0, 1000, (5, 7)) * (rng.random((5, 7)) < 0.6) * scale
            best = matrix[linear_sum_assignment(matrix, maximize=True)].sum()
            for backend in BACKENDS:
                assert total(matrix, assign(matrix, backend=backend)) == pytest.approx(best, rel=1e-12)


def test_idle_agents_follow_the_parking_order() -> None:
    """Idle agents go, in ascending index, to the first free task of the order."""
    matrix = np.zeros((4, 6))
    matrix[1, 0] = 1.0
    for backend in BACKENDS:
        assert assign(matrix, backend=backend).tolist() == [1, 0, 2, 3]
        assert assign(matrix, backend=backend, parking=np.arange(6)[::-1]).tolist() == [5, 0, 4, 3]
        assert assign(np.zeros((3, 3)), backend=backend, parking=np.array([2, 0, 1])).tolist() == [2, 0, 1]


def test_idle_agents_do_not_take_forbidden_or_charged_tasks() -> None:
    """Parking skips pairs below the common value, and gives way to the full problem where that leaves an agent out."""
    forbidden = np.array([[-np.inf, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert total(forbidden, assign(forbidden)) == 0.0
    # Agent 0 may only take task 0, which agent 1 would like: idling is not free for agent 0.
    tight = np.array([[0.0, -np.inf, -np.inf], [1.0, 0.5, 0.0], [0.0, 0.0, 0.0]])
    for values in (tight, sp.csr_array(tight)):
        assert assign(values).tolist() == [0, 1, 2]


def test_the_smallest_problem() -> None:
    """One agent, one task, of any value that is allowed."""
    for value in (0.0, 3.0, -3.0):
        for backend in BACKENDS if value >= 0 else ("auto", "scipy-dense"):
            assert assign([[value]], backend=backend).tolist() == [0]


def test_input_forms_and_their_safety() -> None:
    """Lists, read-only and reordered arrays and all sparse formats are read, and left as they were."""
    matrix = np.array([[0.0, 2.0, 1.0], [0.0, 3.0, 0.0]])
    frozen = matrix.copy()
    frozen.flags.writeable = False
    messy = sp.csr_array(
        (np.array([0.5, 1.0, 1.5, 3.0]), np.array([2, 1, 1, 1]), np.array([0, 3, 4])), shape=(2, 3)
    )
    expected = [2, 1]
    assert assign(messy).tolist() == assign(messy.toarray()).tolist()
    np.testing.assert_array_equal(messy.indices, [2, 1, 1, 1])
    np.testing.assert_array_equal(messy.data, [0.5, 1.0, 1.5, 3.0])
    for values in (
        matrix.tolist(),
        frozen,
        np.asfortranarray(matrix),
        matrix.astype(np.float32),
        matrix.astype(int),
    ):
        assert assign(values).tolist() == expected
    for form in ("bsr", "coo", "csc", "csr", "dia", "dok", "lil"):
        assert assign(getattr(sp, f"{form}_array")(matrix)).tolist() == expected, form
        assert assign(getattr(sp, f"{form}_matrix")(matrix)).tolist() == expected, form
    assert assign(sp.csr_array((2, 3))).tolist() == [0, 1]
    split = sp.coo_array(([3.0, -2.0], ([0, 0], [1, 1])), shape=(1, 2))  # 3 - 2 is a gain of 1
    assert assign(split).tolist() == [1]


NAN, INF = float("nan"), float("inf")
BAD: dict[str, tuple[Any, str]] = {
    "NaN": ([[NAN]], "NaN"),
    "+inf": ([[INF]], r"\+inf"),
    "sparse NaN": (sp.csr_array([[NAN]]), "NaN"),
    "sparse +inf": (sp.csr_array([[INF]]), r"\+inf"),
    "more agents than tasks": (np.zeros((3, 2)), "3 agents cannot each have one of 2 tasks"),
    "more agents, sparse": (sp.csr_array((3, 2)), "3 agents cannot each have one of 2 tasks"),
    "more agents, gains": (
        GainMatrix.from_matrix(np.zeros((3, 2))),
        "3 agents cannot each have one of 2 tasks",
    ),
    "vector": ([1.0, 2.0], r"shape \(n, m\)"),
    "cube": (np.zeros((1, 1, 1)), r"shape \(n, m\)"),
    "empty": (np.zeros((0, 3)), r"shape \(n, m\)"),
    "empty list": ([], r"shape \(n, m\)"),
    "ragged": ([[1.0], [1.0, 2.0]], "real numbers"),
    "text": ([["a"]], "real numbers"),
    "complex": ([[1j]], "real numbers"),
    "sparse complex": (sp.csr_array([[1j]]), "real numbers"),
    "huge": ([[2**2000]], "real numbers"),
    "none": (None, r"shape \(n, m\)"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_matrices(name: str) -> None:
    """Each is a ValueError that says what is wrong."""
    matrix, message = BAD[name]
    with pytest.raises(ValueError, match=message):
        assign(matrix)


def test_bad_options() -> None:
    """An unknown backend, a parking order that is none, and a backend that cannot take the matrix."""
    with pytest.raises(ValueError, match="kernel, scipy-sparse"):
        assign([[1.0]], backend="simplex")  # type: ignore[arg-type]
    for parking in ([0, 0, 1], [0, 1], [1, 2, 3], [0.0, 0.5, 1.0], ["a", "b", "c"], [[0, 1, 2]], 3):
        with pytest.raises(ValueError, match="parking"):
            assign(np.zeros((2, 3)), parking=parking)  # type: ignore[arg-type]
    for backend in ("kernel", "scipy-sparse"):
        with pytest.raises(ValueError, match="use 'scipy-dense'"):
            assign([[-1.0]], backend=backend)  # type: ignore[arg-type]


@given(st.data())
def test_infeasibility_is_explained(data: st.DataObject) -> None:
    """The explanation is empty exactly if a full assignment exists; else its agents have too few tasks (Hall)."""
    n = data.draw(st.integers(1, 5))
    m = data.draw(st.integers(n, 6))
    allowed = data.draw(arrays((n, m), st.sampled_from([0.0, 0.0, 1.0]))) > 0
    reason = explain_infeasible(allowed)
    assert (reason == "") == full_assignment_exists(allowed)
    if reason:
        words = reason.split("agents ")[1].split(" (")
        agents = [int(i) for i in words[0].split(",")]
        share = int(reason.split("allowed only ")[1].split()[0])
        assert allowed[agents].any(axis=0).sum() == share < len(agents)


@pytest.mark.parametrize("backend", ["auto", "kernel", "scipy-sparse", "scipy-dense"])
def test_ties_are_judged_by_the_agents_concerned(backend: Any) -> None:
    """Where one agent gains 1e9, or 1e15, the thousandths of the others still decide what they do."""
    for large in (1.0, 1e9, 1e15, 1e300):
        gains = np.array([[0.001, 0.009, 0, 0], [0.002, 0.001, 0, 0], [0, 0, large, 0]])
        np.testing.assert_array_equal(assign(gains, backend=backend), [1, 0, 2])


def test_backends_agree_at_any_scale() -> None:
    """From 1e-300 to 1e300 all backends find the same assignment."""
    rng = np.random.default_rng(0)
    for _ in range(60):
        scale = 10.0 ** rng.uniform(-300, 300)
        gains = rng.random((6, 8)) * (rng.random((6, 8)) < 0.5) * scale
        found = [assign(gains, backend=b).tolist() for b in ("kernel", "scipy-sparse", "scipy-dense")]
        assert found[0] == found[1] == found[2]


@pytest.mark.parametrize("kind", ["u1", "i1", "f4", "?"])
def test_pairs_listed_twice_are_added_up_as_numbers(kind: str) -> None:
    """Entries of one pair are summed in float64, whatever the type of the matrix can hold."""
    data = np.array([100, 100, 90, 100], kind)
    matrix = sp.coo_array((data, ([0, 0, 1, 0], [0, 0, 1, 1])), shape=(2, 2))
    expected = np.array([[2.0 * float(data[0]), float(data[3])], [0.0, float(data[2])]])
    np.testing.assert_array_equal(Benefits([matrix]).dense()[0], expected)
    assert SAP([matrix]).evaluate([assign(matrix)]).value == expected[0, 0] + expected[1, 1]


def test_masked_entries_are_refused_wherever_they_hide() -> None:
    """Masked arrays in lists, as plans and as initial assignments are refused as a masked array of benefits is."""
    step = np.ma.masked_greater(np.arange(6.0).reshape(2, 3), 3.0)
    for values in ([step, step], (step,), [[step[0], step[1]]], np.ma.stack([step])):
        with pytest.raises(ValueError, match="must not be masked"):
            SAP(values)
    one = np.ma.masked_equal([0, 1], 1)
    with pytest.raises(ValueError, match="initial_assignment must not be masked"):
        SAP(np.ones((1, 2, 3)), 0.0, one)
    for plan in ([one], np.ma.stack([one]), [[0, np.ma.masked]]):
        with pytest.raises(ValueError, match="plan must not be masked"):
            SAP(np.ones((1, 2, 3))).evaluate(plan)
