"""Dimensions of each part of the kit [mm], as sections of the specification."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from cad.kit.data_files import Length
from eldir.core.yaml_files import Section


class BodyLimits(Section):
    """The largest body that is built, in triangles of the lattice, and its largest number of motors."""

    rows: int = Field(ge=1)
    columns: int = Field(ge=1)
    motors: int = Field(ge=1)


class MassSize(Section):
    """Hexagonal mass: a closed floor on the outside, sockets open to the inside."""

    across_flats: Length
    floor: Length
    socket_depth: Length
    peg_hole: Length
    disc_diameter: Length
    disc_depth: Length
    engraving_depth: Length
    digit_height: Length
    stroke: Length

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
    height: Length
    thickness: Length
    bulb_diameter: Length
    turn_deg: Annotated[float, Field(ge=0, le=30)]
    """Greatest rotation in its socket, in either direction [degrees]; 0: clamped."""


class ConnectorSize(Section):
    """Biplane connector: a column, a flange and a hexagonal peg at each end."""

    gap: Length
    column_diameter: Length
    flange_diameter: Length
    flange_thickness: Length
    peg: Length
    peg_length: Length


class FittingSize(Section):
    """End fitting of a shape-memory spring: a strip's end with a stud for the coil."""

    stud_diameter: Length
    stud_length: Length
    stand_off: Length
    wire_guide: Length


class Coil(Section):
    """The shape-memory spring, bought or wound."""

    outer_diameter: Length
    cold_length: Length
    hot_length: Length
    current_limit_a: Annotated[float, Field(gt=0, le=30)]


class HolderSize(Section):
    """Ballast holder: a hexagonal tube on the outside of a mass, filled with shot."""

    across_flats: Length
    bore: Length
    sleeve: Length
    """Overlap with the mass's floor."""
    fill_density: Annotated[float, Field(gt=0.5, lt=20)]
    """Density of the filling [g/cm3]."""


class Safety(Section):
    """Margins of the build filter."""

    strain: Annotated[float, Field(ge=1, le=10)]
    static_margin: Length
    static_margin_safe: Length
    foot_stroke: Length
    """Least change of the feet's spacing; below it hardly any body walks."""
