"""The command `eldir rig emulate`."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_hardware.relay.registration import kinds_text

if TYPE_CHECKING:
    from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard


def emulate(
    board: Annotated[str, typer.Option(help=f"Kind of the relay board: {kinds_text()}.")] = "lcus",
    trace: Annotated[
        Path | None, typer.Option(help="Write every switching of a contact to this file (JSON lines).")
    ] = None,
    channels: Annotated[int, typer.Option(min=1, help="Number of relay channels.")] = 4,
) -> None:
    """Emulate a relay board on a pseudo-terminal until Ctrl-C. The first line printed is its port.

    Example: eldir rig emulate --board lcus --trace edges.jsonl
    """
    from eldir_hardware.relay.registration import get_board
    from eldir_hardware.rig.devices import get_emulator

    max_channels = get_board(board).max_channels
    if channels > max_channels:
        raise typer.BadParameter(
            f"a board of kind {board} has at most {max_channels}", param_hint="--channels"
        )
    _serve(get_emulator(board), channels, trace, lambda port: print(port, flush=True))


def _serve(
    emulator: type[EmulatedBoard], channels: int, trace: Path | None, announce: Callable[[str], None]
) -> None:
    """Emulate a board for other programs until SIGINT or SIGTERM; `announce` is called with its port.

    Every switching of a contact is written to the new file `trace` at once, as a JSON line with the monotonic
    time.
    """
    import json

    from eldir.core.files import require_new
    from eldir.errors import not_written
    from eldir_hardware.clock import WallClock

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

    def write(event: ContactEvent) -> None:
        if file is not None:
            modulation = {"power": event.power} if 0 < event.power < 1 else {}
            values = {"t_s": event.t, "channel": event.channel, "closed": event.closed} | modulation
            file.write(json.dumps(values) + "\n")

    board = emulator(channels, WallClock(), write)
    announce(board.start())
    try:
        stopped.wait()
    finally:
        board.close()
        if file is not None:
            file.close()
