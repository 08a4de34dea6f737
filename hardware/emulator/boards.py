"""Which emulator stands in for which kind of board, and one to be used from outside."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable
from pathlib import Path

from eldir.errors import EldirError
from hardware.clock import WallClock
from hardware.emulator.board import Edge, EmulatedBoard
from hardware.emulator.feedback import EmulatedFeedback
from hardware.emulator.gd32 import EmulatedGd32
from hardware.emulator.lcus import EmulatedLcus
from hardware.emulator.modbus import EmulatedModbus
from hardware.emulator.numato import EmulatedNumato
from hardware.emulator.sainsmart import EmulatedSainSmart

EMULATORS: dict[str, type[EmulatedBoard]] = {
    "feedback": EmulatedFeedback,
    "gd32": EmulatedGd32,
    "lcus": EmulatedLcus,
    "modbus": EmulatedModbus,
    "numato": EmulatedNumato,
    "sainsmart": EmulatedSainSmart,
}


def serve(kind: str, channels: int, trace: Path | None, announce: Callable[[str], None]) -> None:
    """Offer a board until SIGINT or SIGTERM; `announce` is told its port.

    Every edge is a JSON line in `trace`, with the monotonic time, as soon as it happens.
    """
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    try:
        file = None if trace is None else trace.open("w", buffering=1)
    except OSError as error:
        raise EldirError(f"cannot write {trace}: {error.strerror}", remedy="choose another place") from None

    def write(edge: Edge) -> None:
        if file is not None:
            file.write(json.dumps({"t_s": edge.t, "channel": edge.channel, "closed": edge.closed}) + "\n")

    board = EMULATORS[kind](channels, WallClock(), write)
    announce(board.start())
    try:
        stopped.wait()
    finally:
        board.close()
        if file is not None:
            file.close()
