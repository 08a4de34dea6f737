"""Programs in processes of their own that do not import everything anew.

`Forked([sys.executable, "-m", "eldir", ...])` is for tests of what a program does after its start, as
`subprocess.Popen` is for those of the start. One process of the tests imports what `eldir` imports, once, and
forks: 0.03 thousand million instructions instead of 1.6. Streams, signals, environment, working directory,
command line and status are the program's own. The guardians that it and the tests start are forked likewise
(`fork_guardians`); those of programs that `subprocess` starts are not. Its input is empty, unless it gets a
terminal.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Self

from tests.paths import ROOT

_PADDING = "." * 8192
_STARTING = threading.Lock()
_address: list[bytes] = []
"""Of the server that has forked this process."""


def use_server(address: bytes) -> None:
    """This process is a fork of the server with this address, which forks its guardians too."""
    _address[:] = [address]


def fork_guardians() -> None:
    """From now on guardians of this process are forked, if it has imported their client: without the imports
    of a guardian, which take ten times as long as the rest of its start."""
    if (client := sys.modules.get("eldir_hardware.guardian.client")) is not None:
        client.subprocess = SimpleNamespace(  # type: ignore[attr-defined]
            Popen=_start_guardian, DEVNULL=subprocess.DEVNULL, TimeoutExpired=subprocess.TimeoutExpired
        )


def _start_guardian(
    words: Sequence[str], *, env: Mapping[str, str], pass_fds: Sequence[int], cwd: str, **same: object
) -> Forked:
    silent = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "start_new_session": True}
    assert same == silent, same
    return Forked(
        words, stdout=subprocess.DEVNULL, stderr=2, env=env, pass_fds=pass_fds, cwd=cwd, new_session=True
    )


@cache
def _server(before: tuple[str, ...]) -> socket.socket:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        server = subprocess.Popen(
            [*before, sys.executable, "-m", "tests.fork_server", str(theirs.fileno()), _PADDING],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            cwd=ROOT,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # a process with threads cannot be forked
        )
    atexit.register(server.wait)
    atexit.register(ours.close)
    return ours


def _connect(address: bytes) -> socket.socket:
    server = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    server.connect(address)
    return server


class Forked:
    """A program with the attributes and methods of `subprocess.Popen`."""

    def __init__(
        self,
        words: Sequence[str],
        *,
        stdin: int | None = None,
        stdout: int | IO[str] | None = None,
        stderr: int | IO[str] | None = None,
        env: Mapping[str, str] | None = None,
        pass_fds: Sequence[int] = (),
        cwd: str | None = None,
        new_session: bool = False,
        child_guardian: bool = False,
        server: Sequence[str] = (),
    ):
        """`words`: the interpreter, then -m, -c or -I -c. A stream is a pipe, a file or its handle; this
        process's where it is None; `stdin` is a handle. `child_guardian`: its guardian is its child, started
        as in the product. `server`: words of the command line before the process that forks."""
        executable, *rest = words
        assert executable == sys.executable and (rest[0] in ("-c", "-m") or rest[:2] == ["-I", "-c"]), words
        self.args, self.returncode = words, None
        self.stdout: IO[str] | None = None
        self.stderr: IO[str] | None = None
        self._lock = threading.Lock()
        self._status, status = os.pipe()
        weakref.finalize(self, os.close, self._status)
        streams, to_close = {} if stdin is None else {0: stdin}, [status]
        streams |= {handle: handle for handle in pass_fds}
        for number, stream in ((1, stdout), (2, stderr)):
            if stream == subprocess.PIPE:
                read, write = os.pipe()
                setattr(self, ("stdout", "stderr")[number - 1], os.fdopen(read))
                to_close.append(write)
                streams[number] = write
            elif stream == subprocess.DEVNULL:
                to_close.append(os.open(os.devnull, os.O_RDWR))
                streams[number] = to_close[-1]
            elif stream == subprocess.STDOUT:
                streams[number] = streams[1]
            elif stream is not None:
                streams[number] = stream if isinstance(stream, int) else stream.fileno()
        asked = {
            "words": rest,
            "files": [*streams],
            "environment": dict(os.environ if env is None else env),
            "folder": cwd or os.getcwd(),
            "session": new_session,
            "child_guardian": child_guardian,
            "priority": os.getpriority(os.PRIO_PROCESS, 0),
        }
        with _STARTING:
            forking = _server(tuple(server)) if not _address else _connect(_address[0])
            socket.send_fds(forking, [json.dumps(asked).encode()], [status, *streams.values()])
            _, [self._pidfd], _, _ = socket.recv_fds(forking, 64, 1)
            if _address:
                forking.close()
        weakref.finalize(self, os.close, self._pidfd)
        self.pid = _process_of(self._pidfd)
        for handle in to_close:
            os.close(handle)

    def poll(self) -> int | None:
        """Its status, if it has ended."""
        return self._ended(0.0)

    def wait(self, timeout: float | None = None) -> int:
        """Its status when it has ended. Raises `subprocess.TimeoutExpired`."""
        status = self._ended(timeout)
        if status is None:
            raise subprocess.TimeoutExpired(self.args, timeout)
        return status

    def _ended(self, within: float | None) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], within)[0]:
            with self._lock:  # of several threads that wait, one reads it
                if self.returncode is None:
                    self.returncode = os.waitstatus_to_exitcode(int(os.read(self._status, 64)))
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended; its status is on the way
                signal.pidfd_send_signal(self._pidfd, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def communicate(self, timeout: float | None = None) -> tuple[str | None, str | None]:
        """What it and the programs that it started write to its streams, when all have ended. Raises
        `subprocess.TimeoutExpired`."""
        streams = [stream for stream in (self.stdout, self.stderr) if stream is not None]
        said: dict[IO[str] | None, str] = {}
        readers = [
            threading.Thread(
                target=lambda stream: said.update({stream: stream.read()}), args=[s], daemon=True
            )
            for s in streams
        ]
        deadline = None if timeout is None else time.monotonic() + timeout
        for reader in readers:
            reader.start()
        for reader in readers:
            reader.join(None if deadline is None else max(deadline - time.monotonic(), 0.0))
            if reader.is_alive():
                raise subprocess.TimeoutExpired(self.args, timeout)
        for stream in streams:
            stream.close()
        self.wait(None if deadline is None else max(deadline - time.monotonic(), 0.0))
        return said.get(self.stdout), said.get(self.stderr)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for stream in (self.stdout, self.stderr):
            if stream is not None:
                stream.close()
        self.wait()


def _process_of(pidfd: int) -> int:
    """Its number here; the process may see itself under another one."""
    about = Path(f"/proc/self/fdinfo/{pidfd}").read_text()
    return next(int(line.split()[1]) for line in about.splitlines() if line.startswith("Pid:"))


def finished(words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """What a program writes until it ends, and its status."""
    with Forked(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        said = program.communicate(120)
        return subprocess.CompletedProcess(words, program.returncode, *said)
