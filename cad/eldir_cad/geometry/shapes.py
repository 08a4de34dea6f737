"""Plane figures and solids of which the parts are made, by manifold3d; exported as closed meshes [mm]."""

from __future__ import annotations

import math

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold
from trimesh.exchange.stl import export_stl

from eldir.core.records import FloatArray
from eldir.errors import EldirError

COS_30 = math.sqrt(3) / 2
# The segments of each digit: top, upper right, lower right, bottom, lower left, upper left, middle.
_SEGMENTS = ("012345", "12", "01346", "01236", "1256", "02356", "023456", "012", "0123456", "012356")
_DIGIT_GAP = 0.35  # between digits, in widths of a digit


def polygon(points: FloatArray | list[tuple[float, float]]) -> CrossSection:
    """A simple polygon, counter-clockwise."""
    return CrossSection([np.asarray(points, float)])


def hexagon(across_flats: float) -> CrossSection:
    """A regular hexagon; its flats face the directions 0, 60, ... degrees."""
    angles = np.radians(30 + 60 * np.arange(6))
    radius = across_flats / 2 / COS_30
    return polygon(radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def circle(diameter: float, x: float = 0.0) -> CrossSection:
    """A circle around (x, 0), as a polygon of the same area."""
    corners = 32 if diameter < 4 else 64  # the same for bulbs and their sockets, so that their corners meet
    angle = 2 * math.pi / corners
    return CrossSection.circle(diameter / 2 * math.sqrt(angle / math.sin(angle)), corners).translate((x, 0.0))


def box(x0: float, y0: float, x1: float, y1: float) -> CrossSection:
    """A rectangle between two corners."""
    return CrossSection.square((x1 - x0, y1 - y0)).translate((x0, y0))


def plug(bulb_at: float, bulb: float, neck: float, reach: float) -> CrossSection:
    """The end of a strip along +x: a bulb, and a neck from it to x = `reach`. The same shape, enlarged, is
    its socket."""
    return circle(bulb, bulb_at) + box(bulb_at, -neck / 2, reach, neck / 2)


def number(value: int, height: float, stroke: float, lines: int) -> CrossSection:
    """A number in seven-segment digits, centred, over one or two lines that show which side is down."""
    width = height / 2
    w, h, t = width / 2, height / 2, stroke / 2
    segments = [
        box(-w - t, h - t, w + t, h + t),
        box(w - t, -t, w + t, h + t),
        box(w - t, -h - t, w + t, t),
        box(-w - t, -h - t, w + t, -h + t),
        box(-w - t, -h - t, -w + t, t),
        box(-w - t, -t, -w + t, h + t),
        box(-w - t, -t, w + t, t),
    ]
    text = str(value)
    advance = width + stroke + _DIGIT_GAP * width
    figure = CrossSection()
    for i, digit in enumerate(text):
        x = (i - (len(text) - 1) / 2) * advance
        for segment in _SEGMENTS[int(digit)]:
            figure += segments[int(segment)].translate((x, 0))
    half = len(text) * advance / 2 - _DIGIT_GAP * width / 2
    for line in range(lines):
        y = -h - t - (2 * line + 1.5) * stroke
        figure += box(-half, y - t, half, y + t)
    _, low, _, high = figure.bounds()
    return figure.translate((0, -(low + high) / 2))


def extrude(figure: CrossSection, bottom: float, top: float) -> Manifold:
    """The figure between two heights."""
    return figure.extrude(top - bottom).translate((0, 0, bottom))


def stl(mesh: trimesh.Trimesh) -> bytes:
    """The mesh as binary STL; the same mesh gives the same bytes."""
    return bytes(export_stl(mesh))


def to_mesh(solid: Manifold, name: str) -> trimesh.Trimesh:
    """The solid as a closed mesh of positive volume. Raises `EldirError` with the name of the part
    otherwise."""
    data = solid.to_mesh64()
    # STL has single precision; rounding here makes all formats equal.
    vertices = np.asarray(data.vert_properties, np.float64)[:, :3].astype(np.float32).astype(np.float64)
    mesh = trimesh.Trimesh(vertices, np.asarray(data.tri_verts, np.int64), process=False)
    if len(mesh.faces) == 0 or not mesh.is_watertight or mesh.volume <= 0:
        raise EldirError(
            f"part {name} is not a closed solid",
            code="part.not-closed",
            expected="a watertight mesh of positive volume",
            found=f"{len(mesh.faces)} faces, volume {mesh.volume:.3g} mm3",
            remedy="check the dimensions in the specification",
        )
    return mesh
