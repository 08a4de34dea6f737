"""`eldir rig`: write a rig file, check the rig, play a schedule, emulate a board."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from hardware.commands.emergency import RigFile, off, real_rig_and_port, reset
from hardware.commands.gait import hold
from hardware.relay.registration import kinds

rig = typer.Typer(no_args_is_help=True, help="Drive the physical or the virtual rig.")

_KINDS = " | ".join(kinds())


@rig.command()
def new(
    *,
    out: Annotated[Path, typer.Option(help="Rig file to write.")],
    board: Annotated[
        str, typer.Option(help=f"Kind of the relay board: {_KINDS}; or virtual, for a virtual rig.")
    ] = "virtual",
    port: Annotated[
        str | None, typer.Option(help="Serial port of a real board, such as /dev/serial/by-path/...")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the virtual rig's deviations.")] = 1,
    design: Annotated[
        str | None,
        typer.Option(
            help="Design file of the robot on the virtual rig. The path is relative to the rig file."
        ),
    ] = None,
) -> None:
    """Write a commented rig file. The robot on a virtual rig is moved by MuJoCo where it is installed.

    Example: eldir rig new --board lcus --port /dev/ttyUSB0 --out rig.yaml
    """
    from eldir.core.files import require_new, write_text
    from eldir.errors import InputError
    from hardware.relay.registration import board_of
    from hardware.rig.template import real_rig, virtual_rig
    from hardware.rig.told import port_problem
    from hardware.virtual.bodies import best_physics

    virtual = board == "virtual"
    if not virtual:
        board_of(board)
    if virtual == (port is not None):
        problem = "a virtual rig has no port" if virtual else "a real board needs its port"
        raise typer.BadParameter(problem, param_hint="--port")
    if port is not None and (no_port := port_problem(port)):
        raise typer.BadParameter(
            f"{no_port}: expected a serial port, such as /dev/serial/by-path/...", param_hint="--port"
        )
    if design is not None and os.fsencode(design) != design.encode(errors="replace"):
        raise InputError(
            "a rig file cannot name this design", expected="a name in UTF-8", found=design, remedy="rename it"
        )
    require_new(out)
    text = virtual_rig(seed, design, physics=best_physics()) if virtual else real_rig(board, str(port))
    write_text(out, text)
    typer.echo(f"wrote {out}")
    if design is not None and not (out.parent / design).exists():
        typer.echo(f"note: {out.parent / design} does not exist yet; a rig file names it as seen from there")


rig.command()(hold)
rig.command()(off)
rig.command()(reset)


@rig.command()
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
    from eldir.commands.progress import bar
    from eldir.core.files import require_ending, require_new
    from hardware.notify.start import words_of
    from hardware.planning.precision import remark
    from hardware.rig.configuration import Rig
    from hardware.rig.packet_wiring import packet_of, wiring_note
    from hardware.rig.supply import implausible_springs
    from hardware.run.drive import drive_rig, motors_of, robot_file, without_heat
    from hardware.run.keys import keys
    from hardware.run.orders import orders
    from hardware.run.player import Player
    from hardware.safety.latch import require_unlatched
    from hardware.safety.stop_signals import signals_as_errors
    from hardware.schedule import ActuationSchedule

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
        words_of(driven, log),
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


@rig.command()
def watch(
    rig_file: Annotated[
        Path | None, typer.Option("--rig", help="The rig file. Default: whatever this computer drives.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Show this log: a finished one, or one that is being written.")
    ] = None,
    listen: Annotated[
        str, typer.Option(help="Address and port. Any address but this computer's own needs a token.")
    ] = "127.0.0.1:8642",
    host: Annotated[
        list[str] | None, typer.Option(help="Name by which browsers call this computer, besides its own.")
    ] = None,
    stop_without_token: Annotated[
        bool, typer.Option("--stop-without-token", help="Whoever opens the page may stop, without the token.")
    ] = False,
    allow_start: Annotated[
        Path | None,
        typer.Option(help="Schedule that whoever has the token may start from the page. It heats the rig."),
    ] = None,
    foxglove: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Port of a live connection for Foxglove on this computer: 8765 is what it expects.",
        ),
    ] = None,
) -> None:
    """Show a run in a browser: camera, temperatures, contacts, and a button that stops the heating.

    The page only looks: the run does not depend on it.

    Example: eldir rig watch --rig rig.yaml
    """
    from hardware.watch.listen import watch as watch_rig

    watch_rig(rig_file, log, listen, host or (), stop_without_token, allow_start, foxglove, typer.echo)


@rig.command()
def emulate(
    board: Annotated[str, typer.Option(help=f"Kind of the relay board: {_KINDS}.")] = "lcus",
    trace: Annotated[
        Path | None, typer.Option(help="Write every switching of a contact to this file (JSON lines).")
    ] = None,
    channels: Annotated[int, typer.Option(min=1, help="Number of relay channels.")] = 4,
) -> None:
    """Emulate a relay board on a pseudo-terminal until Ctrl-C. The first line printed is its port.

    Example: eldir rig emulate --board lcus --trace edges.jsonl
    """
    from hardware.emulator.serving import serve
    from hardware.relay.registration import board_of
    from hardware.rig.boards import emulator_of

    most = board_of(board).most_channels
    if channels > most:
        raise typer.BadParameter(f"a board of kind {board} has at most {most}", param_hint="--channels")
    serve(emulator_of(board), channels, trace, lambda port: print(port, flush=True))


@rig.command()
def doctor(
    rig_file: RigFile,
    *,
    camera: Annotated[
        str | None, typer.Option(help="Check this camera too: camera:0, or a video taken with it.")
    ] = None,
    calibration: Annotated[
        list[Path] | None, typer.Option(help="Check the age of this calibration file, such as camera.json.")
    ] = None,
    pulses: Annotated[
        bool,
        typer.Option(
            "--pulses",
            help="Measure whether a second pulse restarts the board's timer or is ignored, and write "
            "the result into the rig file. Disconnect the heating supply first.",
        ),
    ] = False,
    heat_disconnected: Annotated[
        bool,
        typer.Option("--heat-disconnected", help="Confirm that you have disconnected the heating supply."),
    ] = False,
    packet: Annotated[
        Path | None,
        typer.Option(help="Folder of the packet that the robot was built from: compare its wiring."),
    ] = None,
    wiring: Annotated[
        bool,
        typer.Option(
            "--wiring",
            help="Then warm each spring shortly, one after the other, and say which one must grow warm.",
        ),
    ] = False,
    design: Annotated[
        Path | None,
        typer.Option(help="With --wiring: design of the robot, to say where each spring is."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Check port, board, wiring, limits, clock and disk without heating. Each failure names a remedy.

    --wiring heats afterwards, if nothing failed: all limits of the rig hold, and Ctrl-C opens all contacts.

    Example: eldir rig doctor --rig rig.yaml --camera camera:0
    """
    import json

    from hardware.doctor.checks import examine
    from hardware.doctor.shown_wiring import show_wiring
    from hardware.rig.configuration import Rig

    if pulses:
        if not heat_disconnected:
            raise typer.BadParameter(
                "disconnect the heating supply, then add --heat-disconnected", param_hint="--pulses"
            )
        _measure_pulses(rig_file)
    loaded = Rig.load(rig_file)
    findings = examine(loaded, rig_file.parent, camera, calibration or (), packet)
    if as_json:
        typer.echo(json.dumps([f._asdict() for f in findings], indent=1))
    else:
        for finding in findings:
            typer.echo(f"{'ok  ' if finding.ok else 'FAIL'}  {finding.subject}: {finding.text}")
    if not all(f.ok for f in findings):
        raise typer.Exit(1)
    if wiring:
        show_wiring(loaded, rig_file, design, lambda text: typer.echo(text, err=True))


@rig.command()
def firmware(
    *,
    out: Annotated[Path, typer.Option(help="Folder to write.")],
    rig_file: Annotated[
        Path | None, typer.Option("--rig", help="Rig file whose limits the board is to keep.")
    ] = None,
) -> None:
    """Write the MOSFET board's firmware into a folder, to copy onto its microcontroller.

    Example: eldir rig firmware --rig rig.yaml --out firmware
    """
    from hardware.rig.configuration import Rig
    from hardware.rig.firmware_files import write_firmware

    write_firmware(out, None if rig_file is None else Rig.load(rig_file))
    typer.echo(f"wrote {out}; copy its files onto the board: docs/reference/mosfet-board.md")


def _measure_pulses(rig_file: Path) -> None:
    from eldir.core.files import write_text
    from eldir.core.yaml_files import with_entries
    from hardware.clock import WallClock
    from hardware.doctor.flash import measure_second_flash
    from hardware.rig.boards import open_board

    loaded, _ = real_rig_and_port(rig_file)
    clock = WallClock()
    with open_board(loaded, clock) as board:
        word = measure_second_flash(board, clock, loaded.channels[0].channel)
    write_text(rig_file, with_entries(rig_file.read_text(), "board", {"second_flash": word}))
    typer.echo(
        f"a second pulse {'restarts the timer' if word == 'restarts' else 'is ignored'}; "
        f"wrote second_flash into {rig_file}"
    )
