"""Built-in instances with limits: what planners must say (`sapopt.domains.instances` lists them with the others)."""

from __future__ import annotations

from sapopt.domains.registry import register
from sapopt.domains.scenario import Scenario


@register(
    "imaging",
    "12 satellites, 40 targets once each within their windows, one by two at a time, 3 stations; a day by the minute",
    (1440, 12, 43),
    cost=0.2,
)
def _imaging(
    seed: int,
    satellites: int = 12,
    targets: int = 40,
    steps: int = 1440,
    stations: int = 3,
    antennas: int = 2,
) -> Scenario:
    from sapopt.domains.imaging import imaging_day

    return imaging_day(
        seed, satellites=satellites, targets=targets, steps=steps, stations=stations, antennas=antennas
    )


@register(
    "nurse-roster",
    "20 nurses on 15 wards that need one at least, 28 days, days off, five days in a row at most, fair shares",
    (28, 20, 15),
    cost=0.1,
)
def _nurse_roster(
    seed: int, nurses: int = 20, wards: int = 15, days: int = 28, in_a_row: int = 5
) -> Scenario:
    from sapopt.domains.roster import random_roster

    return random_roster(nurses, wards, days, seed, in_a_row=in_a_row)


@register(
    "deep-space",
    "12 antennas at three sites, 60 requests for hours of tracking, six of them by two antennas; a week of half hours",
    (336, 12, 60),
    cost=0.0,
)
def _deep_space(
    seed: int, antennas: int = 12, requests: int = 60, steps: int = 336, arrays: int = 6
) -> Scenario:
    from sapopt.domains.deep_space import random_deep_space

    return random_deep_space(antennas, requests, steps, seed, arrays=arrays)


@register(
    "waiting-rides",
    "20 drivers, 120 requests that wait for six steps, each taken once, 40 steps of 2 minutes",
    (40, 20, 120),
)
def _waiting_rides(
    seed: int, drivers: int = 20, requests: int = 120, steps: int = 40, width: int = 8, patience: int = 6
) -> Scenario:
    from sapopt.domains.ride_hailing import random_waiting_city

    return random_waiting_city(drivers, requests, steps, seed, width=width, patience=patience)
