"""The command `eldir rig drive`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from eldir_app.terminal.rig_file import RigFile


def drive(
    schedule: Annotated[Path, typer.Argument(help="Heating schedule, from `eldir gait`.")],
    rig_file: RigFile,
    log: Annotated[Path, typer.Option(help="Log to write (MCAP).")],
    design: Annotated[
        Path | None,
        typer.Option(
            help="Design of the robot on a virtual rig. Default: the one in the rig file or the schedule."
        ),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="Play on an emulated board in virtual time. No real contact is switched."
        ),
    ] = False,
    accept_mismatch: Annotated[
        str,
        typer.Option(
            help="Reason for playing a schedule that was made for another design or other rig values, or was "
            "edited. It is written into the log. All limits are still checked."
        ),
    ] = "",
) -> None:
    """Play a heating schedule and record a log. All contacts are opened at the end and on any error.

    Keys on a terminal: space pauses and resumes, s plays one cycle, f ends after this cycle, x is the
    emergency stop.

    Example: eldir rig drive schedule.json --rig rig.yaml --log log.mcap
    """
    from eldir.core.files import require_ending, require_new
    from eldir_app.notify.start import notifications
    from eldir_app.terminal.progress import bar
    from eldir_hardware.planning.precision import remark
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.packet_wiring import packet_of, wiring_note
    from eldir_hardware.rig.supply import implausible_springs
    from eldir_hardware.run.drive import drive_rig, motors_of, robot_file, without_heat
    from eldir_hardware.run.orders import keys, orders
    from eldir_hardware.run.player import Player
    from eldir_hardware.safety.latch import require_unlatched
    from eldir_hardware.safety.stop_signals import signals_as_errors
    from eldir_hardware.schedule import ActuationSchedule

    @contextmanager
    def steer(player: Player) -> Iterator[None]:
        with keys(player), orders(player):
            yield

    def rest(seconds: float) -> None:
        typer.echo(
            f"note: the springs rest from the run before: the schedule begins in {seconds:.0f} s", err=True
        )

    require_ending("--log", log, ".mcap")
    require_new(log)
    plan, loaded = ActuationSchedule.load(schedule), Rig.load(rig_file)
    if note := remark(plan, loaded):
        typer.echo(f"note: {note}")
    for note in implausible_springs(loaded).values():
        typer.echo(f"warning: {note}", err=True)
    named = plan.provenance.design
    if design is None and loaded.virtual.design is None and named is not None:
        design = schedule.parent / named
    packet = packet_of(robot_file(loaded, rig_file, design), motors_of(plan, loaded))
    if note := wiring_note(loaded, packet):
        typer.echo(f"note: not wired as {packet.source} says: {note}")
    driven = without_heat(loaded) if dry_run else loaded
    if driven.kind == "real" and driven.board.port is not None:
        require_unlatched(driven.board.port)  # a run that cannot begin leaves no log
    with (
        signals_as_errors(),
        notifications(driven, log),
        bar() as progress,
    ):
        task = progress.add_task("driving", total=plan.duration)
        played = drive_rig(
            plan,
            driven,
            rig_file,
            log,
            design,
            lambda t: progress.update(task, completed=t),
            steer=steer,
            rest=rest,
            accept_mismatch=accept_mismatch,
        )
    typer.echo(
        f"wrote {log}: {played.duration_s:.0f} s, highest modelled temperature {played.peak_c:.1f} C, "
        f"latest switching {1e3 * played.latest_s:.0f} ms late"
    )
