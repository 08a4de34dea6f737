"""Dimensions of each part of the kit [mm], as sections of the specification, and reading of data files."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field

from eldir.core.validation import Section, validate
from eldir.core.yaml_files import read_yaml

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
    """Current limit of the supply that the packet's lists and traveller state [A]."""


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
