"""Built-in instances by name."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sapopt.domains import planning as planning
from sapopt.domains.registry import Instance, find_instance, instances, nearest, register
from sapopt.domains.scenario import Scenario

if TYPE_CHECKING:
    from sapopt.problem.sap import SAP

__all__ = ["Instance", "find_instance", "instance", "instances", "register", "scenario"]


def scenario(name: str, seed: int = 0, **options: Any) -> Any:
    """Build the scenario of an instance: the domain's own object, such as a `Constellation`.

    Parameters
    ----------
    name : str
    seed : int
        The same seed gives the same scenario.
    **options
        Options of the instance, see ``find_instance(name).options``.

    Raises
    ------
    ValueError
        If the name or an option is unknown.
    """
    found = find_instance(name)
    for option in options:
        if option not in found.options:
            raise ValueError(f"instance {name!r} has no option {option!r}; {nearest(option, found.options)}")
    return found.build(seed, **options)


def instance(
    name: str, seed: int = 0, *, cost: Any = None, idle_is_free: bool | None = None, **options: Any
) -> SAP:
    """Build the problem of an instance.

    Parameters
    ----------
    name : str
    seed : int
        The same seed gives the same problem.
    cost : float or ndarray of shape (m, m), optional
        Cost of a handover; that of the instance if omitted.
    idle_is_free : bool, optional
        Whether only moves to tasks of positive benefit are charged; the instance's own rule if omitted.
    **options
        Options of the instance, see ``find_instance(name).options``.

    Raises
    ------
    ValueError
        If the name or an option is unknown.
    """
    built = scenario(name, seed, **options)
    rule = {} if idle_is_free is None else {"idle_is_free": idle_is_free}
    problem: SAP = built.problem(cost=find_instance(name).cost if cost is None else cost, **rule)
    return problem


@register(
    "constellation-mid",
    "324 satellites (18 x 18 at 58 deg, 550 km), 450 random tasks, one orbit of 93 minutes; Holder 2024, 4.2.1",
    (93, 324, 450),
)
def _mid(seed: int, steps: int = 93, tasks: int = 450, earth: Any = "still", j2: bool = False) -> Scenario:
    from sapopt.domains import constellation as c

    return c.walker_constellation(
        c.WalkerShell(18, 18, 58.0, 550.0), c.random_tasks(tasks, seed), steps, earth=earth, j2=j2
    )


@register(
    "constellation-large",
    "1000 satellites (40 x 25 at 70 deg, 550 km), 812 even tasks to 80 deg, 188 of zero benefit, 93 minutes",
    (93, 1000, 1000),
)
def _large(seed: int, steps: int = 93, earth: Any = "still", j2: bool = False) -> Scenario:
    from sapopt.domains import constellation as c

    tasks = c.even_tasks(seed=seed)
    return c.walker_constellation(
        c.WalkerShell(40, 25, 70.0, 550.0), tasks.with_idle_tasks(1000 - tasks.m), steps, earth=earth, j2=j2
    )


@register(
    "constellation-large-thesis",
    "1000 satellites (40 x 25 at 70 deg), 812 tasks on rings within 70 deg, 188 of zero benefit; Holder 2024, 4.2.2",
    (93, 1000, 1000),
)
def _large_thesis(seed: int, steps: int = 93, earth: Any = "still", j2: bool = False) -> Scenario:
    from sapopt.domains import constellation as c

    tasks = c.ring_tasks(seed=seed)
    return c.walker_constellation(
        c.WalkerShell(40, 25, 70.0, 550.0), tasks.with_idle_tasks(1000 - tasks.m), steps, earth=earth, j2=j2
    )


@register(
    "constellation-shells",
    "4225 satellites in five Starlink shells, 4225 random tasks, 93 minutes; the size of Holder 2024, 6.5",
    (93, 4225, 4225),
)
def _shells(
    seed: int, steps: int = 93, tasks: int = 4225, earth: Any = "still", j2: bool = False
) -> Scenario:
    from sapopt.domains import constellation as c

    return c.walker_constellation(
        c.STARLINK_SHELLS_4225, c.random_tasks(tasks, seed), steps, earth=earth, j2=j2
    )


@register(
    "constellation-toy",
    "24 satellites (4 x 6 at 58 deg, 1200 km), 30 random tasks, 20 steps of 2 minutes; for quick tries",
    (20, 24, 30),
)
def _toy(seed: int, steps: int = 20, tasks: int = 30, earth: Any = "still", j2: bool = False) -> Scenario:
    from sapopt.domains import constellation as c

    return c.walker_constellation(
        c.WalkerShell(4, 6, 58.0, 1200.0), c.random_tasks(tasks, seed), steps, 120.0, earth=earth, j2=j2
    )


@register(
    "starlink",
    "4213 real Starlink satellites (element sets of June 2023, SGP4, rotating Earth), 4500 random tasks, 93 minutes",
    (93, 4213, 4500),
)
def _starlink(seed: int, steps: int = 93, tasks: int = 4500, earth: Any = "rotating") -> Scenario:
    from sapopt.domains import constellation as c

    ground = c.random_tasks(tasks, seed, max_latitude_deg=60.0, uniform_in="area")
    return c.element_constellation(c.starlink_elements(), ground, steps, earth=earth)


@register(
    "dictator",
    "3 agents, 3 tasks, 3 states that the first agent sets, 10 steps; greed earns 37.8 of 63; Holder 2024, 6.1",
    (10, 3, 3),
    cost=0.0,
)
def _dictator(seed: int, steps: int = 10) -> Scenario:
    from sapopt.domains.dictator import DictatorScenario

    return DictatorScenario(steps)


@register(
    "earth-coverage",
    "324 satellites, 450 random tasks of priority 1 or 5, 100 steps, idling is free; the published code of Holder 2024",
    (100, 324, 450),
)
def _earth_coverage(seed: int, steps: int = 100, tasks: int = 450, earth: Any = "still") -> Scenario:
    from sapopt.domains.power import power_constellation

    return power_constellation(tasks=tasks, steps=steps, seed=seed, battery=False, earth=earth)


@register(
    "earth-coverage-thesis",
    "324 satellites, 450 random tasks of priority 1, 93 minutes, idling is free; Holder 2024, 6.3",
    (93, 324, 450),
)
def _earth_coverage_thesis(
    seed: int, steps: int = 93, tasks: int = 450, earth: Any = "still", j2: bool = False
) -> Scenario:
    from sapopt.domains.power import earth_coverage

    return earth_coverage(seed, steps=steps, tasks=tasks, earth=earth, j2=j2)


@register(
    "power",
    "324 satellites on batteries, 450 random tasks of priority 1 or 5, 100 steps; Holder 2024, 6.4, as published",
    (100, 324, 450),
)
def _power(
    seed: int, steps: int = 100, tasks: int = 450, earth: Any = "still", pay_for: Any = "moves"
) -> Scenario:
    from sapopt.domains.power import power_constellation

    return power_constellation(tasks=tasks, steps=steps, seed=seed, earth=earth, pay_for=pay_for)


@register(
    "power-1008",
    "1008 satellites on batteries (36 x 28 at 58 deg, 550 km), 1008 random tasks, 100 steps; the size of 6.5",
    (100, 1008, 1008),
)
def _power_1008(
    seed: int, steps: int = 100, tasks: int = 1008, earth: Any = "still", pay_for: Any = "moves"
) -> Scenario:
    from sapopt.domains.constellation import WalkerShell
    from sapopt.domains.power import power_constellation

    shell = WalkerShell(36, 28, 58.0, 550.0)
    return power_constellation(shell, tasks, steps, seed, earth=earth, pay_for=pay_for)


@register(
    "power-4225",
    "4225 satellites on batteries in five Starlink shells (licence of 2021), 4225 random tasks, 100 steps",
    (100, 4225, 4225),
)
def _power_4225(
    seed: int, steps: int = 100, tasks: int = 4225, earth: Any = "still", pay_for: Any = "moves"
) -> Scenario:
    from sapopt.domains.constellation import STARLINK_SHELLS_4225
    from sapopt.domains.power import power_constellation

    return power_constellation(STARLINK_SHELLS_4225, tasks, steps, seed, earth=earth, pay_for=pay_for)


@register(
    "power-4425",
    "4425 satellites on batteries in five shells of 510 to 725 km, 4425 random tasks, 100 steps; Holder 2024, 6.5",
    (100, 4425, 4425),
)
def _power_4425(
    seed: int, steps: int = 100, tasks: int = 4425, earth: Any = "still", pay_for: Any = "moves"
) -> Scenario:
    from sapopt.domains.constellation import STARLINK_SHELLS_2019
    from sapopt.domains.power import power_constellation

    return power_constellation(STARLINK_SHELLS_2019, tasks, steps, seed, earth=earth, pay_for=pay_for)


@register(
    "attitude",
    "constellation-mid where a move costs by its slew angle (0.5 per radian), 324 idle tasks; Holder 2024, 7.1.1",
    (93, 324, 774),
)
def _attitude(
    seed: int,
    steps: int = 93,
    tasks: int = 450,
    planes: int = 18,
    per_plane: int = 18,
    altitude_km: float = 550.0,
) -> Scenario:
    from sapopt.domains import constellation as c
    from sapopt.domains.attitude import Attitude

    shell = c.WalkerShell(planes, per_plane, 58.0, altitude_km)
    return Attitude(c.walker_constellation(shell, c.random_tasks(tasks, seed), steps, earth="still"))


@register(
    "ride-hailing",
    "100 drivers, 600 requests in a city of 10 x 10 crossings, 60 steps of 2 minutes; Holder 2024, 7.1.2",
    (60, 100, 700),
)
def _ride_hailing(
    seed: int, drivers: int = 100, requests: int = 600, steps: int = 60, width: int = 10, patience: int = 4
) -> Scenario:
    from sapopt.domains.ride_hailing import random_city

    return random_city(drivers, requests, steps, seed, width=width, patience=patience)


@register(
    "unit-commitment",
    "40 power stations, demand in 40 blocks, two days by the hour; cost is a factor on start-up; Holder 2024, 7.1.3",
    (48, 40, 120),
    cost=1.0,
)
def _unit_commitment(seed: int, units: int = 40, steps: int = 48, shut_down: float = 0.0) -> Scenario:
    from sapopt.domains.unit_commitment import random_power_system

    return random_power_system(units, steps, seed, shut_down=shut_down)


@register(
    "multi-beam",
    "36 satellites with 10 beams each (6 x 6 at 58 deg, 550 km), 1200 random tasks on the whole Earth, 93 minutes",
    (93, 360, 1560),
)
def _multi_beam(
    seed: int, steps: int = 93, tasks: int = 1200, beams: int = 10, decay: float = 0.9
) -> Scenario:
    from sapopt.domains.multibeam import multi_beam

    return multi_beam(seed, steps=steps, tasks=tasks, beams=beams, decay=decay)


@register(
    "tracking",
    "satellites that track objects over 633 hexagons of the US, 2 observers each, 93 minutes; after Holder 2024, 4.3",
    (93, 575, 1841),
    cost=0.0,
)
def _tracking(
    seed: int,
    steps: int = 93,
    planes: int = 40,
    per_plane: int = 25,
    resolution: int = 3,
    arrivals: float = 0.6,
) -> Scenario:
    from sapopt.domains.constellation import WalkerShell
    from sapopt.domains.tracking import tracking

    return tracking(
        seed,
        steps=steps,
        shell=WalkerShell(planes, per_plane, 58.0, 550.0),
        resolution=resolution,
        arrivals_per_step=arrivals,
    )


@register(
    "multi-beam-us",
    "satellites (12 x 12 at 58 deg) that pass the US, 10 beams each, 633 tasks over the US; Holder 2024, 4.4",
    (93, 840, 1473),
)
def _multi_beam_us(seed: int, steps: int = 93, beams: int = 10, decay: float = 0.9) -> Scenario:
    from sapopt.domains.multibeam import multi_beam_us

    return multi_beam_us(seed, steps=steps, beams=beams, decay=decay)


@register(
    "tracking-thesis",
    "tracking by the numbers of Holder 2024, 4.3: beta_e = 1, beta_t = 10, targets along the grid, eq. 4.3 alone",
    (93, 575, 1841),
    cost=0.0,
)
def _tracking_thesis(
    seed: int,
    steps: int = 93,
    planes: int = 40,
    per_plane: int = 25,
    resolution: int = 3,
    arrivals: float = 0.6,
) -> Scenario:
    from sapopt.domains.constellation import WalkerShell
    from sapopt.domains.tracking import tracking_thesis

    return tracking_thesis(
        seed,
        steps=steps,
        shell=WalkerShell(planes, per_plane, 58.0, 550.0),
        resolution=resolution,
        arrivals_per_step=arrivals,
    )


@register(
    "interference",
    "constellation-mid, where two tasks closer than 600 km lose up to 0.8 if both are served; Holder 2024, 7.2",
    (93, 324, 450),
)
def _interference(
    seed: int, steps: int = 93, tasks: int = 450, planes: int = 18, per_plane: int = 18, strength: float = 0.8
) -> Scenario:
    from sapopt.domains import constellation as c
    from sapopt.domains.interference import DisturbedBeams

    ground = c.random_tasks(tasks, seed)
    shell = c.WalkerShell(planes, per_plane, 58.0, 550.0)
    return DisturbedBeams(c.walker_constellation(shell, ground, steps, earth="still"), strength=strength)
