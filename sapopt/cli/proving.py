"""The commands that prove: ``bound``, ``certify`` and ``verify``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from sapopt import api as verbs
from sapopt.cli import links, show, work
from sapopt.cli.alongside import Helpers
from sapopt.cli.app import (
    DEFAULT_SOLVER,
    EXIT_INTERRUPTED,
    AsJson,
    Cost,
    Force,
    InstanceArgument,
    Lookahead,
    Out,
    RangeKm,
    Seed,
    TimeLimit,
    app,
    check_time,
)
from sapopt.cli.output import Output, check_new
from sapopt.cli.progress import Reporter
from sapopt.data.files import write_arrays
from sapopt.domains.instances import instances
from sapopt.problem.result import Status
from sapopt.problem.sap import SAP
from sapopt.proofs.certificate import Certificate
from sapopt.proofs.certificate import verify as verify_certificate
from sapopt.solvers.names import methods_help, parse_solver


@app.command(name="bound")
def bound(
    instance: InstanceArgument,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = None,
    as_json: AsJson = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Prove an upper bound of the value of every plan."""
    check_time(time_limit)
    work.check_instance(instance)
    output = Output(out, ["bound.json", "bound.npz"], force)
    with Reporter() as reporter:
        name, problem = work.load(instance, seed, cost, reporter)
        began = time.perf_counter()
        proven = work.prove_bound(problem, seed, time_limit, reporter)
        seconds = time.perf_counter() - began
    report = {
        **show.problem_record(name, problem),
        "bound": proven.value,
        "method": proven.method,
        "seconds": seconds,
        "seed": seed,
        "environment": show.environment(),
    }
    output.json("bound.json", report)
    if proven.prices is not None:
        prices = proven.prices
        output.npz("bound.npz", lambda path: write_arrays(path, {"prices": prices}))
    if as_json:
        show.print_json(report)
    else:
        print(f"{name}: no plan is worth more than {proven.value:,.4f} ({proven.method}, {seconds:.1f} s)")
        for path in output.written:
            print(f"wrote {path}")


@app.command(name="certify")
def certify(
    instance: InstanceArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="The certificate, an .npz file.")],
    solver: Annotated[str, typer.Option(help=f"One of: {methods_help()}.")] = DEFAULT_SOLVER,
    lookahead: Lookahead = None,
    seed: Seed = 0,
    cost: Cost = None,
    time_limit: TimeLimit = None,
    range_km: RangeKm = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Solve, prove a bound, and write plan and prices to a file that anyone can check with `sapopt verify`."""
    named = parse_solver(solver, lookahead)
    work.check_instance(instance)
    check_time(time_limit)
    links.check_range(range_km, [named])
    check_new(out, force)
    with Reporter() as reporter, Helpers() as helpers:
        name, problem, scenario = work.load_scenario(instance, seed, cost, reporter)
        (named,) = links.connect([named], scenario, range_km, reporter)
        work.warm_up(problem, [named], reporter, helpers)
        result = work.run_solver(problem, named, seed, time_limit, reporter)
        prices = result.prices
        if prices is None:
            prices = work.prove_bound(problem, seed, time_limit, reporter).prices
        with reporter.phase("certifying") as phase:
            certificate = verbs.certify(problem, result, prices=prices)
            certificate.save(out)
            phase.note = f"gap {100 * certificate.gap:.3f} %"
    _print(name, problem, certificate, as_json, f"wrote {out}")
    if result.status is Status.INTERRUPTED:
        raise typer.Exit(EXIT_INTERRUPTED)


@app.command(name="verify")
def verify(
    certificate: Annotated[
        Path, typer.Argument(metavar="CERTIFICATE", help="A file written by `sapopt certify`.")
    ],
    instance: Annotated[
        str | None,
        typer.Argument(
            metavar="[INSTANCE]",
            help="The problem; by default the built-in instances of that size are tried.",
        ),
    ] = None,
    seed: Seed = 0,
    cost: Cost = None,
    as_json: AsJson = False,
) -> None:
    """Compute value and bound of a certificate anew, from the definitions alone."""
    if not certificate.is_file():
        raise ValueError(f"there is no file {certificate}")
    claim = Certificate.load(certificate)
    names = [instance] if instance is not None else _instances_like(claim)
    for name in names:
        work.check_instance(name)
    with Reporter() as reporter:
        name, problem = _owner(claim, names, seed, cost, reporter)
        with reporter.phase("verifying") as phase:
            proven = verify_certificate(claim, problem)
            phase.note = f"value {proven.value:,.1f}  bound {proven.bound:,.1f}"
    _print(name, problem, proven, as_json, f"{certificate} holds: value and bound were computed anew")


def _instances_like(claim: Certificate) -> list[str]:
    """Built-in instances of the size of a certificate."""
    (steps, agents), columns = claim.plan.shape, claim.prices.shape[-1]
    sizes = (
        (steps, agents, columns),
        (steps, agents, columns - agents),
    )  # the second one for copies of agents
    names = [entry.name for entry in instances() if entry.shape in sizes]
    if not names:
        raise ValueError(
            "the certificate fits no built-in instance; name its problem: sapopt verify CERTIFICATE INSTANCE"
        )
    return names


def _owner(
    claim: Certificate, names: list[str], seed: int, cost: float | None, reporter: Reporter
) -> tuple[str, SAP]:
    """The first of the problems that the certificate is about; the last one tried if it is about none of them."""
    for name in names:
        label, problem = work.load(name, seed, cost, reporter)
        if problem.fingerprint == claim.fingerprint:
            break
    return label, problem


def _print(name: str, problem: SAP, certificate: Certificate, as_json: bool, line: str) -> None:
    if as_json:
        show.print_json(
            {
                **show.problem_record(name, problem),
                "value": certificate.value,
                "bound": certificate.bound,
                "gap": certificate.gap,
                "solver": certificate.solver,
                "environment": show.environment(),
            }
        )
        return
    print(f"{name}: the plan of {certificate.solver} is worth {certificate.value:,.4f}")
    print(
        f"no plan is worth more than {certificate.bound:,.4f}, so it is at most {100 * certificate.gap:.3f} % too low"
    )
    print(line)
