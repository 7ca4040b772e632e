"""The commands that train: ``sapopt train reda``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from sapopt.cli import show, work
from sapopt.cli.app import EXIT_INTERRUPTED, AsJson, Force, TimeLimit, app, check_time
from sapopt.cli.progress import Reporter
from sapopt.running.control import Run
from sapopt.solvers.names import nearest

train_app = typer.Typer(help="Train a learned policy.", no_args_is_help=True)
app.add_typer(train_app, name="train")

GUIDES = ("auto", "myopic", "power_constrained", "energy_price")


@train_app.command(name="reda")
def train_reda(
    instance: Annotated[
        str, typer.Argument(metavar="INSTANCE", help="A built-in name; every episode has a seed of its own.")
    ] = "power",
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR",
            help="Folder for checkpoint, log and weights; an ended run continues from it.",
        ),
    ] = Path("reda"),
    episodes: Annotated[int, typer.Option(help="Episodes to play.")] = 400,
    gradient_steps: Annotated[int, typer.Option(help="Gradient steps after every episode.")] = 20,
    stretches: Annotated[int, typer.Option(help="Stretches of episodes in a batch.")] = 2,
    stretch: Annotated[int, typer.Option(help="Steps, of all agents, in a stretch.")] = 10,
    trace: Annotated[float, typer.Option(help="Lambda of the returns along a stretch; 0: one step.")] = 0.9,
    discount: Annotated[float, typer.Option(help="Discount of later rewards.")] = 0.97,
    memory: Annotated[int, typer.Option(help="Episodes remembered.")] = 100,
    explore: Annotated[
        float, typer.Option(help="Share of the episodes over which exploration falls to 0.")
    ] = 0.6,
    noise: Annotated[float, typer.Option(help="Perturbation of the values, in parts of epsilon.")] = 0.1,
    standardise: Annotated[
        Literal["agent", "common", "none"], typer.Option(help="How rewards are brought to one scale.")
    ] = "common",
    guide: Annotated[
        str, typer.Option(help=f"Policy that guides exploration: {', '.join(GUIDES)}.")
    ] = "auto",
    evaluate_every: Annotated[int, typer.Option(help="Episodes between evaluations.")] = 20,
    evaluations: Annotated[int, typer.Option(help="Fresh episodes in every evaluation.")] = 2,
    threads: Annotated[
        int, typer.Option(min=1, help="Threads of torch; 1 gives the same weights anywhere.")
    ] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the run.")] = 0,
    time_limit: TimeLimit = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Train REDA (Algorithm 4 of Holder 2024) on fresh episodes of a built-in instance."""
    from sapopt import solvers
    from sapopt.domains.instances import find_instance
    from sapopt.domains.instances import instance as build

    find_instance(instance)
    check_time(time_limit)
    if guide not in GUIDES:
        raise ValueError(nearest(guide, GUIDES, "guide"))
    from sapopt import learning  # an ImportError here says which extra is missing

    weights = out / "weights.safetensors"
    if weights.exists() and not force:
        raise ValueError(f"{weights} exists already; give --force to train on, or another --out")
    first = build(instance, seed)
    has_charge = first.model.charge_of(first.initial_state()) is not None
    if guide == "auto":
        guide = "power_constrained" if has_charge else "myopic"
    options = learning.TrainOptions(
        episodes=episodes, gradient_steps=gradient_steps, stretches=stretches, stretch=stretch,
        trace=trace, discount=discount, memory=memory, explore=explore, noise=noise,
        standardise=standardise, evaluate_every=evaluate_every, evaluations=evaluations, threads=threads, seed=seed,
        spec=learning.ObservationSpec(charge=has_charge),
    )  # fmt: skip
    policy = solvers.AssignmentPolicy(getattr(solvers, guide))
    with Reporter() as reporter, work.watched(f"training REDA on {instance}", reporter) as (phase, callback):
        run = Run(time_limit=time_limit, callback=callback)
        training = learning.train(lambda s: build(instance, s), policy, options, out, run)
        phase.note = f"{training.episodes} episodes, best evaluation {training.value:,.1f}"
    report: dict[str, Any] = {
        "instance": instance,
        "options": asdict(options),
        "guide": guide,
        "episodes": training.episodes,
        "value": training.value,
        "seconds": run.seconds,
        "environment": show.environment(),
    }
    learning.save_network(training.network, weights, report)
    report["weights"] = str(weights)
    if as_json:
        show.print_json(report)
    else:
        print(f"{weights}: best of the evaluations {training.value:,.1f}, after {training.episodes} episodes")
    if run.stopped:
        raise typer.Exit(EXIT_INTERRUPTED)
