"""An emulated board offered to other programs until it is stopped."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Callable
from pathlib import Path

from eldir.core.files import require_new
from eldir.errors import not_written
from hardware.clock import WallClock
from hardware.emulator.board import Edge, EmulatedBoard


def serve(
    emulator: type[EmulatedBoard], channels: int, trace: Path | None, announce: Callable[[str], None]
) -> None:
    """Offer an emulated board until SIGINT or SIGTERM; `announce` is called with its port.

    Every edge is written to the new file `trace` at once, as a JSON line with the monotonic time.
    """
    require_new(trace)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    file = None
    try:
        if trace is not None:
            trace.parent.mkdir(parents=True, exist_ok=True)
            file = trace.open("x", buffering=1, encoding="utf-8")
    except OSError as error:
        raise not_written(trace, error, "choose another place") from None

    def write(edge: Edge) -> None:
        if file is not None:
            modulated = {"power": edge.power} if 0 < edge.power < 1 else {}
            told = {"t_s": edge.t, "channel": edge.channel, "closed": edge.closed} | modulated
            file.write(json.dumps(told) + "\n")

    board = emulator(channels, WallClock(), write)
    announce(board.start())
    try:
        stopped.wait()
    finally:
        board.close()
        if file is not None:
            file.close()
