"""The current sensor: data of its chips, and the driver of the microcontroller that reads them.

INA226: Texas Instruments SBOS547B; INA3221: SBOS576A; section "Electrical characteristics", 25 C. Lines
of the protocol are a letter, a sequence number, words, and a CRC.
"""

from __future__ import annotations

import logging
import termios
import time
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import serial

from eldir.errors import EldirError
from eldir_hardware._serial_output import BITS_PER_BYTE, SerialOutput, log_dropped, log_frame
from eldir_hardware.clock import Clock

_MIN_ZERO_CURRENT = 0.010  # leakage and noise of the leads [A]
_NOISE_COUNTS = 2.0  # counts, with rounding; averages of four
_ZERO_FACTOR = 3.0  # offsets drift with temperature and supply
BAUD = 115200
_ATTEMPTS = 2  # to read a damaged answer; after silence there is no second attempt
_MAX_WINDOW = 0.1  # a longer measurement would delay the guardian [s]
_PORT_ERRORS = (serial.SerialException, OSError, termios.error)
_logger = logging.getLogger(__name__)
_FAULTS = {"lost": "does not answer", "slow": "does not finish its measurements"}
_MAX_LINE = 512  # bytes: sixteen inputs take 300


@dataclass(frozen=True)
class Chip:
    """Data of one kind of chip. Errors are the maximum values of its data sheet."""

    inputs: int
    shunt_count: float
    """Shunt voltage of one count [V]."""
    bus_count: float
    """Bus voltage of one count [V]."""
    max_count: int
    """Count at which the shunt voltage saturates."""
    max_voltage: float
    """Highest voltage at an input [V]."""
    shunt_offset: float
    """[V]."""
    bus_offset: float
    """[V]."""
    gain_error: float
    """Of shunt and bus voltage, relative."""

    def full_scale_current(self, shunt: float) -> float:
        """Current at which a shunt of so many ohms saturates the input [A]."""
        return self.max_count * self.shunt_count / shunt

    def zero_current(self, shunt: float) -> float:
        """Currents below this cannot be distinguished from zero [A]."""
        return max(_MIN_ZERO_CURRENT, _ZERO_FACTOR * (self.shunt_offset + self.shunt_count) / shunt)

    def min_shunt(self, current: float) -> float:
        """The smallest shunt with which `current` can be distinguished from zero [Ohm]."""
        return _ZERO_FACTOR * (self.shunt_offset + self.shunt_count) / current

    def current_error(self, shunt: float, tolerance: float, current: float) -> float:
        """Largest error of a current, with that tolerance of the shunt [A]."""
        offset = (self.shunt_offset + _NOISE_COUNTS * self.shunt_count) / shunt
        return offset + (self.gain_error + tolerance) * abs(current)

    def voltage_error(self, voltage: float) -> float:
        """Largest error of a voltage [V]."""
        return self.bus_offset + _NOISE_COUNTS * self.bus_count + self.gain_error * abs(voltage)


CHIPS = {
    "ina226": Chip(1, 2.5e-6, 1.25e-3, 32767, 36.0, 10e-6, 7.5e-3, 1e-3),
    "ina3221": Chip(3, 40e-6, 8e-3, 4095, 26.0, 80e-6, 16e-3, 2.5e-3),
}
"""The kinds that a rig file may name."""


class SensorError(EldirError):
    """The current sensor does not work: the heat is not measured."""

    code = "sensor"


class Measurement(NamedTuple):
    """Result of one measurement; inputs without a channel are left out."""

    started_at: float
    """When the request was sent: the measurement is not older [s on the clock]."""
    currents: dict[int, float]
    """Current through each relay channel's spring [A]."""
    voltages: dict[int, float]
    """Voltage across that spring [V]."""
    saturated: frozenset[int]
    """Channels whose current exceeds the full scale: it is at least the given one."""


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
        except (*_PORT_ERRORS, ValueError) as error:
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
    def file_descriptor(self) -> int:
        """File descriptor of its port."""
        return int(self._port.fileno())

    @property
    def query_time(self) -> float:
        """Duration of a request and its answer [s]."""
        return self._wire_time(10 + 12 + 12 * self._inputs) + self._window

    def measure(self) -> Measurement:
        """Measure currents and voltages now. Raises `SensorError`."""
        started_at = self._clock.now()
        words = self._request("M", self._window)
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
            if abs(shunt) >= self._chip.max_count:
                saturated.add(channel)
        return Measurement(started_at, currents, voltages, frozenset(saturated))

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _identify(self) -> int:
        """Return the number of inputs. Raises `SensorError` if the chips are not those of the rig file."""
        words = self._request("I", 0.0)
        try:
            kind, (inputs, shunt_nv, bus_uv, window_us) = words[0], (int(w) for w in words[1:])
        except ValueError:
            raise self._garbled(" ".join(words)) from None
        counts = (round(1e9 * self._chip.shunt_count), round(1e6 * self._chip.bus_count))
        if inputs and (kind, shunt_nv, bus_uv) != (self._kind, *counts):
            raise SensorError(
                "the current sensor's chips differ from those of the rig file",
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
        if self._window > _MAX_WINDOW:
            raise SensorError(
                "the current sensor is too slow",
                expected=f"a measurement within {_MAX_WINDOW:g} s",
                found=f"{self._window:g} s",
            )
        return inputs

    def _request(self, letter: str, window: float) -> list[str]:
        """Send a request and return the words of its answer. A damaged answer is requested again."""
        for attempt in range(_ATTEMPTS):
            sent_at = self._clock.now()
            self._sequence = (self._sequence + 1) % 256
            request = make_request(letter, self._sequence)
            length, words = self._exchange(request, window)
            # On a wall clock this time has passed; a virtual clock is advanced by it.
            self._clock.sleep_until(sent_at + self._wire_time(len(request) + length) + window)
            if words is None and attempt < _ATTEMPTS - 1:
                continue
            if words is None or words[0] not in (letter, "E"):
                raise self._garbled(
                    "the answer to another request" if words else "lines with a wrong checksum"
                )
            if words[0] == "E":
                fault, address = [*words[2:], "", ""][:2]
                raise SensorError(
                    f"the current sensor's chip at I2C address 0x{address} {_FAULTS.get(fault, fault)}",
                    remedy="check its supply and its I2C wires",
                )
            return words[2:]
        raise AssertionError("unreachable")

    def _exchange(self, request: bytes, window: float) -> tuple[int, list[str] | None]:
        """Length and words of the answer to this request; no words if it is damaged.

        Late answers to earlier requests are dropped. Raises `SensorError` for silence.
        """
        self._use_port(lambda: log_dropped(_logger, self._url, self._port))
        self._use_port(self._port.reset_input_buffer)
        self._use_port(lambda: self._output.send(request, BAUD, self._clock.patience))
        log_frame(_logger, "to", self._url, request)
        self.bytes_written += len(request)
        deadline = (
            time.monotonic() + self._wire_time(len(request) + _MAX_LINE) + window + self._clock.patience
        )
        while (left := deadline - time.monotonic()) > 0:
            self._port.timeout = left
            line = bytes(self._use_port(lambda: self._port.read_until(b"\n", _MAX_LINE)))
            log_frame(_logger, "from", self._url, line)
            if not line.endswith(b"\n") and len(line) < _MAX_LINE:
                break
            words = parse_line(line)
            if words is None:
                return len(line), None
            if len(words) > 1 and words[1] == f"{self._sequence:02X}":
                return len(line), words
        raise SensorError(
            f"the current sensor at {self._url} did not answer",
            remedy="check its cable and sensor.port in the rig file",
        )

    def _use_port(self, action: Callable[[], object]) -> bytes:
        try:
            result = action()
        except _PORT_ERRORS as error:
            raise SensorError(
                f"the current sensor's port {self._url} was lost: {error}", remedy="check its cable"
            ) from None
        return result if isinstance(result, bytes) else b""

    def _garbled(self, found: str) -> SensorError:
        return SensorError(
            f"invalid answer of the current sensor at {self._url}",
            found=found,
            remedy="check its cable and its program",
        )

    def _wire_time(self, count: int) -> float:
        return count * BITS_PER_BYTE / BAUD


def make_request(letter: str, sequence: int) -> bytes:
    """A request to the microcontroller; `sequence` is 0 to 255."""
    text = f"{letter} {sequence:02X}".encode()
    return text + b"*%04X\n" % crc_hqx(text, 0xFFFF)


def parse_line(line: bytes) -> list[str] | None:
    """The words of a line; None if it is damaged."""
    body, star, check = line.rstrip(b"\r\n").rpartition(b"*")
    if not star or check != b"%04X" % crc_hqx(body, 0xFFFF):
        return None
    try:
        return body.decode("ascii").split(" ")
    except UnicodeDecodeError:
        return None
