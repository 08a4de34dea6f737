"""A port that is written without its lock, while another program may hold it."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
import termios
import time

from eldir_hardware.rig.board_identity import BoardIdentity, Port, locate
from eldir_hardware.serial_output import BITS_A_BYTE, BlockedOutputError, SerialOutput, log_frame

_PATIENCE = 0.2  # with a port that does not take the bytes [s]
_logger = logging.getLogger(__name__)
_SPEED = {9600: termios.B9600, 19200: termios.B19200, 38400: termios.B38400, 57600: termios.B57600}
_SPEED |= {115200: termios.B115200}


class UnlockedPort:
    """A port that is written without its lock."""

    def __init__(self, device: Port):
        """Raises `OSError` for a port that cannot be opened or is no serial port, or is not that device."""
        port = locate(device) if isinstance(device, BoardIdentity) else device
        if port is None:
            raise OSError(errno.ENOENT, "it is not connected")
        if not stat.S_ISCHR(os.stat(port).st_mode):
            raise OSError(errno.ENOTTY, "it is no serial port")
        self._handle = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        if not os.isatty(self._handle):
            os.close(self._handle)
            raise OSError(errno.ENOTTY, "it is no serial port")
        if isinstance(device, BoardIdentity) and not device.is_behind(self._handle):
            os.close(self._handle)
            raise OSError(errno.ENOENT, "its name stands for another device now")
        self._output, self._name = SerialOutput(self._handle), port
        self._sent_at = 0.0

    def send(self, frames: bytes, baud: int, held: bool) -> None:
        """Write, without waiting for an answer. A port that another program holds has its speed already.

        Raises `BlockedOutputError` where the port does not take them in time, also after it was unblocked.
        """
        try:
            self._output.unblock()
            if not held:
                self._set(baud)
            self._output.send(frames, baud, _PATIENCE)
            log_frame(_logger, "to", self._name, frames)
            self._sent_at = time.monotonic() + len(frames) * BITS_A_BYTE / baud
        except BlockedOutputError:
            raise
        except (termios.error, OSError):  # a lost port: the proof finds it
            pass

    def _set(self, baud: int) -> None:
        mode = termios.tcgetattr(self._handle)
        speed = _SPEED.get(baud, termios.B9600)
        control = termios.CS8 | termios.CREAD | termios.CLOCAL | speed
        raw: list[object] = [0, 0, control, 0, speed, speed, mode[6]]
        if mode[:6] != raw[:6]:
            time.sleep(max(self._sent_at - time.monotonic(), 0.0))  # it may still send
            termios.tcsetattr(self._handle, termios.TCSANOW, raw)  # type: ignore[arg-type]

    def is_free(self) -> bool:
        """Whether no process holds the lock now."""
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        fcntl.flock(self._handle, fcntl.LOCK_UN)
        return True

    def close(self) -> None:
        os.close(self._handle)
