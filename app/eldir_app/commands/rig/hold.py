"""The command `eldir rig hold`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer


def hold(
    design: Annotated[Path, typer.Argument(help="Design file.")],
    rig_file: Annotated[Path, typer.Option("--rig", help="Rig file: springs, supply, limits and channels.")],
    power: Annotated[float, typer.Option(help="Part of the full power, between 0 and 1.")],
    out: Annotated[Path, typer.Option(help="Schedule file to write, JSON.")],
    seconds: Annotated[float, typer.Option(help="How long to hold, in seconds.")] = 60.0,
    spring: Annotated[
        list[int] | None,
        typer.Option(help="Number of an active spring, from 0; may be repeated. Default: all."),
    ] = None,
) -> None:
    """Write a schedule that holds springs warm: pulses of half a second or longer that repeat.

    Every limit of the rig file holds, as for any schedule. The shorter its `min_off_s`, the steadier the
    temperature. Play the schedule with eldir rig drive.

    Example: eldir rig hold design.json --rig rig.yaml --power 0.3 --out hold.json
    """
    from eldir.core.files import require_new
    from eldir.design import Design
    from eldir_hardware.planning.hold import describe, hold_schedule
    from eldir_hardware.planning.precision import remark
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.supply import implausible_springs

    require_new(out)
    loaded, named = Rig.load(rig_file), os.path.relpath(design, out.parent)
    schedule = hold_schedule(Design.load(design), loaded, power, seconds, spring or (), named)
    schedule.save(out)
    for note in implausible_springs(loaded).values():
        typer.echo(f"warning: {note}", err=True)
    if note := remark(schedule, loaded):
        typer.echo(f"note: {note}")
    typer.echo(describe(schedule, loaded))
    pulse = max(p.length for p in schedule.pulses())
    typer.echo(
        f"wrote {out}: pulses of {pulse:.3g} s every {schedule.period_s:.3g} s, {schedule.cycles} times"
    )
