"""`eldir rig off` and `eldir rig reset`: the emergency stop, and its end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir.errors import InputError
from hardware.relay.registration import kinds

if TYPE_CHECKING:
    from hardware.rig.configuration import Rig

RigFile = Annotated[Path, typer.Option("--rig", help="The rig file.")]


def off(
    rig_file: Annotated[
        Path | None,
        typer.Option("--rig", help="The rig file. It may be damaged: what it still tells is used."),
    ] = None,
    port: Annotated[str | None, typer.Option(help="Serial port of the board, instead of the file's.")] = None,
    board: Annotated[
        str | None,
        typer.Option(help=f"Kind of the relay board, if nothing else tells it: {' | '.join(kinds())}."),
    ] = None,
) -> None:
    """Emergency stop: stop the program that heats, open every contact, and verify it by read-back.

    Without a file or a port: every port that this computer drives. No program can heat there until you run
    `eldir rig reset`.

    Example: eldir rig off --rig rig.yaml
    """
    from hardware.commands.off import run_off

    run_off(rig_file, port, board)


def reset(rig_file: RigFile) -> None:
    """Allow heating again after a stop.

    Every contact must be open by the board's report, and no current may flow where a sensor measures it.

    Example: eldir rig reset --rig rig.yaml
    """
    from hardware.guardian.measured_heat import require_no_current
    from hardware.rig.board_identity import identify_open
    from hardware.rig.boards import open_board
    from hardware.safety import spring_memory
    from hardware.safety.latch import require_proven_open, require_unlatched

    loaded, port = real_rig_and_port(rig_file)
    with open_board(loaded) as board:
        device = identify_open(board.handle, port)
        board.all_off()
        sensors = (record.sensor for record in require_proven_open(device) if record.sensor)
        measured = require_no_current(loaded, next(sensors, None))
        spring_memory.reset(device, loaded)
    require_unlatched(device)
    proof = f"all {loaded.board.channels} channels are open by the board's report"
    typer.echo(f"{proof}{f'; {measured}' if measured else ''}; the stop is reset")


def real_rig_and_port(rig_file: Path) -> tuple[Rig, str]:
    """The rig and its port. Raises `InputError` for a virtual rig, which has no port."""
    from hardware.rig.configuration import Rig

    loaded = Rig.load(rig_file)
    if loaded.kind == "virtual" or loaded.board.port is None:
        raise InputError(
            f"{rig_file} is a virtual rig: it has no port and heats nothing",
            code="rig.virtual",
            expected="kind: real",
        )
    return loaded, loaded.board.port
