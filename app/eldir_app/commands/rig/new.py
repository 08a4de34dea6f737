"""The command `eldir rig new`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import InSeries
from eldir_hardware.relay.registration import kinds_text


def new(
    *,
    out: Annotated[Path, typer.Option(help="Rig file to write.")],
    board: Annotated[
        str, typer.Option(help=f"Kind of the relay board: {kinds_text()}; or virtual, for a virtual rig.")
    ] = "virtual",
    port: Annotated[
        str | None, typer.Option(help="Serial port of a real board, such as /dev/serial/by-path/...")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the virtual rig's deviations.")] = 1,
    design: Annotated[
        Path | None,
        typer.Option(help="Design file of the robot on the virtual rig."),
    ] = None,
    in_series: InSeries = False,
) -> None:
    """Write a commented rig file. The robot on a virtual rig is moved by MuJoCo where it is installed.

    Example: eldir rig new --board lcus --port /dev/ttyUSB0 --out rig.yaml
    """
    from eldir.core.files import require_new, write_text
    from eldir.errors import InputError
    from eldir_hardware.relay.registration import get_board
    from eldir_hardware.rig._board_hints import find_port_problem
    from eldir_hardware.rig.template import real_rig, virtual_rig
    from eldir_hardware.virtual.bodies import default_physics

    virtual = board == "virtual"
    if not virtual:
        get_board(board)
    if virtual == (port is not None):
        reason = "a virtual rig has no port" if virtual else "a real board needs a serial port"
        raise typer.BadParameter(reason, param_hint="--port")
    if port is not None and (problem := find_port_problem(port)):
        raise typer.BadParameter(
            f"{problem}: expected a serial port, such as /dev/serial/by-path/...", param_hint="--port"
        )
    # A rig file and its design may be moved together.
    named = None if design is None else os.path.relpath(design, out.parent)
    if named is not None and os.fsencode(named) != named.encode(errors="replace"):
        raise InputError(
            "a rig file cannot name this design", expected="a name in UTF-8", found=named, remedy="rename it"
        )
    require_new(out)
    if virtual:
        text = virtual_rig(seed, named, physics=default_physics(), in_series=in_series)
    else:
        text = real_rig(board, str(port), in_series=in_series)
    write_text(out, text)
    typer.echo(f"wrote {out}")
    if design is not None and not virtual:
        typer.echo("note: the file of a real rig names no design; eldir gait and eldir rig doctor take it")
    elif design is not None and not design.exists():
        typer.echo(f"note: {design} does not exist yet")
