"""Orders to a schedule that is played: pause, resume, step, finish. They come from another program of this
user, or from keys of the terminal.

The socket for other programs is abstract, named after the process: it leaves no file behind and ends with
the process. It is no way to stop in an emergency: that is `eldir rig off`, which needs nothing of this
program.
"""

from __future__ import annotations

import os
import socket
import struct
import sys
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from select import select
from typing import Any

from eldir_hardware.run.player import Player

ORDERS = ("pause", "resume", "step", "finish")
_PATIENCE = 2.0  # with the program that drives [s]
_READING = 0.2  # for the word of who has connected [s]
_BETWEEN = 0.05  # from one order to the next: a flood of them takes no time from the player [s]
_PEER = struct.Struct("3i")  # process, user, group


@contextmanager
def orders(player: Player) -> Iterator[None]:
    """Obey orders until the context ends. Where the socket cannot be made, the run goes on without."""
    try:
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        listening.bind(_name(os.getpid()))
        listening.listen(4)
    except OSError:
        yield
        return
    end = threading.Event()
    read, write = os.pipe()
    thread = threading.Thread(target=_serve, args=(listening, player, read, end), name="orders", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        os.write(write, b".")
        thread.join()
        listening.close()
        os.close(read)
        os.close(write)


def takes_orders(process: int) -> bool:
    """Whether a process obeys orders: it has its socket."""
    name = _name(process).replace("\0", "@")
    with suppress(OSError):
        return any(line.split()[-1] == name for line in Path("/proc/net/unix").read_text().splitlines())
    return False


def give_order(process: int, order: str) -> bool:
    """Tell the program that drives; whether it took the order. Waits for at most two seconds."""
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
        asking.settimeout(_PATIENCE)
        asking.connect(_name(process))
        if _peer(asking)[0] != process:  # another program has taken the name
            return False
        asking.send(order.encode())
        return asking.recv(8) == b"ok"
    return False


def _serve(listening: socket.socket, player: Player, until: int, end: threading.Event) -> None:
    obey: dict[bytes, Callable[[], None]] = {
        b"pause": player.pause,
        b"resume": player.resume,
        b"step": player.step,
        b"finish": player.finish_cycle,
    }
    sources: list[Any] = [listening, until]
    while True:
        ready, _, _ = select(sources, [], [])
        if until in ready:
            return
        with suppress(OSError):
            asking, _ = listening.accept()
            with asking:
                asking.settimeout(_READING)
                if _peer(asking)[1] in (os.geteuid(), 0):
                    order = obey.get(asking.recv(16))
                    if order is not None:
                        order()
                    asking.send(b"no" if order is None else b"ok")
        end.wait(_BETWEEN)


def _name(process: int) -> str:
    return f"\0eldir-drive-{process}"


def _peer(connected: socket.socket) -> tuple[int, int]:
    """Process and user at the other end, as the kernel says."""
    data = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    process, user, _ = _PEER.unpack(data)
    return process, user


@contextmanager
def keys(player: Player, handle: int | None = None) -> Iterator[None]:
    """Obey keys of the terminal until the context ends; without a terminal nothing is read.

    Space pauses and resumes, s steps, f finishes, x stops.
    """
    # There is no standard input where a script closed it.
    handle = sys.stdin.fileno() if handle is None and sys.stdin and sys.stdin.isatty() else handle
    if handle is None:
        yield
        return
    before = termios.tcgetattr(handle)
    read, write = os.pipe()
    thread = threading.Thread(target=_obey_keys, args=(player, handle, read), name="keys", daemon=True)
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


def _obey_keys(player: Player, handle: int, end: int) -> None:
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
