"""The commands `eldir benchmark ...`: measurements of the engine, each as a JSON file and a plot."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer

from eldir_app.options import Device, select_device

benchmark = typer.Typer(
    help="Measure the engine; each command prints tables with a verdict, and writes a JSON file and a plot."
)

Out = Annotated[Path, typer.Option(metavar="DIR", help="New folder for the JSON file and the plot.")]
Quick = Annotated[bool, typer.Option("--quick", help="Use fewer robots and repetitions: under five minutes.")]


@benchmark.callback()
def _group() -> None:
    """Measure the engine; each command prints tables with a verdict, and writes a JSON file and a plot.

    Example: eldir benchmark speed --quick --out speed
    """


@benchmark.command()
def speed(*, out: Out, quick: Quick = False, device: Device = None) -> None:
    """Measure how fast robots learn: throughput, time of each part, threads, precision, memory, first use.

    On a device: throughput over numbers of robots, and a generation of 10 000.

    Example: eldir benchmark speed --quick --out speed
    """
    from eldir.engine.device.process import chosen_device

    select_device(device)
    _measure("speed" if chosen_device() == "cpu" else "device", out, quick)


@benchmark.command()
def skips(*, out: Out, quick: Quick = False) -> None:
    """Measure the gain of each shortcut, and check that the result is the same without it.

    Example: eldir benchmark skips --quick --out skips
    """
    _measure("skips", out, quick)


@benchmark.command()
def accuracy(*, out: Out, quick: Quick = False) -> None:
    """Measure run time against error for each integrator, step and precision, and list the best settings.

    Example: eldir benchmark accuracy --quick --out accuracy
    """
    _measure("accuracy", out, quick)


@benchmark.command()
def stability(*, out: Out, quick: Quick = False) -> None:
    """Measure at which step simulations blow up, and compare with the predicted limit.

    Example: eldir benchmark stability --quick --out stability
    """
    _measure("stability", out, quick)


@benchmark.command()
def built(*, out: Out, quick: Quick = False) -> None:
    """Measure the time of a walk of the printed robot against the error of pins, soft strips and one cycle.

    With MuJoCo installed, also the time of a walk there and how far its walks differ.

    Example: eldir benchmark built --quick --out built
    """
    from eldir.core.files import require_new

    require_new(out)
    from eldir.benchmark.measurement import say

    others = {}
    if find_spec("mujoco") is None:
        say("MuJoCo is left out: pip install 'eldir[mujoco]'")
    else:
        from eldir_calibration.transfer.mujoco_walks import walk_given_robot
        from eldir_hardware.virtual.mujoco_body import mujoco_version

        others[f"{mujoco_version()}, 5 cycles"] = walk_given_robot
    _measure("built", out, quick, others=others)


def _measure(name: str, out: Path, quick: bool, **options: Any) -> None:
    """Measure, save the numbers and their plot, and print what they mean."""
    from eldir.benchmark.measurement import save, say
    from eldir.benchmark.other_programs import watch_other_programs
    from eldir.core.files import require_new

    require_new(out)
    benchmark = import_module(f"eldir.benchmark.{name}")
    with watch_other_programs() as others:
        values = benchmark.measure(quick, say, **options)
    save(out, name, values, benchmark.plot(values), others.share)
    typer.echo(f"{benchmark.describe(values)}\n{others.describe()}\n\n{out}/{name}.json and {out}/{name}.png")
