"""An emulated current sensor: it runs the microcontroller's program on emulated INA226 and INA3221 chips.

The chips are written register by register from their data sheets (TI SBOS547B, SBOS576A), not from that
program.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from errno import EIO

import numpy as np

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.firmware.current_sensor import Bus, CurrentSensor

_AVERAGES = (1, 4, 16, 64, 128, 256, 512, 1024)
_CONVERSIONS = (140e-6, 204e-6, 332e-6, 588e-6, 1.1e-3, 2.116e-3, 4.156e-3, 8.244e-3)  # [s]

CurrentAndVoltage = Callable[[float], tuple[float, float]]
"""Current through a shunt [A] and voltage behind it [V] at an instant [s on the clock]."""
_UNCONNECTED = (0.0, 0.0)


class MicrocontrollerClock:
    """The clock of a microcontroller, which runs ahead of a virtual clock while it waits for a chip."""

    def __init__(self, clock: Clock):
        self._clock = clock.follower()
        self._reached = 0.0

    def now(self) -> float:
        """[s on the clock]."""
        return max(self._clock.now(), self._reached)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self._reached = self.now() + seconds
        self._clock.sleep_until(self._reached)


@dataclass
class ChipFaults:
    """Faults of one chip; they can be changed at any time."""

    missing: bool = False
    """Whether it does not answer on I2C."""
    stuck: bool = False
    """Whether its converter is stopped, so that no measurement completes."""


@dataclass
class _Input:
    """One shunt and its amplifier."""

    source: CurrentAndVoltage
    shunt: float
    shunt_offset: float
    bus_offset: float
    shunt_gain: float
    bus_gain: float


class InaChip(ABC):
    """Registers of 16 bits. Offset and gain are random within the limits of the data sheet."""

    die: int
    power_on: int
    ready_register: int
    ready_bit: int
    shunt_count: float
    bus_count: float
    max_count: int
    unused_bits: int
    max_errors: tuple[float, float, float]
    """Offset of shunt and of bus [V], relative gain error."""

    def __init__(
        self,
        inputs: list[CurrentAndVoltage],
        time: MicrocontrollerClock,
        shunts: list[float],
        rng: np.random.Generator,
    ):
        self.faults = ChipFaults()
        self._time, self._rng = time, rng
        shunt, bus, gain = self.max_errors
        self._inputs = [
            _Input(
                source,
                ohm,
                float(rng.uniform(-shunt, shunt)),
                float(rng.uniform(-bus, bus)),
                1.0 + float(rng.uniform(-gain, gain)),
                1.0 + float(rng.uniform(-gain, gain)),
            )
            for source, ohm in zip(inputs, shunts, strict=True)
        ]
        self._registers: dict[int, int] = {}
        self._started_at = self._ready_at = np.inf
        self._ready = False
        self._write_configuration(self.power_on)

    def read(self, register: int) -> int:
        """A register's 16 bits."""
        self._convert()
        if register == 0xFE:
            return 0x5449
        if register == 0xFF:
            return self.die
        if register == self.ready_register:
            ready, self._ready = self._ready, False
            return self.ready_bit if ready else 0
        return self._registers.get(register, 0)

    def write(self, register: int, value: int) -> None:
        """Only the configuration has an effect here."""
        if register == 0:
            self._convert()
            self._write_configuration(self.power_on if value & 0x8000 else value)

    def _write_configuration(self, value: int) -> None:
        self._registers[0] = value
        self._ready = False
        self._started_at = self._time.now()
        mode = value & 7
        self._ready_at = self._started_at + self._duration(value) if mode in (3, 7) else np.inf

    def _duration(self, value: int) -> float:
        one = _CONVERSIONS[value >> 6 & 7] + _CONVERSIONS[value >> 3 & 7]
        return float(_AVERAGES[value >> 9 & 7] * self._enabled(value) * one)

    def _convert(self) -> None:
        """Complete the measurements that end by now; in continuous mode only the latest is kept."""
        if self.faults.stuck or self._time.now() < self._ready_at:
            return
        continuous, duration = self._registers[0] & 7 == 7, self._duration(self._registers[0])
        if continuous:
            self._started_at += (int((self._time.now() - self._started_at) / duration + 1e-9) - 1) * duration
            self._ready_at = self._started_at + duration
        instants = np.linspace(self._started_at, self._ready_at, 8, endpoint=False)
        for number, source in enumerate(self._inputs):
            amperes, volts = np.mean([source.source(float(t)) for t in instants], axis=0)
            shunt = (amperes * source.shunt) * source.shunt_gain + source.shunt_offset
            bus = volts * source.bus_gain + source.bus_offset
            self._registers[1 + 2 * number] = self._to_register(shunt / self.shunt_count, -self.max_count - 1)
            self._registers[2 + 2 * number] = self._to_register(bus / self.bus_count, 0)
        self._ready = True
        self._started_at = self._ready_at
        self._ready_at = self._started_at + duration if continuous else np.inf

    def _to_register(self, counts: float, min_counts: int) -> int:
        noisy = round(counts + float(self._rng.normal(0.0, 0.3)))
        return min(max(noisy, min_counts), self.max_count) << self.unused_bits & 0xFFFF

    @abstractmethod
    def _enabled(self, value: int) -> int:
        """Number of inputs that this configuration measures."""


class EmulatedIna226(InaChip):
    """One input, 16 bits."""

    die = 0x2260
    power_on = 0x4127
    ready_register, ready_bit = 0x06, 0x0008
    shunt_count, bus_count, max_count, unused_bits = 2.5e-6, 1.25e-3, 32767, 0
    max_errors = (10e-6, 7.5e-3, 1e-3)

    def _enabled(self, value: int) -> int:
        return 1


class EmulatedIna3221(InaChip):
    """Three inputs, 13 bits, the lowest three unused."""

    die = 0x3220
    power_on = 0x7127
    ready_register, ready_bit = 0x0F, 0x0001
    shunt_count, bus_count, max_count, unused_bits = 40e-6, 8e-3, 4095, 3
    max_errors = (80e-6, 16e-3, 2.5e-3)

    def _enabled(self, value: int) -> int:
        return sum(value >> bit & 1 for bit in (12, 13, 14))


@dataclass
class EmulatedI2c(Bus):
    """Chips by their addresses, as the microcontroller's program sees them."""

    time: MicrocontrollerClock
    chips: dict[int, InaChip] = field(default_factory=dict)

    def read(self, address: int, register: int) -> int:
        return self._chip(address).read(register)

    def write(self, address: int, register: int, value: int) -> None:
        self._chip(address).write(register, value)

    def wait(self, milliseconds: int) -> None:
        self.time.wait(1e-3 * milliseconds)

    def _chip(self, address: int) -> InaChip:
        chip = self.chips.get(address)
        if chip is None or chip.faults.missing:
            raise OSError(EIO, "no acknowledgement")
        return chip


Circuit = Callable[[int, float], tuple[float, float]]
"""Current through a relay channel [A] and voltage across its spring [V] at an instant [s on the clock]."""
_KINDS: dict[str, tuple[type[InaChip], int]] = {
    "ina226": (EmulatedIna226, 1),
    "ina3221": (EmulatedIna3221, 3),
}


@dataclass(frozen=True)
class Shunts:
    """Shunts and leads of a current sensor."""

    resistance: float = 0.01
    """Nominal resistance of each shunt [Ohm]."""
    tolerance: float = 0.01
    """Relative tolerance of the resistances, which are random within it."""
    lead: float = 0.0
    """Resistance of the leads between the voltage's tap and the spring [Ohm]."""


class EmulatedCurrentSensor(EmulatedBoard):
    """A device at a pseudo-terminal like an emulated board, without contacts; `faults` are those of the line.

    Input i measures `channels[i]` of the circuit; chips have the addresses from 0x40 on. Their offset and
    gain are random within their tolerances.
    """

    baud = 115200

    def __init__(
        self,
        kind: str,
        channels: Sequence[int],
        circuit: Circuit,
        clock: Clock,
        shunts: Shunts = Shunts(),  # frozen
        seed: int = 1,
    ):
        super().__init__(0, clock)
        rng = np.random.default_rng([seed, 8])  # the rig's supply and air have stream 5
        chip, inputs = _KINDS[kind]
        self.i2c = EmulatedI2c(MicrocontrollerClock(clock))
        for number, first in enumerate(range(0, len(channels), inputs)):
            sources = [_source(circuit, c, shunts.lead) for c in channels[first : first + inputs]]
            sources += [lambda t: _UNCONNECTED] * (inputs - len(sources))
            ohms = [shunts.resistance * (1.0 + float(rng.uniform(-1, 1)) * shunts.tolerance) for _ in sources]
            self.i2c.chips[0x40 + number] = chip(sources, self.i2c.time, ohms, rng)
        self._program = CurrentSensor(self.i2c)

    def request_length(self, data: bytes) -> int:
        return data.find(b"\n") + 1

    def obey(self, request: bytes) -> bytes:
        return self._program.answer(request)


def _source(circuit: Circuit, channel: int, lead: float) -> CurrentAndVoltage:
    """Current and voltage of one channel, with the voltage across its leads."""

    def source(t: float) -> tuple[float, float]:
        amperes, volts = circuit(channel, t)
        return amperes, volts + amperes * lead

    return source
