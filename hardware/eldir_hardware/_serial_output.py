"""Output of serial ports: never waited for without a limit, and restarted if it was stopped.

The waits of the kernel (`tcdrain`, `tcsetattr` with TCSADRAIN, the end of `close`) last for ever, or for half
a minute, at a port whose output another program or the device blocks.
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

BITS_PER_BYTE = 10
"""Start, eight data, stop."""
_XON_XOFF = termios.IXON | termios.IXOFF | termios.IXANY
_POLL = 0.001
_BLOCKED_AFTER = (
    0.03  # output without progress for this time is blocked: adapters take bytes every millisecond [s]
)


def log_frame(logger: logging.Logger, direction: str, port: str, data: bytes) -> None:
    """Log bytes to or from a port at level DEBUG, in hexadecimal and, if they are text, as text."""
    if data and logger.isEnabledFor(logging.DEBUG):
        words = data.translate(None, b"\r\n")
        text = f"  {data.decode()!r}" if words.isascii() and words.decode().isprintable() else ""
        logger.debug("%s %s: %s%s", direction, port, data.hex(" "), text)


def log_dropped(logger: logging.Logger, port: str, device: serial.Serial) -> None:
    """Log the waiting input of a port, which will be dropped, at level DEBUG."""
    if logger.isEnabledFor(logging.DEBUG):
        device.timeout = 0  # whatever else reads there too
        log_frame(logger, "dropped from", port, bytes(device.read(device.in_waiting)))


class BlockedOutputError(OSError):
    """The port accepts no more bytes, or transmits none of those that it accepted."""

    def __init__(self) -> None:
        super().__init__(errno.ETIMEDOUT, "it accepts no more bytes")


class SerialOutput:
    """The output of an open port, by its file descriptor, which does not block (O_NONBLOCK)."""

    def __init__(self, file_descriptor: int):
        self._file_descriptor = file_descriptor

    def send(self, data: bytes, baud: int, patience: float) -> None:
        """Write all of `data` and wait until the kernel has passed it to the port.

        Raises `BlockedOutputError` if that takes longer than the bytes at `baud` plus `patience` [s]; the
        remaining bytes are dropped, as they must not close a contact later. Raises `OSError` or
        `termios.error` for a lost port.
        """
        deadline = time.monotonic() + (self._queued() + len(data)) * BITS_PER_BYTE / baud + patience
        while True:
            # Read before writing: this program itself may have been suspended meanwhile.
            late = time.monotonic() > deadline
            with suppress(BlockingIOError):
                data = data[os.write(self._file_descriptor, data) :] if data else data
            if not data and not self._queued():
                return
            if late:
                self.drop()
                raise BlockedOutputError
            time.sleep(_POLL)

    def unblock(self) -> None:
        """Restart output that another program has stopped by Ctrl-S, `tcflow` or flow control.

        If it was blocked, the waiting bytes are dropped first.
        """
        with suppress(termios.error, OSError):
            if self._is_blocked():
                self.drop()
            mode = termios.tcgetattr(self._file_descriptor)
            if mode[0] & _XON_XOFF or mode[2] & termios.CRTSCTS:
                mode[0] &= ~_XON_XOFF
                mode[2] &= ~termios.CRTSCTS
                termios.tcsetattr(self._file_descriptor, termios.TCSANOW, mode)
            termios.tcflow(self._file_descriptor, termios.TCOON)

    def drop(self) -> None:
        """Drop the bytes that were not transmitted. Closing the port would wait for them."""
        with suppress(termios.error, OSError):
            termios.tcflush(self._file_descriptor, termios.TCOFLUSH)

    def _is_blocked(self) -> bool:
        queued = self._queued()
        if not queued and self._is_ready():
            return False
        time.sleep(_BLOCKED_AFTER)
        return self._queued() >= queued if queued else not self._is_ready()

    def _is_ready(self) -> bool:
        return bool(select.select([], [self._file_descriptor], [], 0)[1])

    def _queued(self) -> int:
        """Number of bytes that the kernel holds for the port; none for a pseudo-terminal."""
        try:
            return int(struct.unpack("i", fcntl.ioctl(self._file_descriptor, termios.TIOCOUTQ, bytes(4)))[0])
        except OSError as error:
            if error.errno in (errno.ENOTTY, errno.EINVAL):  # this port does not know
                return 0
            raise
