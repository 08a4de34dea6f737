"""The commands `eldir benchmark ...`: the engine's figures, each as a JSON file and a plot."""

from __future__ import annotations

from importlib import import_module
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
    _write("speed", out, quick)


@benchmark.command()
def skips(*, out: Out, quick: Quick = False) -> None:
    """What is left out where a scene does not need it: each shortcut's gain, and that the long way agrees.

    Example: eldir benchmark skips --quick --out skips
    """
    _write("skips", out, quick)


@benchmark.command()
def accuracy(*, out: Out, quick: Quick = False) -> None:
    """Run time against error, for each integrator, step and precision, and which setting is worth its time.

    Example: eldir benchmark accuracy --quick --out accuracy
    """
    _write("accuracy", out, quick)


@benchmark.command()
def stability(*, out: Out, quick: Quick = False) -> None:
    """Where simulations blow up, and whether that was known before; extreme bodies; random robots that learn.

    Example: eldir benchmark stability --quick --out stability
    """
    _write("stability", out, quick)


def _write(name: str, out: Path, quick: bool) -> None:
    """Measure, and save the numbers and their plot."""
    from eldir.benchmark.result import save, say
    from eldir.core.files import require_new

    require_new(out)
    what = import_module(f"eldir.benchmark.{name}")
    values = what.measure(quick, say)
    save(out, name, values, what.plot(values))
    typer.echo(f"{out}/{name}.json and {out}/{name}.png")
