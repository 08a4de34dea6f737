"""What leaves a serial port: never waited for without a limit, and started again where it was stopped.

The kernel's own ways of waiting (`tcdrain`, `tcsetattr` with TCSADRAIN, the end of `close`) wait for ever, or
for half a minute, at a port whose output another program or the device holds up.
"""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import select
import struct
import termios
import time
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import serial

BITS_A_BYTE = 10
"""Start, eight data, stop."""
_XON_XOFF = termios.IXON | termios.IXOFF | termios.IXANY
_POLL = 0.001
_STILL = (
    0.03  # output that does not move for so long is held up: an adapter takes bytes every millisecond [s]
)


def log_frame(logger: logging.Logger, way: str, port: str, data: bytes) -> None:
    """Log bytes that went to a port or came from it at DEBUG: in hexadecimal, text also as text."""
    if data and logger.isEnabledFor(logging.DEBUG):
        words = data.translate(None, b"\r\n")
        text = f"  {data.decode()!r}" if words.isascii() and words.decode().isprintable() else ""
        logger.debug("%s %s: %s%s", way, port, data.hex(" "), text)


def log_dropped(logger: logging.Logger, port: str, device: serial.Serial) -> None:
    """Log what waits in the input of a port, which will be dropped: only if somebody wants to see it."""
    if logger.isEnabledFor(logging.DEBUG):
        device.timeout = 0  # whatever else reads there too
        log_frame(logger, "dropped from", port, bytes(device.read(device.in_waiting)))


class BlockedOutputError(OSError):
    """The port takes no more bytes, or sends none of those that it has taken."""

    def __init__(self) -> None:
        super().__init__(errno.ETIMEDOUT, "it takes no more bytes")


class SerialOutput:
    """The output of an open port, by its file descriptor, which does not block (O_NONBLOCK)."""

    def __init__(self, handle: int):
        self._handle = handle

    def send(self, data: bytes, baud: int, patience: float) -> None:
        """Write all of `data` and wait until the kernel has passed it on.

        Raises `BlockedOutputError` where that takes longer than the bytes do at `baud`, and `patience` [s];
        what has not left is dropped: it must not close a contact when nobody expects it. Raises `OSError` or
        `termios.error` for a port that was lost.
        """
        deadline = time.monotonic() + (self._queued() + len(data)) * BITS_A_BYTE / baud + patience
        while True:
            late = time.monotonic() > deadline  # looked at first: this program itself may have stood still
            with suppress(BlockingIOError):
                data = data[os.write(self._handle, data) :] if data else data
            if not data and not self._queued():
                return
            if late:
                self.drop()
                raise BlockedOutputError
            time.sleep(_POLL)

    def unblock(self) -> None:
        """Start output that another program has stopped, by Ctrl-S, `tcflow` or a flow control that it set.

        Where it was held up, what waited is dropped first; output that moves is left alone.
        """
        with suppress(termios.error, OSError):
            if self._is_held_up():
                self.drop()
            mode = termios.tcgetattr(self._handle)
            if mode[0] & _XON_XOFF or mode[2] & termios.CRTSCTS:
                mode[0] &= ~_XON_XOFF
                mode[2] &= ~termios.CRTSCTS
                termios.tcsetattr(self._handle, termios.TCSANOW, mode)
            termios.tcflow(self._handle, termios.TCOON)

    def drop(self) -> None:
        """Drop what has not left yet. The kernel would also wait for it when the port is closed."""
        with suppress(termios.error, OSError):
            termios.tcflush(self._handle, termios.TCOFLUSH)

    def _is_held_up(self) -> bool:
        queued = self._queued()
        if not queued and self._is_ready():
            return False
        time.sleep(_STILL)
        return self._queued() >= queued if queued else not self._is_ready()

    def _is_ready(self) -> bool:
        return bool(select.select([], [self._handle], [], 0)[1])

    def _queued(self) -> int:
        """Bytes that the kernel has taken and the port has not; a pseudo-terminal passes them on at once."""
        try:
            return int(struct.unpack("i", fcntl.ioctl(self._handle, termios.TIOCOUTQ, bytes(4)))[0])
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):  # this port cannot tell
                return 0
            raise
