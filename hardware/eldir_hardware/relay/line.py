"""The serial line to a board: only this process can open it, and its failures become relay errors."""

from __future__ import annotations

import errno
import logging
import os
import termios
from collections.abc import Callable, Sequence
from contextlib import suppress

import serial

from eldir_hardware.clock import Clock
from eldir_hardware.relay.errors import (
    BlockedPortError,
    GarbledReplyError,
    PortError,
    RelayError,
    SilentBoardError,
)
from eldir_hardware.serial_output import BITS_A_BYTE, BlockedOutputError, SerialOutput, log_dropped, log_frame

_LOST = (serial.SerialException, OSError, termios.error)
_MOST_LATE = 8  # answers to earlier queries; more of them come from a board that does not listen
_BEYOND = 40  # bytes of an answer that is too long, for the message
_IDLE = 0.06  # without a byte an answer has ended; USB adapters pass bytes on every 16 ms at least [s]

_logger = logging.getLogger(__name__)


class SerialLine:
    """Bytes to and from one port."""

    def __init__(self, url: str, baud: int, clock: Clock):
        try:
            self._port = serial.serial_for_url(url, baudrate=baud, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise PortError(
                f"cannot open the relay board's port {url}: {_reason(error)}",
                remedy="check the cable and the port in the rig file, and that no other program has it open",
            ) from None
        self._output = SerialOutput(self._port.fileno())
        self._output.unblock()
        self._clock = clock
        self.url = url
        self.baud = baud
        self.bytes_written = 0
        self.sent_at = clock.now()
        """When the last byte that was written has left the wire [s on the clock]."""
        _logger.info("opened %s at %d baud", url, baud)

    @property
    def handle(self) -> int:
        """The open file of the port: it stays this device, whatever becomes of its name."""
        return int(self._port.fileno())

    def wire_time(self, count: int) -> float:
        """`count` bytes take this long [s]."""
        return count * BITS_A_BYTE / self.baud

    def write(self, data: bytes) -> None:
        """Send all of `data`. Raises `PortError` where the port is lost or does not take it in time."""
        begun = max(self._clock.now(), self.sent_at)
        try:
            self._output.send(data, self.baud, self._clock.patience)
        except BlockedOutputError:
            raise BlockedPortError(
                f"the port {self.url} takes no more bytes", remedy="cut the heating supply now"
            ) from None
        except _LOST as error:
            raise self._lost(error) from None
        log_frame(_logger, "to", self.url, data)
        self.bytes_written += len(data)
        self.sent_at = begun + self.wire_time(len(data))

    def unblock(self) -> None:
        """Start the output again where another program has stopped it; what waited there is dropped."""
        self._output.unblock()

    def ask(self, query: bytes, length: int) -> bytes:
        """Send `query` and return the `length` bytes of the answer; older bytes are dropped first."""
        answer = self._exchange(query, length, lambda: self._port.read(length))
        if len(answer) < length:
            raise self._incomplete(f"{length} bytes", answer)
        return answer

    def ask_until(
        self, query: bytes, end: bytes, most: int, late: Callable[[bytes], bool] = lambda answer: False
    ) -> bytes:
        """Send `query` and return the answer up to and with `end`, of at most so many bytes.

        `late` tells answers to earlier queries, where the protocol numbers them; the one after them counts.
        """

        def read() -> bytes:
            answer = bytes(self._port.read_until(end, most))
            for _ in range(_MOST_LATE):
                if not late(answer) or not (following := bytes(self._port.read_until(end, most))):
                    break
                log_frame(_logger, "dropped from", self.url, answer)
                answer = following
            return answer

        answer = self._exchange(query, most, read)
        if not answer:
            raise self._incomplete(f"bytes up to {end!r}", answer)
        return answer

    def ask_all(self, query: bytes, least: int, most: int) -> bytes:
        """Send `query` and return its answer of `least` to `most` bytes, which ends when the line is idle.

        Some bytes beyond `most` are returned too, for the driver to refuse.
        """

        def read() -> bytes:
            answer = bytes(self._port.read(least))
            self._port.timeout = _IDLE
            while least <= len(answer) < most + _BEYOND and (byte := self._port.read(1)):
                answer += byte
            return answer

        answer = self._exchange(query, most, read)
        if len(answer) < least:
            raise self._incomplete(f"{least} bytes", answer)
        return answer

    def ask_each(self, queries: Sequence[bytes], most: int) -> bytes:
        """Send queries that may have no answer, each when the answer before it, of at most so many bytes, can
        have ended; return all answers."""

        def read() -> bytes:
            for query in queries[1:]:
                asked_at = self._clock.now()
                self.write(query)
                self._clock.sleep_until(asked_at + self.wire_time(len(query) + most))
            self._port.timeout = _IDLE
            return bytes(self._port.read(len(queries) * most))

        return self._exchange(queries[0], most, read)

    def _exchange(self, query: bytes, most: int, read: Callable[[], bytes]) -> bytes:
        asked_at = self._clock.now()
        try:
            log_dropped(_logger, self.url, self._port)
            self._port.reset_input_buffer()
            self.write(query)
            self._port.timeout = self.wire_time(len(query) + most) + self._clock.patience
            answer = bytes(read())
        except _LOST as error:
            raise self._lost(error) from None
        log_frame(_logger, "from", self.url, answer)
        # On a wall clock this has passed already; a virtual one learns of it here.
        self._clock.sleep_until(asked_at + self.wire_time(len(query) + len(answer)))
        return answer

    def _lost(self, error: Exception) -> PortError:
        return PortError(f"the port {self.url} was lost: {error}", remedy="cut the heating supply now")

    def _incomplete(self, expected: str, answer: bytes) -> RelayError:
        """Silence; or an answer that is none of this board's, as at another speed or from another unit."""
        if not answer:
            return SilentBoardError(
                f"the relay board at {self.url} did not answer",
                expected=expected,
                found="none",
                remedy="check its power and its kind in the rig file",
            )
        return GarbledReplyError(
            f"the relay board at {self.url} answered with too few bytes",
            expected=expected,
            found=answer.hex(" "),
            remedy=f"check its kind in the rig file, and that it is set to {self.baud} baud (Modbus: unit 1)",
        )

    def close(self) -> None:
        """Closing leaves the contacts as they are: switch off first."""
        with suppress(*_LOST):
            log_dropped(_logger, self.url, self._port)
        self._port.close()
        _logger.info("closed %s", self.url)


def _reason(error: Exception) -> str:
    """Why a port cannot be opened, without the repetition in pyserial's message."""
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:
        return "another program has it open"
    return str(error) if number is None else os.strerror(number)
