"""A process that has imported what `eldir` imports, and forks the programs of `tests.forked_programs`.

`python -m tests.fork_server SOCKET`. Each message is a program: its words, environment and folder as JSON,
and handles: of a pipe for its status, and of its streams that are not those of this process. The answer is
its pidfd.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import runpy
import select
import socket
import sys
from contextlib import suppress
from typing import Any

IMPORTED = (
    "eldir_app.progress",
    "eldir_app.emergency_stop",
    "eldir_hardware.guardian.client",
    "eldir_hardware.run.drive",
    "eldir_hardware.safety.stop_signals",
    "eldir_app.watch.listening",
    "eldir_app.watch.server",
)


def serve(control: socket.socket) -> dict[str, Any]:
    """Fork a program for each message; returns the message in the program's process, and ends this one when
    the tests have ended."""
    running: dict[int, tuple[int, int]] = {}  # number and pipe for the status, by pidfd
    while True:
        ready, _, _ = select.select([control, *running], [], [])
        for handle in running.keys() & set(ready):
            process, pipe = running.pop(handle)
            status = os.waitpid(process, 0)[1]
            with suppress(BrokenPipeError):  # nobody waits for it
                os.write(pipe, str(status).encode())
            os.close(handle)
            os.close(pipe)
        if control not in ready:
            continue
        message, handles, _, _ = socket.recv_fds(control, 1 << 20, 4)
        if not message:
            sys.exit()
        pipe, *streams = handles
        asked: dict[str, Any] = json.loads(message)
        if len(os.listdir("/proc/self/task")) > 1:
            raise RuntimeError("a process with threads cannot be forked: what they have locked stays locked")
        process = os.fork()
        if not process:
            control.close()
            _take_streams(dict(zip(asked["streams"], streams, strict=True)))
            return asked
        pidfd = os.pidfd_open(process)
        running[pidfd] = process, pipe
        socket.send_fds(control, [b"."], [pidfd])
        for handle in streams:
            os.close(handle)


def _take_streams(handles: dict[int, int]) -> None:
    """These handles as streams of these numbers, and no others."""
    for number, handle in handles.items():
        os.dup2(handle, number)
    os.closerange(3, os.sysconf("SC_OPEN_MAX"))
    for name, number in (("stdout", 1), ("stderr", 2)):
        before = getattr(sys, name)
        setattr(sys, name, os.fdopen(number, "w", -1, before.encoding, before.errors, closefd=False))


def run(asked: dict[str, Any]) -> None:
    """Run the program in this process, as Python does when it starts."""
    os.environ.clear()
    os.environ.update(asked["environment"])
    os.chdir(asked["folder"])
    os.setpriority(os.PRIO_PROCESS, 0, asked["priority"])
    option, what, *words = asked["words"]
    sys.argv[:] = [option, *words]
    unbuffered = "PYTHONUNBUFFERED" in os.environ
    sys.stdout.reconfigure(write_through=unbuffered)
    sys.stderr.reconfigure(write_through=unbuffered, line_buffering=not unbuffered)
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
