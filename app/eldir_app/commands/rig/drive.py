"""The command `eldir rig drive`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.options import RigFile

if TYPE_CHECKING:
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.run.drive import DriveConfig
    from eldir_hardware.run.player import Player, RunResult
    from eldir_hardware.run.room import MeasuredRoom
    from eldir_hardware.schedule import ActuationSchedule


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
            "--dry-run",
            help="Rehearse on an emulated board in virtual time. No real contact is switched, and the log is "
            "marked as a rehearsal.",
        ),
    ] = False,
    room: Annotated[
        float | None,
        typer.Option(
            help="Temperature of the air around the springs, measured before the run [C]. It is written into "
            "the log, and `eldir report` predicts with it. Default: what the rig's thermometer shows."
        ),
    ] = None,
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
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.run.drive import DriveConfig, to_dry_run
    from eldir_hardware.safety.latch import require_unlatched
    from eldir_hardware.schedule import ActuationSchedule

    require_ending("--log", log, ".mcap")
    require_new(log)
    heating, rig = ActuationSchedule.load(schedule), Rig.load(rig_file)
    if design is None and rig.virtual.design is None and heating.provenance.design is not None:
        design = schedule.parent / heating.provenance.design
    print_notes(heating, rig, rig_file, design)
    driven = to_dry_run(rig) if dry_run else rig
    if driven.kind == "virtual" and driven.thermometer is None and room is None and not dry_run:
        from eldir_hardware.virtual.rig import thermometer_reading

        shown = thermometer_reading(driven)
        typer.echo(f"note: a thermometer at this virtual rig shows {shown:.1f} C; see --room")
    if driven.kind == "real" and driven.board.port is not None:
        require_unlatched(driven.board.port)  # a run that cannot start leaves no log
    played = play(heating, driven, rig_file, log, DriveConfig(design, accept_mismatch, dry_run, room))
    kind = "a rehearsal on an emulated board, " if dry_run else ""
    typer.echo(
        f"wrote {log}: {kind}{played.duration_s:.0f} s, highest modelled temperature {played.peak_c:.1f} C, "
        f"latest switching {1e3 * played.max_delay_s:.0f} ms late"
    )
    if played.impossible_motion:
        typer.echo(f"warning: not possible in reality: {played.impossible_motion}", err=True)


def print_notes(schedule: ActuationSchedule, rig: Rig, rig_file: Path, design: Path | None) -> None:
    """Print what is unusual about the timing, the springs and the wiring."""
    from eldir_hardware.planning.compiler import describe_precision
    from eldir_hardware.rig.supply import find_implausible_springs
    from eldir_hardware.run.drive import count_motors, find_design
    from eldir_hardware.safety.compatibility import compare_wiring, packet_wiring

    if note := describe_precision(schedule, rig):
        typer.echo(f"note: {note}")
    for warning in find_implausible_springs(rig).values():
        typer.echo(f"warning: {warning}", err=True)
    packet = packet_wiring(find_design(rig, rig_file, design), count_motors(schedule, rig), rig)
    if note := compare_wiring(rig, packet):
        typer.echo(f"note: not wired as {packet.source} says: {note}")


def play(
    schedule: ActuationSchedule,
    rig: Rig,
    rig_file: Path,
    log: Path,
    config: DriveConfig,
) -> RunResult:
    """Play the schedule with a progress bar, keys, commands from other programs, and notifications."""
    from eldir_app.notifications import notifications
    from eldir_app.progress import progress_bar
    from eldir_hardware.run.drive import drive_rig
    from eldir_hardware.run.remote_control import obey_commands, obey_keys
    from eldir_hardware.safety.stop_signals import signals_as_errors

    @contextmanager
    def steer(player: Player) -> Iterator[None]:
        with obey_keys(player), obey_commands(player):
            yield

    def on_room(room: MeasuredRoom) -> None:
        if room.is_doubtful:
            typer.echo(f"warning: {room.text}", err=True)
        elif config.room_c is None and room.text:
            typer.echo(f"note: {room.text}")

    def on_rest(seconds: float) -> None:
        typer.echo(
            f"note: the springs cool down from the last run: the schedule starts in {seconds:.0f} s",
            err=True,
        )

    with signals_as_errors(), notifications(rig, log), progress_bar() as progress:
        task = progress.add_task("driving", total=schedule.duration)
        return drive_rig(
            schedule,
            rig,
            rig_file,
            log,
            replace(
                config,
                on_time=lambda t: progress.update(task, completed=t),
                on_room=on_room,
                on_rest=on_rest,
                control=steer,
            ),
        )
