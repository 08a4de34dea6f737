"""A pseudo-terminal that behaves like a serial adapter whose output is held up, for real processes.

A pseudo-terminal has no output queue: `tcdrain` never waits there. Here the kernel hands the system calls of
chosen processes, and of their children, to this one (seccomp's user notification), which keeps their bytes in
a queue: writing succeeds until it is full, and waiting for it to empty takes for ever.
"""

import ctypes
import errno
import fcntl
import os
import platform
import select
import socket
import struct
import sys
import termios
import threading
from contextlib import suppress

NUMBERS = {"x86_64": (1, 16, 317), "aarch64": (64, 29, 277)}  # write, ioctl, seccomp
_DRAINS = {0x5403, 0x5404, 0x402C542C, 0x402C542D}  # TCSETSW, TCSETSF and their newer forms
_TCSBRK, _TCXONC, _TCFLSH = 0x5409, 0x540A, 0x540B
_RECEIVE, _SEND = 0xC0502100, 0xC0182101
_NOTICE, _RESPONSE = struct.Struct("=QIIiIQ6Q"), struct.Struct("=QqiI")
_PASS = 1  # the kernel goes on with the call
_ROOM = 4096  # of the queue [bytes]


class HeldUart:
    """The output of `port` for programs behind `words` or `code`, until the end of a `with`."""

    def __init__(self, port: str):
        self._port = port
        self._held = self._restarts = False
        self.queue = b""
        """Bytes that were taken and have not left."""
        self._listeners: list[int] = []
        self._waiting: list[tuple[int, int]] = []
        self._name = f"\0held-uart-{os.getpid()}-{id(self)}"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.bind(self._name)
        self._socket.listen()
        self._stop = os.pipe()

    def __enter__(self) -> "HeldUart":
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._stop[1], b".")
        self._thread.join()
        self._socket.close()
        for handle in (*self._stop, *self._listeners):
            os.close(handle)

    def hold(self, *, restarts: bool) -> None:
        """Hold the output up: by `tcflow`, which another `tcflow` ends (`restarts`), or by the device."""
        self._restarts, self._held = restarts, True

    @property
    def words(self) -> list[str]:
        """Words of the command line before those of a program that is to have this port."""
        return [sys.executable, __file__, self._name[1:]]

    @property
    def code(self) -> str:
        """The same at the beginning of a program of Python."""
        return f"from {__name__} import hand_over\nhand_over({self._name[1:]!r})\n"

    def _serve(self) -> None:
        while True:
            ready, _, _ = select.select([self._stop[0], self._socket, *self._listeners], [], [])
            if self._stop[0] in ready:
                return
            for source in ready:
                if source is self._socket:
                    with self._socket.accept()[0] as program:
                        self._listeners += socket.recv_fds(program, 1, 1)[1]
                    continue
                notice = bytearray(_NOTICE.size)
                try:
                    fcntl.ioctl(source, _RECEIVE, notice)
                except OSError as error:
                    if error.errno != errno.ENOENT:  # that process has just ended
                        self._listeners.remove(source)
                        os.close(source)
                    continue
                number, process, _, call, _, _, *words = _NOTICE.unpack(notice)
                self._decide(source, number, process, call, words)

    def _decide(self, listener: int, number: int, process: int, call: int, words: list[int]) -> None:
        handle, what, argument = words[0], words[1], words[2]
        if not self._held or not self._is_port(process, handle):
            return self._respond(listener, number)
        if call == NUMBERS[platform.machine()][0]:
            return self._write(listener, number, process, what, argument)
        what &= 0xFFFFFFFF
        if what == termios.TIOCOUTQ:
            self._poke(process, argument, struct.pack("i", len(self.queue)))
            return self._respond(listener, number, 0)
        if self.queue and (what in _DRAINS or (what == _TCSBRK and argument)):
            self._waiting.append((listener, number))
            return None
        if what == _TCFLSH and argument in (termios.TCOFLUSH, termios.TCIOFLUSH):
            self.queue = b""
        if what == _TCXONC and argument == termios.TCOON and self._restarts:
            self._release()
        return self._respond(listener, number)

    def _write(self, listener: int, number: int, process: int, place: int, length: int) -> None:
        if len(self.queue) + length > _ROOM:
            return self._respond(listener, number, -errno.EAGAIN)
        with open(f"/proc/{process}/mem", "rb", 0) as memory:
            memory.seek(place)
            self.queue += memory.read(length)
        return self._respond(listener, number, length)

    def _release(self) -> None:
        """What still waits in the queue leaves now."""
        self._held = False
        handle = os.open(self._port, os.O_WRONLY | os.O_NOCTTY)
        os.write(handle, self.queue)
        os.close(handle)
        self.queue = b""
        for listener, number in self._waiting:
            self._respond(listener, number)

    def _is_port(self, process: int, handle: int) -> bool:
        with suppress(OSError):
            return os.readlink(f"/proc/{process}/fd/{handle}") == self._port
        return False

    def _poke(self, process: int, place: int, data: bytes) -> None:
        with open(f"/proc/{process}/mem", "r+b", 0) as memory:
            memory.seek(place)
            memory.write(data)

    def _respond(self, listener: int, number: int, value: int | None = None) -> None:
        error = min(value or 0, 0)
        answer = _RESPONSE.pack(number, max(value or 0, 0), error, _PASS if value is None else 0)
        with suppress(OSError):  # it was killed
            fcntl.ioctl(listener, _SEND, answer)


def hand_over(name: str) -> None:
    """Hand `write` and `ioctl` of this process, and of those that it starts, over."""
    write, ioctl, seccomp = NUMBERS[platform.machine()]
    jump, end, notify, allow = 0x15, 6, 0x7FC00000, 0x7FFF0000
    code = [
        (0x20, 0, 0, 0),
        (jump, 2, 0, write),
        (jump, 1, 0, ioctl),
        (end, 0, 0, allow),
        (end, 0, 0, notify),
    ]
    lines = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in code))
    program = ctypes.create_string_buffer(struct.pack("@HP", len(code), ctypes.addressof(lines)))
    libc = ctypes.CDLL(None, use_errno=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as asking:
        asking.connect("\0" + name)
        assert libc.prctl(38, 1, 0, 0, 0) == 0  # no new privileges
        listener = libc.syscall(seccomp, 1, 8, program)
        assert listener >= 0, os.strerror(ctypes.get_errno())
        socket.send_fds(asking, [b"."], [listener])
    os.close(listener)


if __name__ == "__main__":
    hand_over(sys.argv[1])
    os.execv(sys.argv[2], sys.argv[2:])
