"""Measurement of a mesh in its printing pose: closed, thick enough, and its overhangs and hollows [mm].

Everything here is read from the mesh that is written to the file, not from the drawing: walls and slots
along rays, overhangs, islands and cups from layer to layer, in the pose the part is printed in.
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
from eldir_cad.geometry.thickness import facing_faces, facing_levels, facing_sides, self_intersections
from eldir_cad.kit.printer import Printer

_LEVEL = 1e-3  # heights closer than this are one [mm]
_SPECK = 0.02  # area below which a difference of two layers is rounding [mm2]
_BRIDGE = 1.0  # overhangs up to this width hold without supports [mm]


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
    levels, leaning = facing_levels(mesh), facing_faces(mesh, np.flatnonzero(_leaning(mesh)))
    wall, gap = min(levels[0], leaning[0]), min(levels[1], leaning[1])
    for slab in slabs:
        if slab.upright:
            sides = facing_sides([np.asarray(c, np.float64) for c in slab.section.to_polygons()])
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


def require_printable(name: str, mesh: trimesh.Trimesh, found: Inspection, printer: Printer) -> None:
    """Raise `EldirError` for a mesh that intersects itself or has features too fine for the printer."""
    crossing = self_intersections(mesh)
    if crossing:
        a, b = crossing[0]
        raise EldirError(
            f"part {name} cuts through itself",
            code="part.cuts-itself",
            expected="a surface without crossings",
            found=f"{len(crossing)} pairs of faces, {a} and {b} the first",
            remedy="check the dimensions in the specification",
        )
    least = printer.minimum
    for what, value, allowed in (("wall", found.wall, least.wall), ("gap", found.gap, least.gap)):
        if value < allowed - _LEVEL:
            raise EldirError(
                f"part {name} has a {what} that {printer.name} does not print",
                code="part.too-fine",
                expected=f"at least {allowed:g} mm",
                found=f"{value:.2f} mm, measured on its mesh",
                remedy="change the specification or choose another printer",
            )


class _Slab(NamedTuple):
    """A slab: the volume between two levels where the sides are upright, otherwise one layer."""

    bottom: float
    top: float
    section: CrossSection
    upright: bool


def _leaning(mesh: trimesh.Trimesh) -> BoolArray:
    z = np.asarray(mesh.triangles)[:, :, 2]
    return np.asarray((np.abs(mesh.face_normals[:, 2]) > 1e-3) & (np.ptp(z, axis=1) > _LEVEL))


def _slabs(mesh: trimesh.Trimesh, layer: float) -> Iterator[_Slab]:
    """The part from below upwards."""
    solid = Manifold(Mesh64(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.uint64)))
    heights = np.sort(np.asarray(mesh.vertices)[:, 2])
    levels = heights[np.concatenate([[True], np.diff(heights) > _LEVEL])]
    z = np.asarray(mesh.triangles)[_leaning(mesh), :, 2]
    low, high = z.min(axis=1), z.max(axis=1)
    edges = levels[:1].tolist()
    for top in levels[1:].tolist():
        crossed = bool(((low < top - _LEVEL) & (high > edges[-1] + _LEVEL)).any())
        steps = max(1, round((top - edges[-1]) / layer)) if crossed else 1
        for level in np.linspace(edges[-1], top, steps + 1)[1:].tolist():
            middle = solid.slice((edges[-1] + level) / 2)
            yield _Slab(edges[-1], level, middle, not crossed)
            edges.append(level)


def _unsupported(slabs: list[_Slab], layer: float) -> tuple[list[Feature], list[Feature]]:
    """Overhangs and islands, level by level. The supported area grows sideways by 45 degrees upwards."""
    overhangs, islands = [], []
    carried, below = slabs[0].section, slabs[0].section
    for bottom, top, above, _ in slabs[1:]:
        out = above - carried.offset(layer, JoinType.Round, circular_segments=16)
        for piece in above.decompose():
            if piece.area() > _SPECK and (piece ^ below).area() < 1e-6:
                islands.append(Feature(round(bottom, 3), round(piece.area(), 3)))
                out = out - piece
        pieces = out.decompose()
        narrow = [p for p in pieces if p.offset(-_BRIDGE / 2, JoinType.Round).is_empty()]
        area = out.area() - sum(p.area() for p in narrow)
        if area > _SPECK:
            overhangs.append(Feature(round(bottom, 3), round(area, 3)))
        # What is narrow holds as it is, but carries nothing until it has grown over.
        held = CrossSection.batch_boolean([above, *narrow], OpType.Subtract)
        grown = held.offset(top - bottom, JoinType.Round, circular_segments=16)
        carried = (above ^ grown).simplify(_LEVEL)  # or its corners multiply
        below = above
    return overhangs, islands


def _hollows(slabs: list[_Slab]) -> tuple[list[Feature], list[Feature]]:
    """Cups that stay open at their end away from the plate, and hollows that are closed again."""
    cups, sealed = [], []
    open_cups: list[tuple[float, float, CrossSection]] = []  # where it began, volume, its section
    before = CrossSection.square((0.0, 0.0))
    for bottom, top, section, _ in slabs:
        filled = CrossSection([c for c in section.to_polygons() if _turns_left(c)], FillRule.Positive)
        going_on: list[tuple[float, float, CrossSection]] = []
        taken: set[int] = set()
        for hollow in (filled - section).decompose():
            if hollow.area() < _SPECK:
                continue
            under = [k for k, (_, _, s) in enumerate(open_cups) if (s ^ hollow).area() > _SPECK]
            # What was open below, beside the cups, lets resin out.
            free = hollow - before
            for k in under:
                free = free - open_cups[k][2]
            if bottom > slabs[0].bottom and free.area() > _SPECK:
                continue
            start = min([open_cups[k][0] for k in under], default=bottom)
            # One that parts keeps its volume in the first of its parts.
            volume = sum(open_cups[k][1] for k in under if k not in taken) + hollow.area() * (top - bottom)
            taken |= set(under)
            going_on.append((start, volume, hollow))
        for k, (start, volume, cup) in enumerate(open_cups):
            if k not in taken and (cup - section).area() < _SPECK:
                sealed.append(Feature(round(start, 3), round(volume, 2)))
        open_cups, before = going_on, section
    cups += [Feature(round(start, 3), round(volume, 2)) for start, volume, _ in open_cups]
    return cups, sealed


def _turns_left(contour: object) -> bool:
    x, y = np.asarray(contour, np.float64).T
    return bool((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0)
