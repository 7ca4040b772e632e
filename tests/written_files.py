"""Every kind of file that the library, the command line and the experiments write, by the name of the file."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from experiments.common import Run as Experiment
from sapopt import SAP, bound, certify, solve
from sapopt.cli.output import Output, figure
from sapopt.data.files import write_arrays
from sapopt.domains.instances import scenario
from sapopt.exchange import write_csv, write_czml, write_excel, write_geojson, write_json, write_parquet
from sapopt.formulations import qap
from sapopt.learning.checkpoint import Checkpoint, save_checkpoint
from sapopt.learning.logs import TrainingLog
from sapopt.learning.network import new_network, save_network
from sapopt.learning.observation import ObservationSpec
from sapopt.learning.resume import Standing
from sapopt.live import Session
from sapopt.report import report
from sapopt.solvers import HAA
from sapopt.solvers.charge_value import ChargeValue
from sapopt.sweeps.engine import Job, _write

PROBLEM = SAP(np.random.default_rng(0).random((40, 6, 9)), 0.4)
JOB = Job("a job", {"x": 1})
NETWORK = new_network(ObservationSpec(2, 1, 1, charge=False), 0)
LARGE = [1.5] * 9000


def save_png(path: Path) -> None:
    """A figure by the way of the command line."""
    Output(path.parent, [], force=True).png(path.name, figure(4.0, 3.0)[0])


def save_log(path: Path) -> None:
    """The log of a training, which chooses its name itself."""
    with TrainingLog(path.parent) as log:
        for episode in range(500):
            log.write({"episode": episode, "steps": 0, "value": 0.5})


def save_checkpoints(path: Path) -> None:
    """Where a training of REDA stands."""
    adam = torch.optim.Adam(NETWORK.parameters())
    networks = (NETWORK, copy.deepcopy(NETWORK), copy.deepcopy(NETWORK))
    save_checkpoint(path, Checkpoint(*networks, 1.0, adam, 3, 4, {}, []), {"seed": 0})


def experiment(path: Path) -> Experiment:
    """A run of an experiment that writes beside `path`."""
    return Experiment(path.stem, argparse.Namespace(out=path.parent), (0,), began=0.0)


def written() -> dict[str, Callable[[Path], Any]]:
    """Writers by the name of their file; each takes the whole path."""
    result = solve(PROBLEM, HAA())
    proven = bound(PROBLEM)
    session = Session(HAA(), 0.4, idle=True)
    benefits = np.random.default_rng(1).random((1, 60, 80))
    session.step(benefits, agents=[f"agent {i}" for i in range(60)], tasks=[f"task {j}" for j in range(80)])
    earth = scenario("constellation-toy", steps=2)
    toy = earth, solve(earth.problem(), HAA())
    certificate = certify(PROBLEM, result.with_bound(proven.value, proven.prices))
    return {
        "problem": PROBLEM.save,
        "result": result.save,
        "certificate": certificate.save,
        "prices": lambda path: write_arrays(path, {"prices": proven.prices}),
        "json": lambda path: Output(path.parent, [], force=True).json(path.name, {"trace": LARGE}),
        "figure": save_png,
        "page": lambda path: report(PROBLEM, result, path, force=True),
        "table": ChargeValue.load("power").save,
        "plan.csv": lambda path: write_csv(result, path),
        "plan.xlsx": lambda path: write_excel(result, path),
        "plan.parquet": lambda path: write_parquet(result, path),
        "plan.json": lambda path: write_json(result, path),
        "plan.geojson": lambda path: write_geojson(toy[1], path, toy[0]),
        "plan.czml": lambda path: write_czml(toy[1], path, toy[0]),
        "p.lp": lambda path: PROBLEM.write(path),
        "p.mps": lambda path: PROBLEM.write(path),
        "session": session.save,
        "qap": qap.formulate(SAP(np.ones((3, 5, 5)), 0.4)).write_qaplib,
        "weights": lambda path: save_network(NETWORK, path),
        "checkpoint": save_checkpoints,
        "standing": lambda path: Standing(path, {}, {"actor": NETWORK}, {}).save({}),
        "log.csv": save_log,
        f"{JOB.key}.json": lambda path: _write(path.parent, JOB, {"trace": LARGE}, 1.0),
        "experiment.json": lambda path: experiment(path).write_json({"values": LARGE}),
        "experiment.png": lambda path: experiment(path).write_figure(figure(4.0, 3.0)[0]),
    }


KINDS = (
    "problem", "result", "certificate", "prices", "json", "figure", "page", "table", "plan.csv", "plan.xlsx",
    "plan.parquet", "plan.json", "plan.geojson", "plan.czml",
    "p.lp", "p.mps", "session", "qap", "weights", "checkpoint", "standing", "log.csv",
    f"{JOB.key}.json", "experiment.json", "experiment.png",
)  # fmt: skip
