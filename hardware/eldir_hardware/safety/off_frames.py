"""The frames that open every contact, and a port that is written without its lock: for `eldir rig off`."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
import termios
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from eldir_hardware._serial_output import BITS_PER_BYTE, BlockedOutputError, SerialOutput, log_frame
from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.relay.line import SerialLine
from eldir_hardware.relay.registration import get_board
from eldir_hardware.rig.board_identity import BoardIdentity, Port, locate

_WRITE_TIMEOUT = 0.2  # with a port that does not take the bytes [s]
_logger = logging.getLogger(__name__)
_BAUD_CODES = {9600: termios.B9600, 19200: termios.B19200, 38400: termios.B38400, 57600: termios.B57600}


class RecordingLine(SerialLine):
    """A line without a port that records what a driver writes, and never answers."""

    def __init__(self, baud: int):
        self._clock = VirtualClock()
        self.url, self.baud, self.bytes_written, self.sent_at = "nowhere", baud, 0, 0.0
        self.frames: list[bytes] = []

    def write(self, data: bytes) -> None:
        self.frames.append(data)
        self.bytes_written += len(data)

    def unblock(self) -> None:
        """Its output cannot be stopped."""

    def close(self) -> None:
        """There is nothing to close."""

    def _exchange(self, query: bytes, max_length: int, read: Callable[[], bytes]) -> bytes:
        self.write(query)
        return b""


def off_frames(kind: str, channels: int | None = None) -> bytes:
    """The frames with which the driver of a kind opens every contact, for boards of every size.

    The frames for `channels` channels come first; each frame occurs once. Raises `InputError` for an
    unknown kind.
    """
    board = get_board(kind)
    counts = [*([channels] if channels else []), *range(board.max_channels, 0, -1)]
    frames = [frame for count in counts for frame in _record_off_frames(board.driver, count)]
    return b"".join(dict.fromkeys(frames))


def off_bursts(candidates: Sequence[tuple[str, int | None]]) -> list[tuple[bytes, int]]:
    """Frames and baud rate for each kind and number of channels that a board may have.

    If there are several, each frame is repeated: the frame of another kind may have left bytes in the board's
    input that make the first one unreadable.
    """
    repetitions = 1 if len(candidates) == 1 else 2
    return [(repetitions * off_frames(kind, n), get_board(kind).driver.baud) for kind, n in candidates]


def _record_off_frames(driver: type[RelayBoard], channels: int) -> list[bytes]:
    line = RecordingLine(driver.baud)
    with suppress(RelayError):  # there is no answer
        driver(line, channels, VirtualClock())._command_all_off()
    return line.frames


_BAUD_CODES |= {115200: termios.B115200}


class UnlockedPort:
    """A port that is written without its lock, while another program may hold it."""

    def __init__(self, device: Port):
        """Raises `OSError` for a port that cannot be opened, is not a serial port, or is not that device."""
        port = locate(device) if isinstance(device, BoardIdentity) else device
        if port is None:
            raise OSError(errno.ENOENT, "it is not connected")
        if not stat.S_ISCHR(os.stat(port).st_mode):
            raise OSError(errno.ENOTTY, "it is not a serial port")
        self._handle = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        if not os.isatty(self._handle):
            os.close(self._handle)
            raise OSError(errno.ENOTTY, "it is not a serial port")
        if isinstance(device, BoardIdentity) and not device.is_open_as(self._handle):
            os.close(self._handle)
            raise OSError(errno.ENOENT, "its name refers to another device now")
        self._output, self._name = SerialOutput(self._handle), port
        self._transmitted_at = 0.0

    def send(self, frames: bytes, baud: int, is_held: bool) -> None:
        """Write without waiting for an answer. `is_held`: another program has set the baud rate.

        Raises `BlockedOutputError` if the port does not accept the frames in time, also after unblocking.
        """
        try:
            self._output.unblock()
            if not is_held:
                self._set_baud(baud)
            self._output.send(frames, baud, _WRITE_TIMEOUT)
            log_frame(_logger, "to", self._name, frames)
            self._transmitted_at = time.monotonic() + len(frames) * BITS_PER_BYTE / baud
        except BlockedOutputError:
            raise
        except (termios.error, OSError):  # the port was lost, which the proof detects
            pass

    def _set_baud(self, baud: int) -> None:
        mode = termios.tcgetattr(self._handle)
        speed = _BAUD_CODES.get(baud, termios.B9600)
        control = termios.CS8 | termios.CREAD | termios.CLOCAL | speed
        raw: list[object] = [0, 0, control, 0, speed, speed, mode[6]]
        if mode[:6] != raw[:6]:
            # Earlier bytes may still be transmitted.
            time.sleep(max(self._transmitted_at - time.monotonic(), 0.0))
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
