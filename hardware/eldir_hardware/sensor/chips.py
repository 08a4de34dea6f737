"""What the data sheets promise of the chips: counts, full scale, and the largest errors.

INA226: Texas Instruments SBOS547B; INA3221: SBOS576A; section "Electrical characteristics", 25 C.
"""

from __future__ import annotations

from dataclasses import dataclass

_LEAST_ZERO = 0.010  # leakage and noise of the leads [A]
_NOISE = 2.0  # counts, with rounding; averages of four
_ZERO_MARGIN = 3.0  # offsets drift with temperature and supply


@dataclass(frozen=True)
class Chip:
    """One kind of chip. Errors are the greatest that its data sheet allows."""

    inputs: int
    shunt_count: float
    """Shunt voltage of one count [V]."""
    bus_count: float
    """Bus voltage of one count [V]."""
    most_counts: int
    """Count at which the shunt voltage saturates."""
    most_volts: float
    """Highest voltage at an input [V]."""
    shunt_offset: float
    """[V]."""
    bus_offset: float
    """[V]."""
    gain_error: float
    """Of shunt and bus voltage, relative."""

    def full_scale(self, shunt: float) -> float:
        """Current at which a shunt of so many ohms saturates the input [A]."""
        return self.most_counts * self.shunt_count / shunt

    def zero(self, shunt: float) -> float:
        """Currents below this cannot be told from none [A]."""
        return max(_LEAST_ZERO, _ZERO_MARGIN * (self.shunt_offset + self.shunt_count) / shunt)

    def smallest_shunt(self, current: float) -> float:
        """The smallest shunt with which so small a current can be told from none [Ohm]."""
        return _ZERO_MARGIN * (self.shunt_offset + self.shunt_count) / current

    def current_error(self, shunt: float, tolerance: float, current: float) -> float:
        """Largest error of a current, with that tolerance of the shunt [A]."""
        at_zero = (self.shunt_offset + _NOISE * self.shunt_count) / shunt
        return at_zero + (self.gain_error + tolerance) * abs(current)

    def voltage_error(self, voltage: float) -> float:
        """Largest error of a voltage [V]."""
        return self.bus_offset + _NOISE * self.bus_count + self.gain_error * abs(voltage)


CHIPS = {
    "ina226": Chip(1, 2.5e-6, 1.25e-3, 32767, 36.0, 10e-6, 7.5e-3, 1e-3),
    "ina3221": Chip(3, 40e-6, 8e-3, 4095, 26.0, 80e-6, 16e-3, 2.5e-3),
}
"""The kinds that a rig file may name."""
