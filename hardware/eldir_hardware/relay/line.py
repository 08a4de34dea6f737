"""The serial line to a board, opened exclusively; its failures become relay errors."""

from __future__ import annotations

import errno
import logging
import os
import termios
from collections.abc import Callable, Sequence
from contextlib import suppress

import serial

from eldir_hardware._serial_output import (
    BITS_PER_BYTE,
    BlockedOutputError,
    SerialOutput,
    log_dropped,
    log_frame,
)
from eldir_hardware.clock import Clock
from eldir_hardware.relay.errors import (
    BlockedPortError,
    GarbledReplyError,
    PortError,
    RelayError,
    SilentBoardError,
)

_LOST = (serial.SerialException, OSError, termios.error)
_MAX_LATE = 8  # answers to earlier queries that are dropped; more mean a fault
_EXCESS = 40  # bytes beyond the longest answer that are read, for the message
_IDLE = 0.06  # silence that ends an answer; USB adapters deliver bytes at least every 16 ms [s]

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
        """When the last written byte has been transmitted [s on the clock]."""
        _logger.info("opened %s at %d baud", url, baud)

    @property
    def file_descriptor(self) -> int:
        """File descriptor of the port; it stays this device even if the name of the port changes."""
        return int(self._port.fileno())

    def wire_time(self, count: int) -> float:
        """Duration of `count` bytes on the wire [s]."""
        return count * BITS_PER_BYTE / self.baud

    def write(self, data: bytes) -> None:
        """Send all of `data`. Raises `PortError` if the port is lost or does not accept it in time."""
        begun = max(self._clock.now(), self.sent_at)
        try:
            self._output.send(data, self.baud, self._clock.patience)
        except BlockedOutputError:
            raise BlockedPortError(
                f"the port {self.url} accepts no more bytes", remedy="cut the heating supply now"
            ) from None
        except _LOST as error:
            raise self._lost(error) from None
        log_frame(_logger, "to", self.url, data)
        self.bytes_written += len(data)
        self.sent_at = begun + self.wire_time(len(data))

    def unblock(self) -> None:
        """Restart the output if another program has stopped it; waiting bytes are dropped."""
        self._output.unblock()

    def query(self, query: bytes, length: int) -> bytes:
        """Send `query` and return its answer of `length` bytes; older input is dropped first."""
        answer = self._exchange(query, length, lambda: self._port.read(length))
        if len(answer) < length:
            raise self._incomplete(f"{length} bytes", answer)
        return answer

    def query_until(
        self,
        query: bytes,
        end: bytes,
        max_length: int,
        is_late: Callable[[bytes], bool] = lambda answer: False,
    ) -> bytes:
        """Send `query` and return the answer up to and including `end`, of at most `max_length` bytes.

        `is_late` recognises answers to earlier queries, which are dropped, if the protocol numbers them.
        """

        def read() -> bytes:
            answer = bytes(self._port.read_until(end, max_length))
            for _ in range(_MAX_LATE):
                if not is_late(answer) or not (following := bytes(self._port.read_until(end, max_length))):
                    break
                log_frame(_logger, "dropped from", self.url, answer)
                answer = following
            return answer

        answer = self._exchange(query, max_length, read)
        if not answer:
            raise self._incomplete(f"bytes up to {end!r}", answer)
        return answer

    def query_until_idle(self, query: bytes, min_length: int, max_length: int) -> bytes:
        """Send `query` and return its answer of at least `min_length` bytes, which ends with silence.

        An answer longer than `max_length` is returned with some of the excess, for the driver to refuse.
        """

        def read() -> bytes:
            answer = bytes(self._port.read(min_length))
            self._port.timeout = _IDLE
            while min_length <= len(answer) < max_length + _EXCESS and (byte := self._port.read(1)):
                answer += byte
            return answer

        answer = self._exchange(query, max_length, read)
        if len(answer) < min_length:
            raise self._incomplete(f"{min_length} bytes", answer)
        return answer

    def query_each(self, queries: Sequence[bytes], max_length: int) -> bytes:
        """Send queries that may have no answer, each after the time of an answer of `max_length` bytes.

        Returns all answers.
        """

        def read() -> bytes:
            for query in queries[1:]:
                asked_at = self._clock.now()
                self.write(query)
                self._clock.sleep_until(asked_at + self.wire_time(len(query) + max_length))
            self._port.timeout = _IDLE
            return bytes(self._port.read(len(queries) * max_length))

        return self._exchange(queries[0], max_length, read)

    def _exchange(self, query: bytes, max_length: int, read: Callable[[], bytes]) -> bytes:
        asked_at = self._clock.now()
        try:
            log_dropped(_logger, self.url, self._port)
            self._port.reset_input_buffer()
            self.write(query)
            self._port.timeout = self.wire_time(len(query) + max_length) + self._clock.patience
            answer = bytes(read())
        except _LOST as error:
            raise self._lost(error) from None
        log_frame(_logger, "from", self.url, answer)
        # On a wall clock this time has passed; a virtual clock is advanced by it.
        self._clock.sleep_until(asked_at + self.wire_time(len(query) + len(answer)))
        return answer

    def _lost(self, error: Exception) -> PortError:
        return PortError(f"the port {self.url} was lost: {error}", remedy="cut the heating supply now")

    def _incomplete(self, expected: str, answer: bytes) -> RelayError:
        """The error for silence, or for an answer that is too short, as at another baud rate."""
        if not answer:
            return SilentBoardError(
                f"the relay board at {self.url} did not answer",
                expected=expected,
                found="none",
                remedy="check its power and its kind in the rig file",
            )
        return GarbledReplyError(
            f"the answer of the relay board at {self.url} is too short",
            expected=expected,
            found=answer.hex(" "),
            remedy="check its kind and its number of relays in the rig file, and that it is set to "
            f"{self.baud} baud (Modbus: unit 1)",
        )

    def close(self) -> None:
        """Close the port. The contacts stay as they are: switch off first."""
        with suppress(*_LOST):
            log_dropped(_logger, self.url, self._port)
        self._port.close()
        _logger.info("closed %s", self.url)


def _reason(error: Exception) -> str:
    """Why a port cannot be opened, without the repeated parts of pyserial's message."""
    number = getattr(error, "errno", None)
    if number == errno.EAGAIN:
        return "another program has it open"
    return str(error) if number is None else os.strerror(number)
