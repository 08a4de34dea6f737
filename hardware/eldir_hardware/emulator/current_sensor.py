"""An emulated current sensor: the microcontroller's own program on emulated chips, at a pseudo-terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.emulator.ina_chips import (
    Electric,
    EmulatedI2c,
    EmulatedIna226,
    EmulatedIna3221,
    InaChip,
    LocalTime,
)
from eldir_hardware.firmware.current_sensor import CurrentSensor

Circuit = Callable[[int, float], tuple[float, float]]
"""Current through a relay channel [A] and voltage across its spring [V] at an instant [s on the clock]."""
_KINDS: dict[str, tuple[type[InaChip], int]] = {
    "ina226": (EmulatedIna226, 1),
    "ina3221": (EmulatedIna3221, 3),
}
_NOTHING = (0.0, 0.0)


class EmulatedCurrentSensor(EmulatedBoard):
    """A device on a line like an emulated board, but without contacts: its `faults` are those of the line.

    Input i measures `channels[i]` of the circuit; chips have the addresses from 0x40 on.
    """

    baud = 115200

    def __init__(
        self,
        kind: str,
        channels: Sequence[int],
        circuit: Circuit,
        clock: Clock,
        *,
        shunt: float = 0.01,
        shunt_tolerance: float = 0.01,
        lead: float = 0.0,
        seed: int = 1,
    ):
        """Shunts, and the chips' offset and gain, lie anywhere within their tolerance, by the seed.

        `lead`: resistance of the leads between the voltage's tap and the spring [Ohm].
        """
        super().__init__(0, clock)
        rng = np.random.default_rng([seed, 5])
        chip, inputs = _KINDS[kind]
        self.i2c = EmulatedI2c(LocalTime(clock))

        def electric(channel: int | None) -> Electric:
            def at(t: float) -> tuple[float, float]:
                if channel is None:  # an input that is not connected
                    return _NOTHING
                amperes, volts = circuit(channel, t)
                return amperes, volts + amperes * lead

            return at

        for number, first in enumerate(range(0, len(channels), inputs)):
            own: list[int | None] = [*channels[first : first + inputs]]
            own += [None] * (inputs - len(own))
            shunts = [shunt * (1.0 + float(rng.uniform(-1, 1)) * shunt_tolerance) for _ in own]
            self.i2c.chips[0x40 + number] = chip([electric(c) for c in own], self.i2c.time, shunts, rng)
        self._program = CurrentSensor(self.i2c)

    def _request_length(self, data: bytes) -> int:
        return data.find(b"\n") + 1

    def _obey(self, request: bytes) -> bytes:
        return self._program.answer(request)
