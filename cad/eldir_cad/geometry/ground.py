"""The ground under a robot as parts to print: pieces of the plate's size, side by side on the table [mm].

A piece is the profile of the ground, with ribs, extruded over the robot's depth. It is printed on its back,
so that nothing overhangs. The front face, towards the camera, has its number, and marks where the robot
begins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from manifold3d import CrossSection, JoinType

from eldir.built.ground import PLATE_THICKNESS, on_table, printed_range
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.terrain import Terrain
from eldir_cad.geometry.parts import Part, make_part
from eldir_cad.geometry.shapes import box, extrude, number, polygon
from eldir_cad.kit.printer import Printer

_THICKNESS = 1e3 * PLATE_THICKNESS
_BESIDE = 10.0  # of ground on either side of the robot
_WALL, _END = 2.4, 10.0  # of a piece: its skin and ribs, and its solid ends
_CELL = 50.0  # longest hollow between two ribs
_MIN_CELL = 100.0  # smaller hollows are filled [mm2]
_MITER = 20.0  # sharp corners of hollows stay sharp
_KEPT = 2.0  # corners of 60 degrees and more stay sharp when thin walls are looked for
_TOLERANCE = 1e-3
_TONGUE = (5.0, 6.0)  # length and height
_BLOCK_STEP = 10.0  # heights of the blocks under pieces are multiples of it
_DIGITS, _STROKE, _ENGRAVED = 5.0, 0.8, 0.6  # height, line and depth of what is engraved
_MARK = 1.4  # height of a mark under the surface: it must not reach a hollow


@dataclass(frozen=True, eq=False)
class GroundPiece:
    """A piece of the ground."""

    part: Part
    """The piece in its printing pose: on its back, forward along x, up along y."""
    start: float
    """Where it begins, in the coordinate along which the robot travels [mm]."""
    end: float
    """Where it ends [mm]."""
    block: float
    """Height of the block that it stands on [mm]; 0: on the table."""
    surface: FloatArray
    """Corners of its surface, from its start: x and height over the table [mm], shape (K, 2)."""

    @property
    def height(self) -> float:
        """Height of the piece itself [mm]."""
        return float(self.surface[:, 1].max()) - self.block


@dataclass(frozen=True, eq=False)
class Ground:
    """The printed ground."""

    pieces: tuple[GroundPiece, ...]
    """From the rear to the front."""
    width: float
    """Across the direction of travel [mm]."""
    marks: tuple[float, float]
    """Where the robot's rearmost and foremost masses begin [mm]."""


def make_ground(
    terrain: Terrain, positions: FloatArray, depth: float, clearance: float, printer: Printer
) -> Ground:
    """The ground of a robot with masses at `positions` [m], shape (M, 2), which is `depth` deep [mm].

    A ground that is higher than the plate is divided into shorter pieces, or stands on blocks. Walls are
    `_WALL` thick, but for the sharp edges that the terrain and its cuts have. Raises `EldirError` for one
    that is too high or too deep to be printed even so, and for one with walls too thin for the printer.
    """
    first, last = (1e3 * x for x in printed_range(positions))
    lowered = on_table(terrain, positions)
    width = depth + 2 * _BESIDE
    cuts, blocks = _divide(lowered, first, last, width, printer)
    marks = 1e3 * float(positions[:, 0].min()), 1e3 * float(positions[:, 0].max())
    surfaces = [_surface(lowered, a, b) for a, b in pairwise(cuts)]
    pieces = []
    for i, (surface, block) in enumerate(zip(surfaces, blocks, strict=True)):
        profile = _hollow(surface, block)
        if i + 1 < len(surfaces):
            profile += _tongue(cuts[i + 1], max(block, blocks[i + 1]), 0.0)
        if i > 0:
            profile -= _tongue(cuts[i], max(block, blocks[i - 1]), clearance)
        _require_thick(i + 1, profile, cuts[i], terrain, printer)
        engraving = _engraving(i + 1, surface, block, marks)
        solid = extrude(profile, 0, width) - extrude(engraving, width - _ENGRAVED, width + 1)
        low = profile.bounds()[:2]
        name = f"ground_{i + 1:02d}"
        purpose = f"piece {i + 1} of the ground" + (f", on a block of {block:g} mm" if block else "")
        part = make_part(name, solid.translate((-low[0], -low[1], 0)), purpose, "on its back")
        pieces.append(GroundPiece(part, cuts[i], cuts[i + 1], block, surface))
    return Ground(tuple(pieces), width, marks)


def _divide(
    terrain: Terrain, first: float, last: float, width: float, printer: Printer
) -> tuple[list[float], list[float]]:
    """Where pieces of equal length begin and end, and the height of the block under each: long pieces before
    short ones, and pieces on the table before those on blocks."""
    room = np.array(printer.volume[:2]) - 2 * printer.margin
    highest = 0.0
    for on_blocks in (False, True):
        for along, up in (room, room[::-1]):
            count = int(np.ceil((last - first) / (along - _TONGUE[0])))
            cuts = np.linspace(first, last, count + 1).tolist()
            heights = [_surface(terrain, a, b)[:, 1] for a, b in pairwise(cuts)]
            blocks = [_block(float(h.min())) if on_blocks else 0.0 for h in heights]
            highest = max(h.max() - block for h, block in zip(heights, blocks, strict=True))
            if highest <= up and width <= printer.volume[2]:
                return cuts, blocks
    raise EldirError(
        f"the ground is too large for the plate of {printer.name}",
        code="ground.too-large",
        expected=f"pieces up to {room.max():g} mm high and {printer.volume[2]:g} mm deep",
        found=f"{highest:.0f} mm high, {width:.0f} mm deep",
        remedy="choose a larger printer or a terrain that is less steep",
    )


def _block(lowest: float) -> float:
    """Height of the block under a piece whose surface is at this height where it is lowest [mm]."""
    return _BLOCK_STEP * max(0, int((lowest - _THICKNESS) / _BLOCK_STEP + 1e-6))


def _surface(terrain: Terrain, start: float, end: float) -> FloatArray:
    """Corners of the surface from `start` to `end`, x and height [mm], shape (K, 2)."""
    x0 = 1e3 * terrain.x0
    # A corner next to a cut would make a face that is too thin to be a face.
    inside = x0[(x0 > start + 0.01) & (x0 < end - 0.01)]
    x = np.array([start, *inside, end])
    return np.stack([x, 1e3 * terrain.height(1e-3 * x)], axis=1)


def _hollow(surface: FloatArray, block: float) -> CrossSection:
    """The profile of a piece, with hollows between its ribs."""
    start, end = surface[0, 0], surface[-1, 0]
    whole = polygon(np.array([(start, block), (end, block), *surface[::-1]]))
    inside = whole.offset(-_WALL, JoinType.Miter, _MITER) ^ box(start + _END, block, end - _END, 1e6)
    count = max(1, int(np.ceil((end - start - 2 * _END) / (_CELL + _WALL))))
    ribs = np.linspace(start + _END, end - _END, count + 1)[1:-1]
    for rib in ribs:
        inside -= box(rib - _WALL / 2, block, rib + _WALL / 2, 1e6)
    for cell in inside.decompose():
        # What is too narrow to be a hollow is filled.
        opened = cell.offset(-1.0, JoinType.Miter, _MITER).offset(1.0, JoinType.Miter, _MITER)
        if opened.area() > _MIN_CELL:
            whole -= opened
    return whole


def _require_thick(
    number: int, profile: CrossSection, start: float, terrain: Terrain, printer: Printer
) -> None:
    """Raise `EldirError` for the profile of a piece with walls or ridges thinner than the printer's thinnest
    wall. Less than a square of that width may be lost at a corner."""
    minimum = printer.minimum.wall
    half = minimum / 2 - _TOLERANCE
    kept = profile.offset(-half, JoinType.Miter, _KEPT).offset(half, JoinType.Miter, _KEPT)
    lost = max((profile - kept).decompose(), key=lambda piece: piece.area(), default=CrossSection())
    if lost.area() < minimum**2:
        return
    left, low, right, high = lost.bounds()
    length = max(right - left, high - low)
    middle = (left + right) / 2
    corner = int(np.abs(terrain.x0 - 1e-3 * middle).argmin())
    raise EldirError(
        f"piece {number} of the ground has a wall that is too thin for {printer.name}",
        code="ground.too-thin",
        expected=f"at least {minimum:g} mm",
        found=f"{lost.area() / length:.2f} mm on average over a length of {length:.1f} mm, "
        f"{middle - start:.0f} mm from its rear end",
        remedy=f"make the terrain at x = {middle:.0f} mm (x0[{corner}]) wider, lower or less steep, or "
        "choose another printer",
    )


def _tongue(at: float, bottom: float, clearance: float) -> CrossSection:
    """The tongue at a cut, which points forward; with a clearance, its groove."""
    length, height = _TONGUE
    middle = bottom + _THICKNESS / 2
    half = height / 2 + clearance
    return box(at - 1.0, middle - half, at + length + clearance, middle + half)


def _engraving(value: int, surface: FloatArray, block: float, marks: tuple[float, float]) -> CrossSection:
    """The number at the end of a piece, and a line under the surface at each mark."""
    at = (surface[-1, 0] - _END / 2, block + _THICKNESS / 2)
    figure = number(value, _DIGITS, _STROKE, 1).translate(at)
    for x in _inside(marks, surface):
        height = float(np.interp(x, *surface.T))
        figure += box(x - _STROKE / 2, height - _MARK, x + _STROKE / 2, height + 1.0)
    return figure


def _inside(marks: tuple[float, float], surface: FloatArray) -> Iterator[float]:
    """The marks on a piece; one at a cut is on the piece behind it."""
    start, end = surface[0, 0], surface[-1, 0]
    for x in marks:
        if start < x <= end:
            yield float(np.clip(x, start + _STROKE, end - _STROKE))
