"""A process that has imported what `eldir` imports, and forks the programs of `tests.forked_programs`.

`python -m tests.fork_server SOCKET PADDING`. Each message is a program: its words, environment and folder as
JSON, and handles: of a pipe for its status, and of its files that are not those of this process. The answer
is its pidfd. Messages come through the socket, and from programs that this process has forked, which start
guardians. The padding makes room for their command lines.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import json
import os
import runpy
import select
import socket
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests import forked_programs

IMPORTED = (
    "eldir_app.progress",
    "eldir_app.emergency_stop",
    "eldir_app.evolution_run",
    "eldir_hardware.guardian.client",
    "eldir_hardware.guardian._process",
    "eldir_hardware.planning.workshop",
    "eldir_hardware.run.drive",
    "eldir_hardware.safety.stop_signals",
    "eldir_app.watch.listening",
    "eldir_app.watch.server",
)


def serve(control: socket.socket) -> dict[str, Any]:
    """Fork a program for each message; returns the message in the program's process, and ends this one when
    the tests have ended."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind("")  # an abstract name of the kernel's choice
    listener.listen()
    running: dict[int, tuple[int, int]] = {}  # number and pipe for the status, by pidfd
    while True:
        ready, _, _ = select.select([control, listener, *running], [], [])
        for handle in running.keys() & set(ready):
            process, pipe = running.pop(handle)
            status = os.waitpid(process, 0)[1]
            with suppress(BrokenPipeError):  # nobody waits for it
                os.write(pipe, str(status).encode())
            os.close(handle)
            os.close(pipe)
        for source in {control, listener} & set(ready):
            asking = source.accept()[0] if source is listener else control
            message, handles, _, _ = socket.recv_fds(asking, 1 << 20, 8)
            if not message:
                sys.exit()
            pipe, *files = handles
            asked: dict[str, Any] = json.loads(message)
            if len(os.listdir("/proc/self/task")) > 1:
                raise RuntimeError("a process with threads cannot be forked: what they locked stays locked")
            process = os.fork()
            if not process:
                forked_programs.use_server(listener.getsockname())
                for own in (control, listener, asking):
                    own.close()  # not later, when their numbers are those of the program's files
                _take_files(dict(zip(asked["files"], files, strict=True)))
                return asked
            pidfd = os.pidfd_open(process)
            running[pidfd] = process, pipe
            socket.send_fds(asking, [b"."], [pidfd])
            for handle in files:
                os.close(handle)
            if source is listener:
                asking.close()


def _take_files(handles: dict[int, int]) -> None:
    """These handles under these numbers, and no others."""
    above = 1 + max([2, *handles, *handles.values()])
    for moved, (number, handle) in enumerate(handles.items(), above):
        os.dup2(handle, moved)
        handles[number] = moved
    for number, handle in handles.items():
        os.dup2(handle, number, inheritable=True)
    last = 2
    for number in [*sorted(n for n in handles if n > 2), os.sysconf("SC_OPEN_MAX")]:
        os.closerange(last + 1, number)
        last = number
    for name, number in (("stdout", 1), ("stderr", 2)):
        before = getattr(sys, name)
        setattr(sys, name, os.fdopen(number, "w", -1, before.encoding, before.errors, closefd=False))


def _show_words(words: list[str]) -> None:
    """Let the system show these words as this process's command line: `eldir rig off` reads a guardian's."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = int(fields[45]), int(fields[46])
    shown = b"".join(os.fsencode(word) + b"\0" for word in words)
    if len(shown) > end - start:
        raise RuntimeError(f"a command line of {len(shown)} bytes needs a longer padding")
    ctypes.memset(start, 0, end - start)
    ctypes.memmove(start, shown, len(shown))


def run(asked: dict[str, Any]) -> None:
    """Run the program in this process, as Python does when it starts."""
    os.environ.clear()
    os.environ.update(asked["environment"])
    os.chdir(asked["folder"])
    os.setpriority(os.PRIO_PROCESS, 0, asked["priority"])
    if asked["session"]:
        os.setsid()
    _show_words([sys.executable, *asked["words"]])
    if not asked["child_guardian"]:
        forked_programs.fork_guardians()
    option, what, *words = [word for word in asked["words"] if word != "-I"]
    sys.argv[:] = [option, *words]
    unbuffered = "PYTHONUNBUFFERED" in os.environ
    encoding, _, errors = os.environ.get("PYTHONIOENCODING", "").partition(":")
    sys.stdout.reconfigure(write_through=unbuffered, encoding=encoding or None, errors=errors or None)
    sys.stderr.reconfigure(
        write_through=unbuffered,
        line_buffering=not unbuffered,
        encoding=encoding or None,
        errors=sys.stderr.errors,
    )
    if option == "-m":
        runpy.run_module(what, run_name="__main__", alter_sys=True)
    else:
        exec(compile(what, "<string>", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    for name in IMPORTED:
        importlib.import_module(name)
    importlib.import_module("eldir_app.application").application()
    importlib.import_module("eldir_hardware.log.messages").typestore()
    gc.collect()
    gc.freeze()
    run(serve(socket.socket(fileno=int(sys.argv[1]))))
