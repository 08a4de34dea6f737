"""The commands `eldir benchmark ...`: the engine's figures, each as a JSON file and a plot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

benchmark = typer.Typer(help="Measure the engine; each command writes a JSON file and a plot.")

Out = Annotated[Path, typer.Option(metavar="DIR", help="New folder for the JSON file and the plot.")]
Quick = Annotated[bool, typer.Option("--quick", help="Fewer robots and turns: under five minutes.")]


@benchmark.callback()
def _group() -> None:
    """Measure the engine; each command writes a JSON file and a plot.

    Example: eldir benchmark speed --quick --out speed
    """


@benchmark.command()
def speed(*, out: Out, quick: Quick = False) -> None:
    """How fast robots learn: throughput, what its parts cost, threads, precision, memory, first use.

    Example: eldir benchmark speed --quick --out speed
    """
    from eldir.benchmark.result import save, say
    from eldir.benchmark.speed import measure, plot

    values = measure(quick, say)
    save(out, "speed", values, plot(values))
    typer.echo(f"{out}/speed.json and {out}/speed.png")


@benchmark.command()
def skips(*, out: Out, quick: Quick = False) -> None:
    """What is left out where a scene does not need it: each shortcut's gain, and that the long way agrees.

    Example: eldir benchmark skips --quick --out skips
    """
    from eldir.benchmark.result import save, say
    from eldir.benchmark.skips import measure, plot

    values = measure(quick, say)
    save(out, "skips", values, plot(values))
    typer.echo(f"{out}/skips.json and {out}/skips.png")


@benchmark.command()
def accuracy(*, out: Out, quick: Quick = False) -> None:
    """Run time against error, for each integrator, step and precision, and which setting is worth its time.

    Example: eldir benchmark accuracy --quick --out accuracy
    """
    from eldir.benchmark.accuracy import measure, plot
    from eldir.benchmark.result import save, say

    values = measure(quick, say)
    save(out, "accuracy", values, plot(values))
    typer.echo(f"{out}/accuracy.json and {out}/accuracy.png")


@benchmark.command()
def stability(*, out: Out, quick: Quick = False) -> None:
    """Where simulations blow up, and whether that was known before; extreme bodies; random robots that learn.

    Example: eldir benchmark stability --quick --out stability
    """
    from eldir.benchmark.result import save, say
    from eldir.benchmark.stability import measure, plot

    values = measure(quick, say)
    save(out, "stability", values, plot(values))
    typer.echo(f"{out}/stability.json and {out}/stability.png")
