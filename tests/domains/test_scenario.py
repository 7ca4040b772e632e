"""Scenarios, graphs and the registry of instances."""

import subprocess
import sys
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sapopt import SAP
from sapopt.domains.constellation import (
    Constellation,
    GroundTasks,
    WalkerShell,
    constellation,
    even_tasks,
    links,
    random_tasks,
    walker_constellation,
    walker_positions_km,
)
from sapopt.domains.instances import find_instance, instance, instances, register, scenario

MID = Path(__file__).parents[1] / "data" / "mid.npz"


@pytest.fixture(scope="module")
def toy():
    """The smallest built-in scenario."""
    return scenario("constellation-toy")


@settings(max_examples=30)
@given(planes=st.integers(1, 6), places=st.integers(1, 8), reach=st.floats(100, 15000))
def test_links_are_the_pairs_within_range(planes, places, reach):
    """The graphs hold the pairs that all distances give."""
    positions = walker_positions_km(WalkerShell(planes, places, 60.0, 800.0), 2, 500.0, earth="still")
    graphs = links(positions, reach)
    assert len(graphs) == 2
    for graph, now in zip(graphs, positions, strict=True):
        apart = np.linalg.norm(now[:, None] - now, axis=2)
        expected = np.argwhere(np.triu(apart < reach, k=1))
        assert list(graph.nodes) == list(range(len(now)))
        assert sorted(tuple(sorted(edge)) for edge in graph.edges) == [
            tuple(pair) for pair in expected.tolist()
        ]


def test_links_are_closer_than_the_range():
    """At exactly the range there is no link."""
    positions = np.array([[[7000.0, 0, 0], [7000.0, 2500.0, 0], [7000.0, 0, 2499.0]]])
    assert list(links(positions)[0].edges) == [(0, 2)]
    with pytest.raises(ValueError, match="range_km"):
        links(positions, 0.0)


def test_scenario_sizes_and_graphs(toy):
    """Sizes, names and graphs of the chosen steps."""
    assert isinstance(toy, Constellation)
    assert toy.benefits.shape == (toy.T, toy.n, toy.m) == find_instance("constellation-toy").shape
    assert len(toy.satellite_names) == toy.n == len(set(toy.satellite_names))
    assert len(toy.graphs()) == toy.T
    some = toy.graphs(6000.0, steps=[3])
    assert nx.utils.graphs_equal(some[0], links(toy.positions_km[3:4], 6000.0)[0])


def test_problem_and_its_options(toy):
    """The problem carries cost, rule, first assignment and labels."""
    problem = toy.problem(0.25, idle_is_free=True, initial_assignment=np.arange(toy.n))
    assert (problem.T, problem.n, problem.m) == (20, 24, 30)
    assert problem.dynamics.cost == 0.25
    assert problem.dynamics.idle_is_free
    assert problem.agents == toy.satellite_names
    np.testing.assert_array_equal(problem.initial_assignment, np.arange(toy.n))
    plan = np.tile(np.arange(toy.n), (toy.T, 1))
    assert problem.evaluate(plan).value == pytest.approx(
        toy.benefits.dense()[:, range(toy.n), range(toy.n)].sum()
    )


def test_more_satellites_than_tasks():
    """n > m is refused with the way out, which works."""
    few = walker_constellation(WalkerShell(2, 4, 50.0, 550.0), random_tasks(5), steps=3)
    with pytest.raises(ValueError, match=r"with_idle_tasks\(\)"):
        few.problem()
    wide = few.with_idle_tasks()
    assert wide.m == wide.tasks.m == 13
    assert wide.problem().m == 13
    assert few.with_idle_tasks(3).problem().m == 8
    assert wide.benefits.dense()[:, :, 5:].max() == 0


def test_power_setting_is_expressible():
    """Section 6.4: priorities {1, 1, 1, 5}, 100 steps of 63.76 s."""
    tasks = random_tasks(450, 7, priorities=(1, 1, 1, 5))
    built = walker_constellation(WalkerShell(18, 18, 58.0, 550.0), tasks, 100, 63.76, earth="still")
    assert built.benefits.shape == (100, 324, 450)
    assert built.step_s == 63.76
    np.testing.assert_allclose(
        built.positions_km[1],
        walker_positions_km(WalkerShell(18, 18, 58.0, 550.0), 1, 63.76, start_s=127.52, earth="still")[0],
    )


def test_whole_constellation_turned_with_its_tasks():
    """Turning satellites and tasks by 90 degrees changes nothing."""
    shell = WalkerShell(3, 5, 63.0, 900.0)
    tasks = random_tasks(40, 5)
    turned = GroundTasks(tasks.latitude_deg, tasks.longitude_deg + 90.0, tasks.priority)
    plain = walker_constellation(shell, tasks, 5)
    other = walker_constellation(shell, turned, 5, sidereal_angle_deg=-90.0)
    np.testing.assert_allclose(other.benefits.dense(), plain.benefits.dense(), atol=1e-9)


def test_bad_constellations():
    """Names and step lengths that do not fit are refused."""
    positions = np.full((1, 2, 3), 5000.0)
    with pytest.raises(ValueError, match="satellite_names"):
        constellation(positions, random_tasks(3), 60.0, satellite_names=["a"])
    with pytest.raises(ValueError, match="step_s"):
        constellation(positions, random_tasks(3), -60.0)


def test_mid_is_the_reference_instance():
    """The instance of seed 0 is the reference instance, number by number."""
    flat = scenario("constellation-mid").benefits.flat()
    with np.load(MID) as file:
        order = np.lexsort((file["task"], file["agent"], file["step"]))
        np.testing.assert_array_equal(flat.indices, file["task"][order])
        np.testing.assert_allclose(flat.data, file["benefit"][order], rtol=1e-9)


DEPENDS_ON_ALL_STEPS = ("multi-beam-us", "tracking", "tracking-thesis")
"""Satellites that see nothing at any step are left out."""


@pytest.mark.parametrize("name", [d.name for d in instances()])
def test_every_instance_has_its_shape_and_seed(name, tmp_path):
    """Each instance builds, in its documented shape, the same for the same seed, another for another; files keep it."""
    described = find_instance(name)
    options = {"steps": 2} if "steps" in described.options and name not in DEPENDS_ON_ALL_STEPS else {}
    first, again, other = (instance(name, seed, **options) for seed in (1, 1, 2))
    assert first.fingerprint == again.fingerprint
    assert first.fingerprint != other.fingerprint or name == "dictator"  # one table of values, nothing drawn
    assert (first.n, first.m) == described.shape[1:]
    if name in ("dictator", "tracking", "tracking-thesis"):  # they charge something else than handovers
        with pytest.raises(ValueError, match="cost: "):
            instance(name, 1, cost=0.125, **options)
    elif name != "unit-commitment":  # its cost is a factor on every unit's own
        assert instance(name, 1, cost=0.125, **options).dynamics.cost == 0.125
    first.save(tmp_path / "instance.npz")
    loaded = SAP.load(tmp_path / "instance.npz")
    assert loaded.fingerprint == first.fingerprint
    assert type(loaded.dynamics) is type(first.dynamics)
    assert described.summary


def test_large_by_the_text():
    """Section 4.2.2: 812 tasks on rings from -70 to 70 degrees, 188 dummies, every step of the orbit."""
    large = scenario("constellation-large-thesis", steps=2)
    assert large.tasks.m == 1000
    assert abs(large.tasks.latitude_deg).max() == 70.0
    assert (large.tasks.priority[812:] == 0).all()
    assert (large.tasks.priority[:812] >= 1).all()


def test_shells_of_section_6_5():
    """Five shells at the altitudes of the footnote; del Portillo's configuration has 4425 satellites, not 4225."""
    from sapopt.domains.constellation import STARLINK_SHELLS_2019

    assert [shell.altitude_km for shell in STARLINK_SHELLS_2019] == [550, 510, 530, 675, 725]
    assert sum(shell.n for shell in STARLINK_SHELLS_2019) == 4425


def test_large_has_even_and_idle_tasks():
    """812 even tasks and 188 that nobody gains from."""
    large = scenario("constellation-large", steps=2)
    np.testing.assert_array_equal(large.tasks.latitude_deg[:812], even_tasks().latitude_deg)
    assert large.benefits.flat().indices.max() < 812


def test_unknown_names_and_options():
    """The nearest name is suggested; a name can be taken only once."""
    with pytest.raises(ValueError, match="did you mean 'starlink'"):
        instance("starlnk")
    with pytest.raises(ValueError, match="known: attitude, constellation-large, "):
        instance("zzz")
    with pytest.raises(ValueError, match="no option 'step'; did you mean 'steps'"):
        instance("starlink", step=3)
    with pytest.raises(ValueError, match="already"):
        register("starlink", "", (1, 1, 1))


def test_importing_the_domains_is_light():
    """Importing domains and listing the instances loads no compiler, plotting or graph package."""
    code = (
        "import sys, sapopt.domains.instances as i, sapopt.domains.constellation; i.instances();"
        "print([m for m in ('numba', 'matplotlib', 'cvxpy', 'torch', 'networkx', 'sgp4') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
