"""The specification: a validated data file with the dimensions of the parts, which fit one another [mm]."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from eldir.core.validation import Section
from eldir.lattice import HALF_SIDE
from eldir_cad.kit.data_files import Gap, Length, load, own_data
from eldir_cad.kit.sizes import (
    BodyLimits,
    Coil,
    ConnectorSize,
    FittingSize,
    HolderSize,
    MassSize,
    Safety,
    StripSize,
)


class Specification(Section):
    """All dimensions of the kit [mm]. Parts that do not fit one another are refused."""

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
    def _parts_fit(self) -> Specification:
        m, s, c, f = self.mass, self.strip, self.connector, self.fitting
        gap = self.clearance
        _need(s.length < self.pitch, "strip.length", f"less than the pitch, {self.pitch:g}", s.length)
        _need(
            s.bulb_diameter > s.thickness + 2 * gap,
            "clearance",
            f"less than {(s.bulb_diameter - s.thickness) / 2:g}, or the bulb slips out of its socket",
            gap,
        )
        _need(
            self.bulb_radius_at + s.bulb_diameter / 2 + gap < m.across_flats / 2,
            "mass.across_flats",
            f"more than {2 * self.bulb_radius_at + s.bulb_diameter + 2 * gap:g} to hold the bulbs",
            m.across_flats,
        )
        _need(
            self.throat < s.bulb_diameter / 2,
            "strip.turn_deg",
            f"small enough that the bulb, {s.bulb_diameter:g} across, cannot leave its socket "
            f"({2 * self.throat:.2f} mm wide in turn)",
            s.turn_deg,
            "degrees",
        )
        _need(
            self.turned_stud >= m.across_flats / 2 + gap,
            "fitting.stand_off",
            "so wide that the coil clears its mass when turned by strip.turn_deg",
            f.stand_off,
        )
        _need(
            s.height + 2 * gap <= m.socket_depth + 1e-9,
            "strip.height",
            f"at most {m.socket_depth - 2 * gap:g}, the socket's depth less the clearance on both sides",
            s.height,
        )
        _need(
            c.peg + 2 * gap <= m.peg_hole + 1e-9,
            "clearance",
            f"at most {(m.peg_hole - c.peg) / 2:g} beside the connector's peg",
            gap,
        )
        _need(
            c.peg_length < m.socket_depth,
            "connector.peg_length",
            f"less than the sockets' depth, {m.socket_depth:g}",
            c.peg_length,
        )
        _need(
            2 * (c.flange_thickness + gap) < c.gap,
            "connector.gap",
            f"more than {2 * (c.flange_thickness + gap):g} for two flanges",
            c.gap,
        )
        _need(
            c.flange_diameter <= m.across_flats,
            "connector.flange_diameter",
            f"at most the mass's width, {m.across_flats:g}",
            c.flange_diameter,
        )
        deepest = m.disc_depth + m.engraving_depth
        _need(deepest < m.floor, "mass.floor", f"more than {deepest:g}, seat and engraving", m.floor)
        _need(
            m.disc_diameter < m.across_flats,
            "mass.disc_diameter",
            f"less than {m.across_flats:g}",
            m.disc_diameter,
        )
        h = self.holder
        _need(
            h.across_flats > m.across_flats + 2 * gap and h.bore < m.across_flats,
            "holder.across_flats and bore",
            f"wider and narrower than the mass, {m.across_flats:g}, with its clearance",
            h.across_flats,
        )
        _need(h.sleeve + gap <= m.floor, "holder.sleeve", f"at most {m.floor - gap:g}", h.sleeve)
        _need(
            f.stud_diameter < self.coil.outer_diameter,
            "fitting.stud_diameter",
            f"less than the coil's {self.coil.outer_diameter:g}",
            f.stud_diameter,
        )
        _need(
            self.coil.cold_length < self.coil.hot_length,
            "coil.hot_length",
            f"more than the cold length, {self.coil.cold_length:g}",
            self.coil.hot_length,
        )
        _need(
            2 * f.stud_length < self.coil.cold_length,
            "fitting.stud_length",
            f"less than half the cold coil, {self.coil.cold_length / 2:g}",
            f.stud_length,
        )
        return self

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
        """Half the width of a socket where its flare leaves the bulb's pocket."""
        radius = self.strip.bulb_diameter / 2 + self.clearance
        # Where the flare's line, `half` from the bulb's centre, cuts the pocket's circle.
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
    return load(path or own_data("parts.yaml"), Specification)


def _need(ok: bool, name: str, expected: str, found: float, unit: str = "mm") -> None:
    if not ok:
        raise ValueError(f"{name} must be {expected}; found {found:g} {unit}")
