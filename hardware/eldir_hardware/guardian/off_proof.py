"""Proof outside a run that every contact is open, and the reset of an emergency stop."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from eldir.errors import EldirError
from eldir_hardware.guardian.bank import BOARD_PROOF
from eldir_hardware.guardian.measured_heat import CurrentFlowsError, require_no_current
from eldir_hardware.rig.board_identity import BoardIdentity, Port, identify_open
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import open_board
from eldir_hardware.safety.latch import require_proven_open, require_unlatched
from eldir_hardware.safety.spring_memory import reset_stop


@contextmanager
def proven_open(rig: Rig, port: Port | None = None) -> Iterator[tuple[BoardIdentity, BoardIdentity | None]]:
    """Open every contact of a rig's board, or of the one at `port`, proven by its report.

    A context in which no other program drives the board. Its values: the board, and the current sensor of
    the run that was stopped there; None for the rig file's. Raises `EldirError` where a run through this port
    drove another device, which nobody has proven open.
    """
    url = port or rig.require_port()
    with open_board(rig, port=url) as board:
        board.all_off()
        device = identify_open(board.file_descriptor, str(url))
        records = require_proven_open(device)
        yield device, next((record.sensor for record in records if record.sensor), None)


def prove_off(rig: Rig, port: Port | None = None) -> str:
    """Open every contact of a board that no guardian holds; returns what the board and the sensor show.

    A stop does not need the sensor, its reset does. Raises `CurrentFlowsError`, and `EldirError` as
    `proven_open`.
    """
    with proven_open(rig, port) as (_, sensor):
        try:
            measured = require_no_current(rig, sensor)
        except CurrentFlowsError:
            raise
        except EldirError as error:
            measured = f"no current was measured: {error}"
    return f"{BOARD_PROOF}; {measured}" if measured else BOARD_PROOF


def reset_emergency_stop(rig: Rig, port: Port | None = None) -> str | None:
    """Allow heating through a rig's board, or the one at `port`, after a stop.

    Every contact must be open by the board's report, and no current may flow where the sensor measures it:
    that of the run, else that of the rig file. Returns in words what the sensor shows; None without one.
    Raises `EldirError`, and keeps the stop then.
    """
    with proven_open(rig, port) as (device, sensor):
        measured = require_no_current(rig, sensor)
        reset_stop(device, rig)
    require_unlatched(device)
    return measured
