"""The specification: a validated data file with the dimensions of each part, which fit together [mm]; and
reading of data files."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field, model_validator

from eldir.core.validation import Section, validate
from eldir.core.yaml_files import read_yaml
from eldir.lattice import HALF_SIDE
from eldir.parameters.springs import SpringParameters

Length = Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)]
Gap = Annotated[float, Field(ge=0, le=5, allow_inf_nan=False)]
_Section = TypeVar("_Section", bound=Section)


def kit_file(name: str) -> Path:
    """Path of a data file of the kit."""
    return Path(str(resources.files("eldir_cad.kit") / "data" / name))


def load_section(path: Path, model: type[_Section]) -> _Section:
    """Read a YAML file and validate it as `model`. Raises `InputError` that names the invalid entry."""
    return validate(model, read_yaml(path), str(path))


class BodyLimits(Section):
    """The largest body that is built, in triangles of the lattice, and its largest number of motors."""

    rows: int = Field(ge=1)
    """Largest number of rows of triangles; the paper's workspace has 6."""
    columns: int = Field(ge=1)
    """Largest number of columns of triangles; the paper's workspace has 11."""
    motors: int = Field(ge=1)
    """Largest number of motors: shape-memory springs of the design, each of which is built on both faces."""


class MassSize(Section):
    """Hexagonal mass: a closed floor on the outside, sockets open to the inside."""

    across_flats: Length
    """Width of the hexagon across its flats [mm]."""
    floor: Length
    """Thickness of the closed outer face [mm]."""
    socket_depth: Length
    """Depth of the sockets, which are open towards the other plane [mm]."""
    peg_hole: Length
    """Width across flats of the hexagonal hole for a connector or a cap [mm]."""
    disc_diameter: Length
    """Diameter of the seat of a tracking disc [mm]; it is cut only into the masses m1 to m5."""
    disc_depth: Length
    """Depth of the seat of a tracking disc [mm]."""
    engraving_depth: Length
    """Depth of the engraved number [mm]."""
    digit_height: Length
    """Height of the digits of the engraved number [mm]."""
    stroke: Length
    """Width of the lines of the engraved number [mm]."""

    @property
    def height(self) -> float:
        """Height of the mass: floor and sockets."""
        return self.floor + self.socket_depth

    @property
    def across_corners(self) -> float:
        """Diameter of the circle through the hexagon's corners."""
        return self.across_flats * 2 / math.sqrt(3)


class StripSize(Section):
    """Passive spring: a straight strip, a round bulb at each end."""

    length: Length
    """Length of the strip from tip to tip [mm]."""
    height: Length
    """Height of the strip, along the sockets' depth [mm]."""
    thickness: Length
    """Thickness of the strip, in the plane of motion [mm]."""
    bulb_diameter: Length
    """Diameter of the round end that its socket holds [mm]."""
    turn_deg: Annotated[float, Field(ge=0, le=30)]
    """Greatest rotation in its socket, in either direction [degrees]; 0: clamped."""


class ConnectorSize(Section):
    """Biplane connector: a column, a flange and a hexagonal peg at each end."""

    gap: Length
    """Distance between the inner faces of the two planes [mm]."""
    column_diameter: Length
    """Diameter of the column [mm]."""
    flange_diameter: Length
    """Diameter of the flanges, which close the sockets [mm]."""
    flange_thickness: Length
    """Thickness of a flange [mm]."""
    peg: Length
    """Width of the hexagonal peg across its flats [mm]; it fits the mass's peg hole."""
    peg_length: Length
    """Length of each peg [mm]; less than the sockets' depth."""


class FittingSize(Section):
    """End fitting of a shape-memory spring: a strip's end with a stud for the coil."""

    stud_diameter: Length
    """Diameter of the stud over which the coil is pushed [mm]."""
    stud_length: Length
    """Length of the stud [mm]; less than half the cold coil."""
    stand_off: Length
    """Distance from the mass's face to stud and coil, so that they can rotate [mm]."""
    wire_guide: Length
    """Diameter of the hole for the coil's end and the lead [mm]."""


class Coil(Section):
    """The shape-memory spring, bought or wound."""

    outer_diameter: Length
    """Outer diameter of the coil [mm]."""
    cold_length: Length
    """Free length of the cold coil [mm]."""
    hot_length: Length
    """Free length of the hot coil [mm]."""
    current_limit_a: Annotated[float, Field(gt=0, le=30)]
    """Current limit of the supply that the packet's lists and traveller state [A]; `eldir export`, and
    `eldir shortlist` of a run in the paper's scene, predict with it."""
    current_conditions: Annotated[str, Field(max_length=200)] = ""
    """Conditions under which that current is allowed; they stand beside it."""


class HolderSize(Section):
    """Ballast holder: a hexagonal tube on the outside of a mass, filled with shot."""

    across_flats: Length
    """Outer width of the tube across its flats [mm]; more than the mass's."""
    bore: Length
    """Width across flats of the hexagonal hole for the filling [mm]; less than the mass's."""
    sleeve: Length
    """Length over which the holder encloses the mass's floor [mm]."""
    fill_density: Annotated[float, Field(gt=0.5, lt=20)]
    """Density of the filling as poured [g/cm3]."""


class Safety(Section):
    """Margins of the build filter."""

    strain: Annotated[float, Field(ge=1, le=10)]
    """Safety factor: the resin's strain at flexural strength over the largest strain that is allowed."""
    static_margin: Length
    """Least distance of the centre of mass from the edge of the feet [mm]; a body with less is unfit."""
    static_margin_safe: Length
    """Distance of the centre of mass from the edge of the feet below which the report has a note [mm]."""
    foot_stroke: Length
    """Least change of the feet's spacing by the motors [mm]; below it hardly any body walks."""


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
        """Scale of the printed robot: millimetres for a metre of the simulated one."""
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

    def with_coil(self, springs: SpringParameters) -> Specification:
        """The parts with the coil of these springs, such as those of a rig, on the same fittings."""
        sizes = {
            "outer_diameter": 1e3 * (springs.coil_diameter + springs.wire_diameter),
            "cold_length": 1e3 * springs.cold_length - 2 * self.coil_seat,
            "hot_length": 1e3 * springs.hot_length - 2 * self.coil_seat,
        }
        coil = self.coil.model_copy(update={name: round(size, 6) for name, size in sizes.items()})
        return self.model_copy(update={"coil": coil})


def load_specification(path: Path | None = None) -> Specification:
    """Read the dimensions of the parts from a YAML file; by default the file of the kit."""
    return load_section(path or kit_file("parts.yaml"), Specification)


def _require(ok: bool, name: str, expected: str, found: float, unit: str = "mm") -> None:
    if not ok:
        raise ValueError(f"{name} must be {expected}; found {found:g} {unit}")
