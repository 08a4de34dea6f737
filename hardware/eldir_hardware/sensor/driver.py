"""Asks the microcontroller for currents and voltages, and waits for its answer only so long.

Lines of the protocol are a letter, a sequence number, words, and a CRC.
"""

from __future__ import annotations

import logging
import termios
import time
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from typing import NamedTuple

import serial

from eldir_hardware.clock import Clock
from eldir_hardware.sensor.chips import CHIPS, Chip
from eldir_hardware.sensor.errors import SensorError
from eldir_hardware.serial_output import BITS_A_BYTE, SerialOutput, log_dropped, log_frame

BAUD = 115200
_ATTEMPTS = 2  # at a damaged answer; silence is waited out once
_LONGEST_WINDOW = 0.1  # a measurement that takes longer would hold the guardian up [s]
_LOST = (serial.SerialException, OSError, termios.error)
_logger = logging.getLogger(__name__)
_FAULTS = {"lost": "does not answer", "slow": "does not finish its measurements"}
_MAX_LINE = 512  # bytes: sixteen inputs take 300


class Measurement(NamedTuple):
    """What was measured after one question; an input that is not connected to a channel is left out."""

    began: float
    """When the question was sent: everything in it is younger [s on the clock]."""
    currents: dict[int, float]
    """Current through each relay channel's spring [A]."""
    voltages: dict[int, float]
    """Voltage across that spring [V]."""
    saturated: frozenset[int]
    """Channels whose current is beyond the full scale: it is at least the one given."""


class CurrentSensor:
    """A microcontroller with chips of one kind. Input i measures relay channel `channels[i]`."""

    def __init__(
        self,
        url: str,
        kind: str,
        channels: Sequence[int],
        clock: Clock,
        *,
        shunt: float = 0.01,
        lead: float = 0.0,
    ):
        """Open the port and identify the chips. Raises `SensorError`.

        `shunt`: resistance of each shunt [Ohm]; `lead`: of the leads between the voltage's tap and the
        spring [Ohm].
        """
        self._url, self._kind, self._channels, self._clock = url, kind, tuple(channels), clock
        self._chip: Chip = CHIPS[kind]
        self._shunt, self._lead = shunt, lead
        self._sequence = 0
        self._window = 0.0
        self.bytes_written = 0
        """Bytes written to the line since it was opened."""
        try:
            self._port = serial.serial_for_url(url, baudrate=BAUD, exclusive=True)
        except (*_LOST, ValueError) as error:
            raise SensorError(
                f"cannot open the current sensor's port {url}: {error}",
                remedy="check the cable and sensor.port, and that no other program has it open",
            ) from None
        self._output = SerialOutput(self._port.fileno())
        self._output.unblock()
        try:
            self._inputs = self._identify()
        except SensorError:
            self.close()
            raise
        _logger.info("opened %s: %s with %d inputs", url, kind, self._inputs)

    @property
    def handle(self) -> int:
        """The open file of its port."""
        return int(self._port.fileno())

    @property
    def query_time(self) -> float:
        """Duration of a question and its answer [s]."""
        return self._wire_time(10 + 12 + 12 * self._inputs) + self._window

    def measure(self) -> Measurement:
        """Currents and voltages after this instant. Raises `SensorError`."""
        began = self._clock.now()
        words = self._ask("M", self._window)
        try:
            counts = [tuple(int(n) for n in word.split(",")) for word in words]
            pairs = [(shunt, bus) for shunt, bus in counts]
        except ValueError:
            raise self._garbled(" ".join(words)) from None
        if len(pairs) != self._inputs:
            raise self._garbled(f"{len(pairs)} inputs instead of {self._inputs}")
        currents, voltages, saturated = {}, {}, set()
        for channel, (shunt, bus) in zip(self._channels, pairs, strict=False):
            currents[channel] = shunt * self._chip.shunt_count / self._shunt
            voltages[channel] = bus * self._chip.bus_count - currents[channel] * self._lead
            if abs(shunt) >= self._chip.most_counts:
                saturated.add(channel)
        return Measurement(began, currents, voltages, frozenset(saturated))

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _identify(self) -> int:
        """Number of inputs. Raises `SensorError` where the chips are not those of the rig file."""
        words = self._ask("I", 0.0)
        try:
            kind, (inputs, shunt_nv, bus_uv, window_us) = words[0], (int(w) for w in words[1:])
        except ValueError:
            raise self._garbled(" ".join(words)) from None
        counts = (round(1e9 * self._chip.shunt_count), round(1e6 * self._chip.bus_count))
        if inputs and (kind, shunt_nv, bus_uv) != (self._kind, *counts):
            raise SensorError(
                "the current sensor has other chips than the rig file says",
                expected=f"{self._kind}, counts of {counts[0]} nV and {counts[1]} uV",
                found=f"{kind}, counts of {shunt_nv} nV and {bus_uv} uV",
                remedy="correct sensor.kind",
            )
        if inputs < len(self._channels):
            raise SensorError(
                "the current sensor measures too few channels",
                expected=f"{len(self._channels)}, as many as the rig file's sensor.channels",
                found=f"chips with {inputs} inputs",
                remedy="check the chips' supply, I2C wires and addresses",
            )
        self._window = window_us * 1e-6
        if self._window > _LONGEST_WINDOW:
            raise SensorError(
                "the current sensor is too slow",
                expected=f"a measurement within {_LONGEST_WINDOW:g} s",
                found=f"{self._window:g} s",
            )
        return inputs

    def _ask(self, letter: str, window: float) -> list[str]:
        """The words of the answer. A damaged one is asked for again."""
        for attempt in range(_ATTEMPTS):
            asked_at = self._clock.now()
            self._sequence = (self._sequence + 1) % 256
            asked = question(letter, self._sequence)
            length, words = self._exchange(asked, window)
            # On a wall clock this has passed already; a virtual one learns of it here.
            self._clock.sleep_until(asked_at + self._wire_time(len(asked) + length) + window)
            if words is None and attempt < _ATTEMPTS - 1:
                continue
            if words is None or words[0] not in (letter, "E"):
                raise self._garbled("another answer" if words else "lines with a wrong check sum")
            if words[0] == "E":
                fault, address = [*words[2:], "", ""][:2]
                raise SensorError(
                    f"the current sensor's chip at I2C address 0x{address} {_FAULTS.get(fault, fault)}",
                    remedy="check its supply and its I2C wires",
                )
            return words[2:]
        raise AssertionError("unreachable")

    def _exchange(self, asked: bytes, window: float) -> tuple[int, list[str] | None]:
        """Bytes and words of the answer to this very question; no words where it is damaged.

        Answers to earlier questions, which came late, are dropped. Raises `SensorError` at silence.
        """
        self._guarded(lambda: log_dropped(_logger, self._url, self._port))
        self._guarded(self._port.reset_input_buffer)
        self._guarded(lambda: self._output.send(asked, BAUD, self._clock.patience))
        log_frame(_logger, "to", self._url, asked)
        self.bytes_written += len(asked)
        deadline = time.monotonic() + self._wire_time(len(asked) + _MAX_LINE) + window + self._clock.patience
        while (left := deadline - time.monotonic()) > 0:
            self._port.timeout = left
            line = bytes(self._guarded(lambda: self._port.read_until(b"\n", _MAX_LINE)))
            log_frame(_logger, "from", self._url, line)
            if not line.endswith(b"\n") and len(line) < _MAX_LINE:
                break
            words = words_of(line)
            if words is None:
                return len(line), None
            if len(words) > 1 and words[1] == f"{self._sequence:02X}":
                return len(line), words
        raise SensorError(
            f"the current sensor at {self._url} did not answer",
            remedy="check its cable and sensor.port in the rig file",
        )

    def _guarded(self, act: Callable[[], object]) -> bytes:
        try:
            done = act()
        except _LOST as error:
            raise SensorError(
                f"the current sensor's port {self._url} was lost: {error}", remedy="check its cable"
            ) from None
        return done if isinstance(done, bytes) else b""

    def _garbled(self, found: str) -> SensorError:
        return SensorError(
            f"the answer of the current sensor at {self._url} cannot be read",
            found=found,
            remedy="check its cable and its program",
        )

    def _wire_time(self, count: int) -> float:
        return count * BITS_A_BYTE / BAUD


def question(letter: str, sequence: int) -> bytes:
    """A question to the microcontroller; `sequence` is 0 to 255."""
    text = f"{letter} {sequence:02X}".encode()
    return text + b"*%04X\n" % crc_hqx(text, 0xFFFF)


def words_of(line: bytes) -> list[str] | None:
    """The words of a line; None where it is damaged."""
    body, star, check = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or check != b"%04X" % crc_hqx(body, 0xFFFF):
        return None
    try:
        return body.decode("ascii").split(" ")
    except UnicodeDecodeError:
        return None
