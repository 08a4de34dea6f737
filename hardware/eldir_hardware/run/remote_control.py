"""Remote control of a player: pause, resume, step, finish, by another program of this user or by keys.

The socket for other programs is abstract and named after the process: it leaves no file and ends with the
process. It is not for emergencies: `eldir rig off` needs nothing of this program.
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

COMMANDS = ("pause", "resume", "step", "finish")
_ANSWER_TIMEOUT = 2.0  # for the answer of the program that drives [s]
_READ_TIMEOUT = 0.2  # for the command of a connected program [s]
_MIN_COMMAND_INTERVAL = 0.05  # so that many commands do not delay the player [s]
_PEER = struct.Struct("3i")  # process, user, group


@contextmanager
def obey_commands(player: Player) -> Iterator[None]:
    """Obey commands until the context ends. If the socket cannot be created, the run continues without."""
    try:
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        listener.bind(_socket_name(os.getpid()))
        listener.listen(4)
    except OSError:
        yield
        return
    end = threading.Event()
    read, write = os.pipe()
    thread = threading.Thread(
        target=_serve, args=(listener, player, read, end), name="remote control", daemon=True
    )
    thread.start()
    try:
        yield
    finally:
        end.set()
        os.write(write, b".")
        thread.join()
        listener.close()
        os.close(read)
        os.close(write)


def accepts_commands(process: int) -> bool:
    """Whether a process obeys commands, as its socket exists."""
    name = _socket_name(process).replace("\0", "@")
    with suppress(OSError):
        return any(line.split()[-1] == name for line in Path("/proc/net/unix").read_text().splitlines())
    return False


def list_players() -> list[int]:
    """Process numbers of the programs of this user that play a schedule and obey commands."""
    found = []
    with suppress(OSError):
        for line in Path("/proc/net/unix").read_text().splitlines():
            name, inode = line.split()[-1], line.split()[-2]
            process = name.removeprefix(_socket_name("").replace("\0", "@"))
            if process != name and process.isdigit() and _holds_socket(int(process), inode):
                found.append(int(process))
    return found


def _holds_socket(process: int, inode: str) -> bool:
    """Whether a process has this socket; the name alone could be any program's."""
    with suppress(OSError):
        return any(os.readlink(link) == f"socket:[{inode}]" for link in Path(f"/proc/{process}/fd").iterdir())
    return False


def send_command(process: int, command: str) -> bool:
    """Send a command to the program that drives, and return whether it obeyed within two seconds."""
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.settimeout(_ANSWER_TIMEOUT)
        connection.connect(_socket_name(process))
        if _peer_credentials(connection)[0] != process:  # another program uses the name
            return False
        connection.send(command.encode())
        return connection.recv(8) == b"ok"
    return False


def _serve(listener: socket.socket, player: Player, until: int, end: threading.Event) -> None:
    actions: dict[bytes, Callable[[], None]] = {
        b"pause": player.pause,
        b"resume": player.resume,
        b"step": player.step,
        b"finish": player.finish_cycle,
    }
    sources: list[Any] = [listener, until]
    while True:
        ready, _, _ = select(sources, [], [])
        if until in ready:
            return
        with suppress(OSError):
            connection, _ = listener.accept()
            with connection:
                connection.settimeout(_READ_TIMEOUT)
                if _peer_credentials(connection)[1] in (os.geteuid(), 0):
                    command = actions.get(connection.recv(16))
                    if command is not None:
                        command()
                    connection.send(b"no" if command is None else b"ok")
        end.wait(_MIN_COMMAND_INTERVAL)


def _socket_name(process: int | str) -> str:
    return f"\0eldir-drive-{process}"


def _peer_credentials(connected: socket.socket) -> tuple[int, int]:
    """Process and user at the other end, from the kernel."""
    data = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
    process, user, _ = _PEER.unpack(data)
    return process, user


@contextmanager
def obey_keys(player: Player, handle: int | None = None) -> Iterator[None]:
    """Obey keys of the terminal until the context ends; without a terminal nothing is read.

    Space pauses and resumes, s steps, f finishes, x stops.
    """
    # A script may have closed the standard input.
    handle = sys.stdin.fileno() if handle is None and sys.stdin and sys.stdin.isatty() else handle
    if handle is None:
        yield
        return
    before = termios.tcgetattr(handle)
    read, write = os.pipe()
    thread = threading.Thread(target=_read_keys, args=(player, handle, read), name="keys", daemon=True)
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


def _read_keys(player: Player, handle: int, end: int) -> None:
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
