"""The frames that open every contact: `eldir rig off` sends them before the port is its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.relay.line import SerialLine
from eldir_hardware.relay.registration import board_of


class RecordedLine(SerialLine):
    """A line without a port that keeps what a driver writes, and never answers."""

    def __init__(self, baud: int):
        self._clock = VirtualClock()
        self.url, self.baud, self.bytes_written, self.sent_at = "nowhere", baud, 0, 0.0
        self.frames: list[bytes] = []

    @property
    def written(self) -> bytes:
        """All that was written."""
        return b"".join(self.frames)

    def write(self, data: bytes) -> None:
        self.frames.append(data)
        self.bytes_written += len(data)

    def unblock(self) -> None:
        """Nothing can stop it."""

    def close(self) -> None:
        """There is nothing to close."""

    def _exchange(self, query: bytes, most: int, read: Callable[[], bytes]) -> bytes:
        self.write(query)
        return b""


def off_frames(kind: str, channels: int | None = None) -> bytes:
    """What the driver of a kind writes to open every contact, of boards of every size of this kind.

    The frames for a board of `channels` channels come first; each comes once. Raises `InputError` for an
    unknown kind.
    """
    board = board_of(kind)
    counts = [*([channels] if channels else []), *range(board.most_channels, 0, -1)]
    frames = [frame for count in counts for frame in _written(board.driver, count)]
    return b"".join(dict.fromkeys(frames))


def off_bursts(candidates: Sequence[tuple[str, int | None]]) -> list[tuple[bytes, int]]:
    """Frames and baud rate for each kind and number of channels that a board may have.

    If there are several, each frame comes twice: what another kind's frame left in the board's input may
    make the first one unreadable.
    """
    times = 1 if len(candidates) == 1 else 2
    return [(times * off_frames(kind, n), board_of(kind).driver.baud) for kind, n in candidates]


def _written(driver: type[RelayBoard], channels: int) -> list[bytes]:
    line = RecordedLine(driver.baud)
    with suppress(RelayError):  # nobody answers
        driver(line, channels, VirtualClock())._command_all_off()
    return line.frames
