"""Parameters of the simulation from the parts: the force of a bending strip, and the constants of the
printed scene.

A strip is nearly inextensible in tension. In compression it is a column of rectangular section: straight
up to Euler's load, then an elastica. A column with pinned ends bends in one half-wave; one with clamped
ends in four quarter-waves, so that it is a pinned one of half its length: four times the load at the same
shortening in parts of the length, and twice the strain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SUPPLY, SpringParameters
from eldir_cad.geometry.parts import cap, connector, fitting, mass_volume, strip
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

_DIGITS = 3  # significant, of what the printed scene takes: its constants are known no better

_SUPPLY_AND_AIR = (*SUPPLY, "convection_fan", "convection_still", "fan", "ambient")


@dataclass(frozen=True)
class StripLaw:
    """Force of a passive spring as a function of its shortening [N, mm, MPa]."""

    length: float
    """Bending length: between the hinges, or between the faces of the masses that clamp it."""
    pitch: float
    """Distance between the centres of its masses."""
    height: float
    thickness: float
    tensile_modulus: float
    flexural_modulus: float
    clamped: bool
    """Whether its ends keep their direction; otherwise they turn freely."""

    @classmethod
    def of(cls, spec: Specification, printer: Printer) -> StripLaw:
        """The law of the strip in its sockets: pinned where the sockets let it turn, otherwise clamped."""
        clamped = spec.strip.turn_deg == 0
        length = spec.free_strip if clamped else spec.hinge_to_hinge
        material = printer.material
        moduli = material.tensile_modulus, material.flexural_modulus
        return cls(length, spec.pitch, spec.strip.height, spec.strip.thickness, *moduli, clamped)

    @property
    def tension(self) -> float:
        """Stiffness of the straight strip in tension, E A / L [N/mm]."""
        return self.tensile_modulus * self.height * self.thickness / self.length

    @property
    def flexural_rigidity(self) -> float:
        """Flexural rigidity E I [N mm2]."""
        return self.flexural_modulus * self.height * self.thickness**3 / 12

    @property
    def half_wave(self) -> float:
        """Length of a pinned column that bends like this one [mm]."""
        return self.length / 2 if self.clamped else self.length

    @property
    def buckling(self) -> float:
        """Euler's load, pi2 E I / l2 of a half-wave [N]."""
        return math.pi**2 * self.flexural_rigidity / self.half_wave**2

    def force(self, shortening: float) -> float:
        """Compressive force at a shortening [mm], along the elastica [N]."""
        straight = self.tension * shortening
        if straight <= self.buckling:
            return straight
        # The load compresses the bent strip too, by less than a hundredth of a millimetre: left out.
        k = _modulus(shortening / self.length)
        return self.buckling * (2 * float(ellipk(k * k)) / math.pi) ** 2

    def surface_strain(self, shortening: float) -> float:
        """Greatest strain at the strip's surface when it is bent: half its thickness times 4 k K / l."""
        if shortening <= self.buckling / self.tension:
            return shortening / self.length
        k = _modulus(shortening / self.length)
        return self.thickness / 2 * 4 * k * float(ellipk(k * k)) / self.half_wave


def _modulus(share: float) -> float:
    """Elliptic modulus of the elastica that is shorter than its length by `share`: 2 (1 - E / K)."""
    if not 0 <= share < 1:
        raise ValueError(f"a strip cannot be shortened by {share:.3g} of its length")
    return math.sqrt(float(brentq(lambda m: 2 * (1 - ellipe(m) / ellipk(m)) - share, 0.0, 0.9)))


def built_parameters(
    spec: Specification, printer: Printer, springs: SpringParameters | None = None
) -> BuiltParameters:
    """Parameters of the printed scene: those that follow from parts, resin and the motors' springs, else
    defaults. `springs`: by default those of the parts."""
    printed = _with_kit_springs(spec, printer)
    return RobotParameters.nominal(springs or spring_parameters(spec), printed).printed


@lru_cache(maxsize=8)  # it makes meshes for the weights
def _with_kit_springs(spec: Specification, printer: Printer) -> BuiltParameters:
    law, gram = StripLaw.of(spec, printer), 1e-6 * printer.material.density  # kg/mm3
    full = mass_volume(spec, 6) + cap(spec).volume
    # Most masses with a connector have four springs.
    open_mass = mass_volume(spec, 4) + connector(spec).volume / 2
    corner = spec.mass.across_corners / 2
    values = {
        "pitch": 1e-3 * spec.pitch,
        "tension": 1e3 * law.tension,
        "buckling": law.buckling,
        "bending": 1e-3 * law.flexural_rigidity / law.length if law.clamped else 0.0,
        "hexagon": gram * full,
        "half_connector": gram * (open_mass - full),
        "strip": gram * strip(spec).volume,
        "active_spring": SpringParameters().mass + 2 * gram * fitting(spec).volume,
        "gyration": 1e-3 * corner * math.sqrt(5 / 12),
    }
    return BuiltParameters(**{name: _rounded(value) for name, value in values.items()})


def hub_parameters(
    spec: Specification, printer: Printer, springs: SpringParameters | None = None
) -> BuiltParameters:
    """The same robot with hubs instead of pins: sockets and corners as in the parts. Clamped strips stay
    clamped."""
    law, pinned = StripLaw.of(spec, printer), built_parameters(spec, printer, springs)
    if law.clamped:
        return pinned
    return replace(
        pinned.with_hubs(),
        bending=_rounded(1e-3 * law.flexural_rigidity / law.length),
        socket=_rounded(1e-3 * spec.bulb_radius_at),
        corner=_rounded(5e-4 * spec.mass.across_corners),
        socket_turn=math.radians(spec.strip.turn_deg),
    )


def spring_parameters(spec: Specification) -> SpringParameters:
    """Parameters of the shape-memory spring at the current limit of the parts file; its lengths are between
    the centres of its two masses. Wire and turns are the kit's."""
    kit = SpringParameters()
    cold, hot = (round(1e-3 * length, 6) for length in spec.motor_range)
    ends = round(2e-3 * spec.coil_seat, 6)
    coil = round(1e-3 * spec.coil.outer_diameter - kit.wire_diameter, 9)
    return replace(
        kit,
        cold_length=cold,
        hot_length=hot,
        ends=ends,
        coil_diameter=coil,
        current_limit=spec.coil.current_limit_a,
    )


def on_supply_of(springs: SpringParameters, other: SpringParameters) -> SpringParameters:
    """These springs on the supply, and in the air, of other ones."""
    return replace(springs, **{name: getattr(other, name) for name in _SUPPLY_AND_AIR})


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
