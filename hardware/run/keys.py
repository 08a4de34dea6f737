"""Keys of the terminal while a schedule is played: space pauses and resumes, s steps, f finishes, x stops."""

from __future__ import annotations

import os
import sys
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from select import select

from hardware.run.player import Player


@contextmanager
def keys(player: Player, handle: int | None = None) -> Iterator[None]:
    """Obey the keys until the context ends; without a terminal nothing is read."""
    # There is no standard input where a script closed it.
    handle = sys.stdin.fileno() if handle is None and sys.stdin and sys.stdin.isatty() else handle
    if handle is None:
        yield
        return
    before = termios.tcgetattr(handle)
    read, write = os.pipe()
    thread = threading.Thread(target=_listen, args=(player, handle, read), name="keys", daemon=True)
    try:
        tty.setcbreak(handle)  # Ctrl-C stays a signal
        mode = termios.tcgetattr(handle)
        mode[3] |= termios.NOFLSH  # which discards nothing that was printed before
        termios.tcsetattr(handle, termios.TCSANOW, mode)
        thread.start()
        yield
    finally:
        os.write(write, b".")
        thread.join()
        with suppress(termios.error):  # the terminal was closed
            termios.tcsetattr(handle, termios.TCSADRAIN, before)
        os.close(read)
        os.close(write)


def _listen(player: Player, handle: int, end: int) -> None:
    while True:
        ready, _, _ = select([handle, end], [], [])
        if end in ready:
            return
        match os.read(handle, 1):
            case b" ":
                (player.resume if player.paused else player.pause)()
            case b"s":
                player.step()
            case b"f":
                player.finish_cycle()
            case b"x":
                player.stop("stopped by a key")
            case b"":
                return
