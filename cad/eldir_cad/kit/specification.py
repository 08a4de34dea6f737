"""The specification: a validated data file with the dimensions of the parts, which fit together [mm]."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from eldir.core.validation import Section
from eldir.lattice import HALF_SIDE
from eldir_cad.kit.dimensions import (
    BodyLimits,
    Coil,
    ConnectorSize,
    FittingSize,
    Gap,
    HolderSize,
    Length,
    MassSize,
    Safety,
    StripSize,
    kit_file,
    load_section,
)


class Specification(Section):
    """All dimensions of the kit [mm]. Dimensions with which the parts do not fit together are refused."""

    format: Literal["eldir-specification/1"]
    """Format of this file."""
    workspace: BodyLimits
    """Largest body that is built."""
    pitch: Length
    """Distance between the centres of neighbouring masses [mm]."""
    clearance: Gap
    """Clearance on each side of a plug in its socket [mm]; the printer's allowance is added."""
    mass: MassSize
    """Dimensions of a mass."""
    strip: StripSize
    """Dimensions of a passive spring."""
    connector: ConnectorSize
    """Dimensions of a connector between the two planes."""
    fitting: FittingSize
    """Dimensions of the printed end of a shape-memory spring."""
    coil: Coil
    """Dimensions of the shape-memory spring."""
    holder: HolderSize
    """Dimensions of a ballast holder."""
    safety: Safety
    """Margins of the build filter."""
    coupon_steps: Annotated[tuple[Gap, ...], Field(min_length=2, max_length=12)]
    """Clearances of the fit coupon [mm], the tightest first."""

    @model_validator(mode="after")
    def _check_fit(self) -> Specification:
        for check in (self._check_strip, self._check_connector, self._check_mass, self._check_coil):
            check()
        return self

    def _check_strip(self) -> None:
        """A strip's bulbs stay in their sockets, and can rotate there."""
        m, s, gap = self.mass, self.strip, self.clearance
        _require(s.length < self.pitch, "strip.length", f"less than the pitch, {self.pitch:g}", s.length)
        _require(
            s.bulb_diameter > s.thickness + 2 * gap,
            "clearance",
            f"less than {(s.bulb_diameter - s.thickness) / 2:g}, or the bulb slips out of its socket",
            gap,
        )
        width = 2 * self.bulb_radius_at + s.bulb_diameter + 2 * gap
        holds = self.bulb_radius_at + s.bulb_diameter / 2 + gap < m.across_flats / 2
        _require(holds, "mass.across_flats", f"more than {width:g} to hold the bulbs", m.across_flats)
        expected = (
            f"small enough that the bulb, {s.bulb_diameter:g} across, cannot leave its socket "
            f"({2 * self.throat:.2f} mm wide in turn)"
        )
        _require(self.throat < s.bulb_diameter / 2, "strip.turn_deg", expected, s.turn_deg, "degrees")
        low = s.height + 2 * gap <= m.socket_depth + 1e-9
        depth = m.socket_depth - 2 * gap
        expected = f"at most {depth:g}, the socket's depth less the clearance on both sides"
        _require(low, "strip.height", expected, s.height)

    def _check_connector(self) -> None:
        """The pegs fit into the masses, and the flanges between the planes."""
        m, c, gap = self.mass, self.connector, self.clearance
        fits = c.peg + 2 * gap <= m.peg_hole + 1e-9
        _require(fits, "clearance", f"at most {(m.peg_hole - c.peg) / 2:g} beside the connector's peg", gap)
        expected = f"less than the sockets' depth, {m.socket_depth:g}"
        _require(c.peg_length < m.socket_depth, "connector.peg_length", expected, c.peg_length)
        flanges = 2 * (c.flange_thickness + gap)
        _require(flanges < c.gap, "connector.gap", f"more than {flanges:g} for two flanges", c.gap)
        expected = f"at most the mass's width, {m.across_flats:g}"
        covers = c.flange_diameter <= m.across_flats
        _require(covers, "connector.flange_diameter", expected, c.flange_diameter)

    def _check_mass(self) -> None:
        """Disc, engraving and ballast holder fit a mass."""
        m, h, gap = self.mass, self.holder, self.clearance
        deepest = m.disc_depth + m.engraving_depth
        _require(deepest < m.floor, "mass.floor", f"more than {deepest:g}, seat and engraving", m.floor)
        narrow = m.disc_diameter < m.across_flats
        _require(narrow, "mass.disc_diameter", f"less than {m.across_flats:g}", m.disc_diameter)
        encloses = h.across_flats > m.across_flats + 2 * gap and h.bore < m.across_flats
        expected = f"wider and narrower than the mass, {m.across_flats:g}, with its clearance"
        _require(encloses, "holder.across_flats and bore", expected, h.across_flats)
        _require(h.sleeve + gap <= m.floor, "holder.sleeve", f"at most {m.floor - gap:g}", h.sleeve)

    def _check_coil(self) -> None:
        """The coil fits its studs, and clears the masses."""
        f, coil = self.fitting, self.coil
        clears = self.turned_stud >= self.mass.across_flats / 2 + self.clearance
        expected = "so wide that the coil clears its mass when turned by strip.turn_deg"
        _require(clears, "fitting.stand_off", expected, f.stand_off)
        inside = f.stud_diameter < coil.outer_diameter
        expected = f"less than the coil's {coil.outer_diameter:g}"
        _require(inside, "fitting.stud_diameter", expected, f.stud_diameter)
        expands = coil.cold_length < coil.hot_length
        expected = f"more than the cold length, {coil.cold_length:g}"
        _require(expands, "coil.hot_length", expected, coil.hot_length)
        expected = f"less than half the cold coil, {coil.cold_length / 2:g}"
        _require(2 * f.stud_length < coil.cold_length, "fitting.stud_length", expected, f.stud_length)

    @property
    def scale(self) -> float:
        """Scale of the built robot: millimetres for a metre of the simulated one."""
        return self.pitch / (2 * HALF_SIDE)

    @property
    def bulb_radius_at(self) -> float:
        """Distance from a mass's centre to the centre of the bulb in its socket."""
        return (self.pitch - self.strip.length + self.strip.bulb_diameter) / 2

    @property
    def free_strip(self) -> float:
        """Length of strip between the faces of its two masses."""
        return self.pitch - self.mass.across_flats

    @property
    def hinge_to_hinge(self) -> float:
        """Distance between the centres of a strip's two bulbs, about which it rotates."""
        return self.pitch - 2 * self.bulb_radius_at

    @property
    def throat(self) -> float:
        """Half the width of a socket at the narrowest point, where its flare leaves the bulb's pocket."""
        radius = self.strip.bulb_diameter / 2 + self.clearance
        # The intersection of the flare's side with the circle of the pocket.
        angle = math.asin(min((self.strip.thickness / 2 + self.clearance) / radius, 1.0))
        return radius * math.sin(min(angle + math.radians(self.strip.turn_deg), math.pi / 2))

    @property
    def turned_stud(self) -> float:
        """Distance from a mass's centre to the nearest point of its coil when the coil is rotated to one
        side."""
        turn, hinge = math.radians(self.strip.turn_deg), self.bulb_radius_at
        along = self.coil_seat - hinge
        return hinge + along * math.cos(turn) - self.coil.outer_diameter / 2 * math.sin(turn)

    @property
    def outside(self) -> float:
        """Distance from the middle of the robot, between its faces, to the outer side of its masses."""
        return self.connector.gap / 2 + self.mass.height

    @property
    def springs_at(self) -> float:
        """Distance from the middle of the robot to the middle of the springs of a face."""
        return (self.connector.gap + self.mass.socket_depth) / 2

    @property
    def coil_seat(self) -> float:
        """Distance from a mass's centre to the start of the coil."""
        return self.mass.across_flats / 2 + self.fitting.stand_off

    @property
    def guide_at(self) -> float:
        """Distance from a mass's centre to the hole through which a coil's wire leaves."""
        return self.coil_seat + self.fitting.stud_length - 1.5 * self.fitting.wire_guide

    @property
    def motor_range(self) -> tuple[float, float]:
        """Distance between the centres of an active spring's masses, cold and hot, without load."""
        return self.coil.cold_length + 2 * self.coil_seat, self.coil.hot_length + 2 * self.coil_seat


def load_specification(path: Path | None = None) -> Specification:
    """Read the dimensions of the parts from a YAML file; by default the file of the kit."""
    return load_section(path or kit_file("parts.yaml"), Specification)


def _require(ok: bool, name: str, expected: str, found: float, unit: str = "mm") -> None:
    if not ok:
        raise ValueError(f"{name} must be {expected}; found {found:g} {unit}")
