"""Damaged and forged files: every one is read as it was, or refused by a ValueError with its path."""

from __future__ import annotations

import gzip
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sapopt import SAP, CertificateError, Result, SwitchingCost, certify, solve, verify
from sapopt.domains.constellation import read_elements
from sapopt.domains.ride_hailing import read_trips
from sapopt.formulations.qap import read_qaplib, read_qaplib_solution
from sapopt.proofs.certificate import Certificate
from sapopt.solvers import HAA
from sapopt.solvers.charge_value import ChargeValue

OMM = {
    "OBJECT_NAME": "BEACON", "EPOCH": "2020-064T10:34:41.4264", "MEAN_MOTION": "15.27990594", "ECCENTRICITY": ".001",
    "INCLINATION": "97.2970", "RA_OF_ASC_NODE": "66.7438", "ARG_OF_PERICENTER": "109.4976",
    "MEAN_ANOMALY": "15.7307", "NORAD_CAT_ID": "799500123", "BSTAR": ".83483E-4",
}  # fmt: skip
TRIPS = (
    "pickup_datetime,dropoff_datetime,pickup_longitude,pickup_latitude,dropoff_longitude,dropoff_latitude,fare\n"
    + '"2018-02-09 23:55:00",2018-02-10 00:15:00,-73.99,40.73,-73.97,40.76,9.5\n' * 6
)
PROBLEM = SAP(np.random.default_rng(1).random((5, 3, 4)), SwitchingCost(0.3), agents=["a", "b", "ü"])


def files(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    """A good file of each kind, and what reads it; npz readers return what must not change."""
    folder.mkdir()
    tags = "".join(f"<{k}>{v}</{k}>" for k, v in OMM.items())
    texts = {
        "omm.kvn": "".join(f"{k} = {v}\n" for k, v in OMM.items()),
        "omm.json": json.dumps([OMM, OMM | {"NORAD_CAT_ID": "2"}]),
        "omm.csv": ",".join(OMM) + "\n" + ",".join(OMM.values()) + "\n",
        "omm.xml": f"<omm><body><segment>{tags}</segment></body></omm>",
        "trips.csv": TRIPS, "x.dat": "3 9\n1 2 3 4 5 6 7 8 9\n9 8 7 6 5 4 3 2 1\n", "x.sln": "3 9\n2 3 1\n",
    }  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "trips.csv.gz").write_bytes(gzip.compress(TRIPS.encode()))
    PROBLEM.save(folder / "problem.npz")
    result = solve(PROBLEM, HAA())
    result.save(folder / "result.npz")
    certify(PROBLEM, result).save(folder / "certificate.npz")
    ChargeValue(np.arange(6.0).reshape(2, 3), "by hand").save(folder / "value.json")
    readers: dict[str, Callable[[Path], Any]] = {
        "omm.kvn": read_elements, "omm.json": read_elements, "omm.csv": read_elements, "omm.xml": read_elements,
        "trips.csv": read_trips, "trips.csv.gz": read_trips, "x.dat": read_qaplib, "x.sln": read_qaplib_solution,
        "value.json": ChargeValue.load, "problem.npz": lambda path: SAP.load(path).fingerprint,
        "result.npz": lambda path: (Result.load(path).value, Result.load(path).plan.tolist()),
        "certificate.npz": lambda path: verify(path, PROBLEM).value,
    }  # fmt: skip
    return {name: (folder / name, reader) for name, reader in readers.items()}


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """One byte changed, or a piece cut out, doubled, blanked, replaced; or the end cut off."""
    at = int(rng.integers(len(data)))
    end = min(len(data), at + int(rng.integers(1, 40)))
    noise = rng.integers(0, 256, end - at, dtype=np.uint8).tobytes()
    choice = int(rng.integers(6))
    if choice == 0:
        return data[:at] + bytes([data[at] ^ int(rng.integers(1, 256))]) + data[at + 1 :]
    return (
        data[:at], data[:at] + data[end:], data[:end] + data[at:], data[:at] + b"\0" * (end - at) + data[end:],
        data[:at] + noise + data[end:],
    )[choice - 1]  # fmt: skip


def attack(count: int, seed: int, folder: Path) -> Counter[str]:
    """Damage files of all kinds; what is accepted from a checked format must be what was written."""
    rng = np.random.default_rng(seed)
    counts: Counter[str] = Counter()
    kinds = files(folder)
    names = sorted(kinds)
    good = {name: reader(path) for name, (path, reader) in kinds.items()}
    data = {name: path.read_bytes() for name, (path, _) in kinds.items()}
    for number in range(count):
        name = names[number % len(names)]
        path, reader = kinds[name]
        path.write_bytes(damaged(rng, data[name]))
        try:
            read = reader(path)
        except ValueError as error:
            assert isinstance(error, CertificateError) or name in str(error)  # noqa: PT017
            counts["refused"] += 1
        else:
            counts["read"] += 1
            if name.endswith(".npz"):
                assert read == good[name], f"{name}: accepted, and changed"
    return counts


def forgeries(certificate: Certificate, rng: np.random.Generator) -> Certificate:
    """A certificate that claims more than it proves."""
    size = abs(certificate.bound)
    much = size * 10.0 ** rng.uniform(-6, 6)
    choice = int(rng.integers(4))
    if choice == 0:
        return replace(certificate, value=certificate.value + much)
    if choice == 1:
        return replace(certificate, bound=certificate.value - much)
    if choice == 2:
        prices = certificate.prices.copy()
        prices[tuple(rng.integers(0, s) for s in prices.shape)] = rng.choice([-1.0, np.nan, np.inf, -1e300])
        return replace(certificate, prices=prices)
    plan = certificate.plan.copy()
    plan[tuple(rng.integers(0, s) for s in plan.shape)] = rng.choice([-1, 99, 2**62])
    return replace(certificate, plan=plan)


def forge(count: int, seed: int) -> None:
    """No forged certificate is accepted, at any scale."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        scale = float(10.0 ** rng.uniform(-3, 6))
        problem = SAP(scale * rng.random((4, 2, 3)), SwitchingCost(0.3 * scale))
        certificate = certify(problem, solve(problem, HAA()))
        verify(certificate, problem)
        forged = forgeries(certificate, rng)
        with pytest.raises(CertificateError):
            verify(forged, problem)


def test_quick(tmp_path: Path) -> None:
    """Some damaged files of each kind, some forged certificates."""
    counts = attack(360, 0, tmp_path / "files")
    print(dict(counts))
    assert counts["refused"] > 100
    forge(25, 0)


@pytest.mark.slow
def test_many_damaged(tmp_path: Path) -> None:
    """Six thousand damaged files."""
    print(dict(attack(6000, 1, tmp_path / "files")))


@pytest.mark.slow
def test_many_forged() -> None:
    """Three hundred forged certificates."""
    forge(300, 1)
