"""Ratings of the heating circuit of one relay channel, from the springs, the supply and its tolerances.

Each rule is stated where it is applied; docs/decisions/0068-the-kit.md has the arithmetic for one robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from scipy.optimize import brentq

from eldir.parameters.bench import RESISTANCE_TOLERANCE
from eldir.parameters.springs import SpringParameters, forced_convection
from eldir.parameters.tolerances import RigTolerances

FUSES = (1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8, 10, 12.5, 16, 20, 25, 32)
"""Rated currents of fuse-links, series R10 [A]."""
SECTIONS = (0.25, 0.34, 0.5, 0.75, 1.0, 1.5, 2.5, 4.0, 6.0)
"""Standard sections of stranded copper wire [mm2]."""
_FERRULES = {0.5: 1.0, 0.75: 1.2, 1.0: 1.4, 1.5: 1.7, 2.5: 2.2, 4.0: 2.8, 6.0: 3.5, 10.0: 4.5}
"""Bore of wire ferrules by their section [mm], DIN 46228."""
CURRENT_DENSITY = 8.0
"""Of a lead in free air, at the fuse's rating [A/mm2]."""
_FILLING = 2 / 3  # of a ferrule's bore by both wires; then crimping closes it
STRAND_RESISTIVITY = 0.0195
"""Of stranded copper at 20 C [Ohm mm2/m]: 39 Ohm/km for 0.5 mm2 (IEC 60228, class 5)."""
_MAX_AIR_SPEED = 50.0  # [m/s]


@dataclass(frozen=True)
class Circuit:
    """The circuit of one relay channel: its supply output, fuse, contacts, leads and coils in series."""

    coils: int
    """Number of coils in series."""
    springs: SpringParameters
    """Parameters of each coil."""
    current_limit: float
    """Current limit of the supply output [A]."""

    @property
    def max_current(self) -> float:
        """The largest current within the tolerance of the rig file [A]."""
        return self.current_limit * (1 + RigTolerances().current)

    @property
    def resistance(self) -> float:
        """Resistance of the coils in series, without leads [Ohm]."""
        return self.coils * self.springs.resistance

    @property
    def loaded_voltage(self) -> float:
        """Voltage of the output while it heats [V]: in its current limit it is lower than without load."""
        return min(self.springs.supply_voltage, self.current_limit * self._with_leads(self.resistance))

    @property
    def min_loaded_voltage(self) -> float:
        """The lowest of these voltages, within the tolerances of current and resistance [V]."""
        current = self.current_limit * (1 - RigTolerances().current)
        low = self._with_leads(self.resistance * (1 - RESISTANCE_TOLERANCE))
        return min(self.springs.supply_voltage, current * low)

    @property
    def unlimited_current(self) -> float:
        """Current if the limit of the output has failed [A]."""
        return self.springs.supply_voltage / self._with_leads(self.resistance)

    @property
    def fuse(self) -> float:
        """Rated current of the fuse [A]: the smallest standard value that is not below the largest
        current."""
        return _next_standard(self.max_current, FUSES)

    @property
    def lead_section(self) -> float:
        """Section of a lead [mm2]: the smallest standard one that carries the fuse's rated current at
        `CURRENT_DENSITY`."""
        return _next_standard(self.fuse / CURRENT_DENSITY, SECTIONS)

    @property
    def ferrule(self) -> tuple[float, float]:
        """Section [mm2] and bore [mm] of the ferrule that joins a lead with the wire of a coil."""
        wire = math.pi / 4 * (1e3 * self.springs.wire_diameter) ** 2
        bore = math.sqrt(4 / math.pi * (wire + self.lead_section) / _FILLING)
        section = next((s for s, b in _FERRULES.items() if b >= bore), max(_FERRULES))
        return section, _FERRULES[section]

    def _with_leads(self, resistance: float) -> float:
        return resistance + self.springs.lead_resistance


def awg(section: float) -> int:
    """The even American wire gauge that is not thinner than a section [mm2] by more than 2 per cent."""
    diameter = math.sqrt(4 / math.pi * 0.98 * section)
    return 2 * math.floor((36 - 39 * math.log(diameter / 0.127, 92)) / 2)


def air_speed(springs: SpringParameters) -> float:
    """Speed of the air across the wire that gives `convection_fan` [m/s], by the correlation for one wire."""

    wire, hot, air = springs.wire_diameter, springs.austenite_finish, springs.ambient

    def excess(speed: float) -> float:
        return forced_convection(wire, speed, hot, air) - springs.convection_fan

    return float(brentq(excess, 1e-3, _MAX_AIR_SPEED))


def _next_standard(value: float, series: Sequence[float]) -> float:
    """The smallest value of a series that is not below this one; the largest if all are."""
    return float(next((standard for standard in series if standard >= value - 1e-9), series[-1]))
