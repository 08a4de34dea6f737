"""Measurement of a mesh in its printing pose: walls, gaps, overhangs and hollows [mm].

Everything here is read from the mesh that is written to the file, not from the drawing: walls and slots
along rays, overhangs, islands and cups from layer to layer, in the printing pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple

import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, JoinType, Manifold, Mesh64, OpType
from pydantic import Field

from eldir.core.records import BoolArray, Record, Rounded, record
from eldir.errors import EldirError
from eldir_cad.geometry.thickness import (
    measure_inclined,
    measure_levels,
    measure_section,
    self_intersections,
)
from eldir_cad.kit.printer import Printer

_TOLERANCE = 1e-3  # heights closer than this are equal [mm]
_MIN_AREA = 0.02  # a smaller difference of two layers is rounding [mm2]
_MAX_BRIDGE = 1.0  # overhangs up to this width hold without supports [mm]


@record
class Feature(Record):
    """A feature: an area or a hollow at some height of a part."""

    z: Annotated[float, Field(alias="z_mm")]
    """Height above the plate at which it begins, in the printing pose [mm]."""
    size: Annotated[float, Field(gt=0)]
    """Size: area of an overhang or an island [mm2]; volume of a cup or a sealed hollow [mm3]."""


@record
class Inspection(Record):
    """The measurements of one mesh."""

    wall: Annotated[float, Rounded(3, ge=0), Field(alias="wall_mm")]
    """Thinnest wall, floor or pin, measured on the mesh [mm]."""
    gap: Annotated[float, Rounded(3), Field(alias="gap_mm")]
    """Narrowest slot or hole, measured on the mesh [mm]; infinite where there is none: null in a file."""
    supports: str
    """What must be supported; or none."""
    overhangs: Annotated[tuple[Feature, ...], Field(alias="overhangs_mm2")]
    """Areas that overhang by more than 45 degrees and are too wide to print without supports."""
    islands: Annotated[tuple[Feature, ...], Field(alias="islands_mm2")]
    """Areas of layers with nothing below them."""
    cups: Annotated[tuple[Feature, ...], Field(alias="cups_mm3")]
    """Hollows that are closed all around and towards the plate: they cause suction when a layer is peeled
    off."""
    sealed: Annotated[tuple[Feature, ...], Field(alias="sealed_mm3")]
    """Hollows that the plate or the part closes at both ends: resin stays in them."""

    @property
    def support_levels(self) -> list[float]:
        """Heights at which a feature needs supports [mm]."""
        return _levels((*self.overhangs, *self.islands))


def inspect(mesh: trimesh.Trimesh, printer: Printer) -> Inspection:
    """Measure a part in its printing pose."""
    slabs = list(_slabs(mesh, printer.layer))
    levels, inclined = measure_levels(mesh), measure_inclined(mesh, np.flatnonzero(_is_inclined(mesh)))
    wall, gap = min(levels[0], inclined[0]), min(levels[1], inclined[1])
    for slab in slabs:
        if slab.is_prism:
            sides = measure_section([np.asarray(c, np.float64) for c in slab.section.to_polygons()])
            wall, gap = min(wall, sides[0]), min(gap, sides[1])
    overhangs, islands = _unsupported(slabs, printer.layer)
    cups, sealed = _hollows(slabs)
    return Inspection(
        wall,
        gap,
        _supports((*overhangs, *islands)),
        tuple(overhangs),
        tuple(islands),
        tuple(cups),
        tuple(sealed),
    )


def _supports(features: Sequence[Feature]) -> str:
    """The features that need supports, in words."""
    levels = ", ".join(f"{z:g}" for z in _levels(features))
    return f"{sum(f.size for f in features):.0f} mm2 from below, at {levels} mm" if features else "none"


def _levels(features: Sequence[Feature]) -> list[float]:
    return sorted({round(f.z, 1) for f in features})


def require_printable(name: str, mesh: trimesh.Trimesh, inspection: Inspection, printer: Printer) -> None:
    """Raise `EldirError` for a mesh that intersects itself or has features too fine for the printer."""
    crossings = self_intersections(mesh)
    if crossings:
        a, b = crossings[0]
        raise EldirError(
            f"the surface of part {name} intersects itself",
            code="part.cuts-itself",
            expected="a surface without crossings",
            found=f"{len(crossings)} pairs of faces, {a} and {b} the first",
            remedy="check the dimensions in the specification",
        )
    minimum = printer.minimum
    for feature, size, allowed in (
        ("wall", inspection.wall, minimum.wall),
        ("gap", inspection.gap, minimum.gap),
    ):
        if size < allowed - _TOLERANCE:
            raise EldirError(
                f"part {name} has a {feature} below the minimum of {printer.name}",
                code="part.too-fine",
                expected=f"at least {allowed:g} mm",
                found=f"{size:.2f} mm, measured on its mesh",
                remedy="change the specification or choose another printer",
            )


class _Slab(NamedTuple):
    """A slab: the volume between two levels where the sides are vertical, otherwise one layer."""

    bottom: float
    top: float
    section: CrossSection
    is_prism: bool


def _is_inclined(mesh: trimesh.Trimesh) -> BoolArray:
    z = np.asarray(mesh.triangles)[:, :, 2]
    return np.asarray((np.abs(mesh.face_normals[:, 2]) > 1e-3) & (np.ptp(z, axis=1) > _TOLERANCE))


def _slabs(mesh: trimesh.Trimesh, layer: float) -> Iterator[_Slab]:
    """The slabs of a part, from the plate upwards."""
    solid = Manifold(Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64)))
    heights = np.sort(np.asarray(mesh.vertices)[:, 2])
    levels = heights[np.concatenate([[True], np.diff(heights) > _TOLERANCE])]
    z = np.asarray(mesh.triangles)[_is_inclined(mesh), :, 2]
    low, high = z.min(axis=1), z.max(axis=1)
    edges = levels[:1].tolist()
    for top in levels[1:].tolist():
        is_inclined = bool(((low < top - _TOLERANCE) & (high > edges[-1] + _TOLERANCE)).any())
        steps = max(1, round((top - edges[-1]) / layer)) if is_inclined else 1
        for level in np.linspace(edges[-1], top, steps + 1)[1:].tolist():
            section = solid.slice((edges[-1] + level) / 2)
            yield _Slab(edges[-1], level, section, not is_inclined)
            edges.append(level)


def _unsupported(slabs: list[_Slab], layer: float) -> tuple[list[Feature], list[Feature]]:
    """Overhangs and islands, level by level. The supported area grows sideways by 45 degrees upwards."""
    overhangs, islands = [], []
    supported, below = slabs[0].section, slabs[0].section
    for bottom, top, above, _ in slabs[1:]:
        overhang = above - supported.offset(layer, JoinType.Round, circular_segments=16)
        for piece in above.decompose():
            if piece.area() > _MIN_AREA and (piece ^ below).area() < 1e-6:
                islands.append(Feature(round(bottom, 3), round(piece.area(), 3)))
                overhang = overhang - piece
        pieces = overhang.decompose()
        narrow = [p for p in pieces if p.offset(-_MAX_BRIDGE / 2, JoinType.Round).is_empty()]
        area = overhang.area() - sum(p.area() for p in narrow)
        if area > _MIN_AREA:
            overhangs.append(Feature(round(bottom, 3), round(area, 3)))
        # A narrow overhang holds by itself, but supports nothing until more layers cover it.
        holding = CrossSection.batch_boolean([above, *narrow], OpType.Subtract)
        grown = holding.offset(top - bottom, JoinType.Round, circular_segments=16)
        supported = (above ^ grown).simplify(_TOLERANCE)  # otherwise the number of corners grows
        below = above
    return overhangs, islands


def _hollows(slabs: list[_Slab]) -> tuple[list[Feature], list[Feature]]:
    """Cups, which are open at their end away from the plate, and sealed hollows, which are closed there
    too."""
    cups, sealed = [], []
    open_cups: list[tuple[float, float, CrossSection]] = []  # start height, volume, section
    previous = CrossSection.square((0.0, 0.0))
    for bottom, top, section, _ in slabs:
        filled = CrossSection(
            [c for c in section.to_polygons() if _is_counter_clockwise(c)], FillRule.Positive
        )
        continued: list[tuple[float, float, CrossSection]] = []
        counted: set[int] = set()
        for hollow in (filled - section).decompose():
            if hollow.area() < _MIN_AREA:
                continue
            under = [k for k, (_, _, s) in enumerate(open_cups) if (s ^ hollow).area() > _MIN_AREA]
            # Resin flows out where the hollow was open below, beside the cups.
            free = hollow - previous
            for k in under:
                free = free - open_cups[k][2]
            if bottom > slabs[0].bottom and free.area() > _MIN_AREA:
                continue
            start = min([open_cups[k][0] for k in under], default=bottom)
            # A cup that divides adds its volume to the first of its parts.
            volume = sum(open_cups[k][1] for k in under if k not in counted) + hollow.area() * (top - bottom)
            counted |= set(under)
            continued.append((start, volume, hollow))
        for k, (start, volume, cup) in enumerate(open_cups):
            if k not in counted and (cup - section).area() < _MIN_AREA:
                sealed.append(Feature(round(start, 3), round(volume, 2)))
        open_cups, previous = continued, section
    cups += [Feature(round(start, 3), round(volume, 2)) for start, volume, _ in open_cups]
    return cups, sealed


def _is_counter_clockwise(contour: object) -> bool:
    x, y = np.asarray(contour, np.float64).T
    return bool((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0)
