"""Measurement of a mesh in its printing pose: walls, gaps, overhangs and hollows [mm].

Everything here is read from the mesh that is written to the file, not from the drawing: walls and slots
along rays, overhangs, islands and cups from layer to layer, in the printing pose; and whether the surface
intersects itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple

import numpy as np
import trimesh
from manifold3d import CrossSection, FillRule, JoinType, Manifold, Mesh64, OpType
from pydantic import Field

from eldir.core.records import BoolArray, FloatArray, IntArray, Record, Rounded, record
from eldir.errors import EldirError
from eldir_cad.kit.printer import Printer

_TOLERANCE = 1e-3  # heights closer than this are equal [mm]
_MIN_AREA = 0.02  # a smaller difference of two layers is rounding [mm2]
_MAX_BRIDGE = 1.0  # overhangs up to this width hold without supports [mm]
_LEVEL = 0.999  # vertical component of the normal of a level face
_FACING = -0.5  # cosine of the angle between normals, below which two sides form a wall or a slot


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


def measure_section(contours: Sequence[FloatArray]) -> tuple[float, float]:
    """Thinnest wall and narrowest slot of a plane figure: distances from each side to the opposite side.

    `contours` are closed, shape (n, 2) each, the figure to their left.
    """
    if not contours:
        return np.inf, np.inf
    start = np.concatenate(contours)
    end = np.concatenate([np.roll(c, -1, axis=0) for c in contours])
    length = np.linalg.norm(end - start, axis=1)
    keep = length > 1e-4
    start, end, length = start[keep], end[keep], length[keep]
    along = (end - start) / length[:, None]
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1)  # solid lies to the left
    facing = inward @ inward.T < _FACING
    wall, gap = np.inf, np.inf
    for share in (0.1, 0.5, 0.9):
        origin = start + share * (end - start)
        # Ray from side i along its normal n, side j: origin + t n = start_j + s along_j.
        reach = start[None] - origin[:, None]  # (i, j, 2)
        det = inward[:, None, 0] * along[None, :, 1] - inward[:, None, 1] * along[None, :, 0]
        safe = np.where(np.abs(det) < 1e-9, np.inf, det)
        t = (reach[..., 0] * along[None, :, 1] - reach[..., 1] * along[None, :, 0]) / safe
        s = (reach[..., 0] * inward[:, None, 1] - reach[..., 1] * inward[:, None, 0]) / safe
        hit = facing & (s >= 0) & (s <= length[None]) & np.isfinite(safe)
        wall = min(wall, float(t[hit & (t > 1e-6)].min(initial=np.inf)))
        gap = min(gap, float(-t[hit & (t < -1e-6)].max(initial=-np.inf)))
    return wall, gap


def measure_levels(mesh: trimesh.Trimesh) -> tuple[float, float]:
    """Thinnest floor and lowest slot between level faces: distances upwards from the middle of each face."""
    triangles, up = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)[:, 2]
    level = np.abs(up) > _LEVEL
    flat = triangles[level]
    upper: BoolArray = np.asarray(up[level] > 0)
    origin = flat.mean(axis=1)
    u, v = flat[:, 1, :2] - flat[:, 0, :2], flat[:, 2, :2] - flat[:, 0, :2]
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    # Row: the face that the ray leaves, upwards; column: the face that it meets.
    x = origin[:, None, 0] - flat[None, :, 0, 0]
    y = origin[:, None, 1] - flat[None, :, 0, 1]
    first, second = (x * v[:, 1] - y * v[:, 0]) / det, (u[:, 0] * y - u[:, 1] * x) / det
    rise = flat[None, :, 0, 2] - origin[:, None, 2]
    hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (rise > 1e-6)
    floors, slots = hit & ~upper[:, None] & upper[None], hit & upper[:, None] & ~upper[None]
    return float(rise[floors].min(initial=np.inf)), float(rise[slots].min(initial=np.inf))


def measure_inclined(mesh: trimesh.Trimesh, indices: IntArray) -> tuple[float, float]:
    """Thinnest wall and narrowest slot of a solid, along the normals of the faces with these indices."""
    triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    wall, gap = np.inf, np.inf
    for i in indices.tolist():
        facing = np.flatnonzero(normals @ normals[i] < _FACING)
        along = -normals[i]
        cross = np.cross(along, v[facing])
        det = (u[facing] * cross).sum(-1)
        from_a = triangles[i].mean(axis=0) - a[facing]
        turned = np.cross(from_a, u[facing])
        first, second = (from_a * cross).sum(-1) / det, turned @ along / det
        t = (v[facing] * turned).sum(-1) / det
        hit = (first >= 0) & (second >= 0) & (first + second <= 1)
        wall = min(wall, float(t[hit & (t > 1e-6)].min(initial=np.inf)))
        gap = min(gap, float(-t[hit & (t < -1e-6)].max(initial=-np.inf)))
    return wall, gap


def self_intersections(mesh: trimesh.Trimesh) -> list[tuple[int, int]]:
    """Pairs of faces without a common corner where an edge of one goes through the other."""
    triangles, faces = np.asarray(mesh.triangles), np.asarray(mesh.faces)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    last = np.searchsorted(low[order, 0], high[order, 0] - 1e-9)
    counts = np.maximum(last - np.arange(len(order)) - 1, 0)
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    i, j = order[first], order[second]
    overlaps = ((low[i] < high[j] - 1e-9) & (low[j] < high[i] - 1e-9)).all(axis=1)
    i, j = i[overlaps], j[overlaps]
    is_separate = ~(faces[i][:, :, None] == faces[j][:, None, :]).any(axis=(1, 2))
    i, j = i[is_separate], j[is_separate]
    hit = np.zeros(len(i), bool)
    for k in range(3):
        hit |= _pierces(triangles[i][:, k], triangles[i][:, (k + 1) % 3], triangles[j])
        hit |= _pierces(triangles[j][:, k], triangles[j][:, (k + 1) % 3], triangles[i])
    return list(zip(i[hit].tolist(), j[hit].tolist(), strict=True))


def _pierces(p: FloatArray, q: FloatArray, triangle: FloatArray) -> BoolArray:
    """Whether segments pq go through the inside of triangles, row by row (Moeller and Trumbore)."""
    a, u, v = triangle[:, 0], triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    along = q - p
    normal = np.cross(along, v)
    det = (u * normal).sum(-1)
    flat = np.abs(det) < 1e-12
    scale = 1 / np.where(flat, 1.0, det)
    from_a = p - a
    first = (from_a * normal).sum(-1) * scale
    turned = np.cross(from_a, u)
    second = (along * turned).sum(-1) * scale
    t = (v * turned).sum(-1) * scale
    edge = 1e-6
    inside = (first > edge) & (second > edge) & (first + second < 1 - edge)
    return np.asarray(inside & (t > edge) & (t < 1 - edge) & ~flat)
