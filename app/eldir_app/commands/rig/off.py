"""The command `eldir rig off`: the emergency stop."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_hardware.relay.registration import kinds_text


def off(
    rig_file: Annotated[
        Path | None,
        typer.Option("--rig", help="The rig file. It may be damaged: its readable entries are used."),
    ] = None,
    port: Annotated[str | None, typer.Option(help="Serial port of the board, instead of the file's.")] = None,
    board: Annotated[
        str | None,
        typer.Option(help=f"Kind of the relay board, if it is not in the rig file: {kinds_text()}."),
    ] = None,
) -> None:
    """Emergency stop: stop the program that heats, open every contact, and verify it by read-back.

    Without a file or a port: every port that this computer drives. No program can heat there until you run
    `eldir rig reset`.

    Example: eldir rig off --rig rig.yaml
    """
    from eldir_app.emergency_stop import run_off

    run_off(rig_file, port, board)
