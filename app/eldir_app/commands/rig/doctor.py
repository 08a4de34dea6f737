"""The command `eldir rig doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import RigFile, load_real_rig


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

    from eldir_app.doctor import examine
    from eldir_app.switching_checks import show_wiring
    from eldir_hardware.rig.configuration import Rig

    if pulses:
        if not heat_disconnected:
            raise typer.BadParameter(
                "disconnect the heating supply, then add --heat-disconnected", param_hint="--pulses"
            )
        _measure_retriggerable(rig_file)
    rig = Rig.load(rig_file)
    findings = examine(rig, rig_file.parent, camera, calibration or (), packet)
    if as_json:
        typer.echo(json.dumps([f._asdict() for f in findings], indent=1))
    else:
        for finding in findings:
            typer.echo(f"{'ok  ' if finding.ok else 'FAIL'}  {finding.subject}: {finding.text}")
    if not all(f.ok for f in findings):
        raise typer.Exit(1)
    if wiring:
        show_wiring(rig, rig_file, design, lambda text: typer.echo(text, err=True))


def _measure_retriggerable(rig_file: Path) -> None:
    """Measure whether a second pulse restarts the board's timer, and write it into the rig file."""
    from eldir.core.files import write_text
    from eldir.core.yaml_files import with_entries
    from eldir_app.switching_checks import measure_retriggerable
    from eldir_hardware.clock import WallClock
    from eldir_hardware.rig.devices import open_board

    rig, _ = load_real_rig(rig_file)
    clock = WallClock()
    with open_board(rig, clock) as board:
        restarts = measure_retriggerable(board, clock, rig.channels[0].channel)
    write_text(rig_file, with_entries(rig_file.read_text(), "board", {"retriggerable": restarts}))
    typer.echo(
        f"a second pulse {'restarts the timer' if restarts else 'is ignored'}; "
        f"wrote retriggerable into {rig_file}"
    )
