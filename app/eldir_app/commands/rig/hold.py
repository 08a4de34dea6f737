"""The command `eldir rig hold`."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from eldir_app.options import DesignFile, ScheduleOutput, ScheduleRigFile


def hold(
    design: DesignFile,
    rig_file: ScheduleRigFile,
    power: Annotated[float, typer.Option(help="Part of the full power, between 0 and 1.")],
    out: ScheduleOutput,
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
    from eldir_hardware.planning.compiler import describe_precision
    from eldir_hardware.planning.hold import describe_hold, hold_schedule
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.supply import find_implausible_springs

    require_new(out)
    rig, design_file = Rig.load(rig_file), os.path.relpath(design, out.parent)
    schedule = hold_schedule(Design.load(design), rig, power, seconds, spring or (), design_file)
    schedule.save(out)
    held, early_cutoff = describe_hold(schedule, rig)
    for warning in (*find_implausible_springs(rig).values(), early_cutoff):
        if warning:
            typer.echo(f"warning: {warning}", err=True)
    if note := describe_precision(schedule, rig):
        typer.echo(f"note: {note}")
    typer.echo(held)
    pulse = max(p.length for p in schedule.pulses())
    typer.echo(
        f"wrote {out}: pulses of {pulse:.3g} s every {schedule.period_s:.3g} s, {schedule.cycles} times"
    )
