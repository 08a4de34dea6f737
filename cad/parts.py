"""The parts of the kit as closed solids in the pose they are printed in, lowest point at z = 0 [mm]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import trimesh
from manifold3d import CrossSection, Manifold, OpType

from cad.shapes import box, disc, extrude, hexagon, mesh_of, number, plug
from cad.specification import Specification

Face = Literal["front", "back"]
FACES: tuple[Face, Face] = ("front", "back")


@dataclass(frozen=True, eq=False)
class Part:
    """A solid to print."""

    name: str
    solid: Manifold
    mesh: trimesh.Trimesh
    purpose: str
    """What it is, for the bill of materials."""
    supports: str
    """What the slicer must support, or 'none'."""

    @property
    def volume(self) -> float:
        """[mm3]"""
        return float(self.mesh.volume)


def mass(
    spec: Specification, index: int, directions: Sequence[int], face: Face, mark: str | None = None
) -> Part:
    """The mass `index` with a socket in each of its `directions` (multiples of 60 degrees from +x).

    Directions are those of the body seen from the front. Printed on its floor, which is the
    outer face of the robot: so what is seen from outside is mirrored here, for the front face in
    y and for the back face in x, and the sockets of the front face are mirrored in y.
    """
    m = spec.mass
    body = extrude(hexagon(m.across_flats), 0, m.height)
    sockets = [_socket(spec).rotate(60.0 * d) for d in directions]
    opening = CrossSection.batch_boolean([hexagon(m.peg_hole), *sockets], OpType.Add)
    figures = number(index, m.digit_height, m.stroke, FACES.index(face) + 1)
    if face == "front":
        opening, figures = opening.mirror((0, 1)), figures.mirror((0, 1))
    else:
        figures = figures.mirror((1, 0))
    cuts = extrude(opening, m.floor, m.height + 1)
    seat = m.disc_depth if mark else 0.0
    if mark:
        cuts += extrude(disc(m.disc_diameter), -1, seat)
    cuts += extrude(figures, -1, seat + m.engraving_depth)
    purpose = f"mass {index}, {face} face" + (f", seat for the disc of {mark}" if mark else "")
    supports = "the disc's seat, from below" if mark else "none"
    return _part(f"mass_{index:02d}_{face}", body - cuts, purpose, supports)


def mass_volume(spec: Specification, sockets: int) -> float:
    """Of a mass with so many sockets, without engraving and seat [mm3]."""
    m = spec.mass
    hexagonal = hexagon(m.across_flats)
    cut = (hexagonal ^ _socket(spec)).area() * sockets + hexagon(m.peg_hole).area()
    return float(hexagonal.area() * m.height - cut * m.socket_depth)


def strip(spec: Specification) -> Part:
    """Passive spring, printed on its edge so that its thickness is drawn by pixels, not layers."""
    s = spec.strip
    half = s.length / 2 - s.bulb_diameter / 2
    figure = box(-half, -s.thickness / 2, half, s.thickness / 2)
    figure = figure + disc(s.bulb_diameter, -half) + disc(s.bulb_diameter, half)
    return _part("passive_spring", extrude(figure, 0, s.height), "passive spring")


def connector(spec: Specification) -> Part:
    """Biplane connector: peg, flange, column, flange, peg; printed upright."""
    c = spec.connector
    rise = c.gap - 2 * spec.clearance
    solid = extrude(hexagon(c.peg), 0, rise + 2 * c.peg_length)
    solid += extrude(disc(c.column_diameter), c.peg_length, c.peg_length + rise)
    for bottom in (c.peg_length, c.peg_length + rise - c.flange_thickness):
        solid += extrude(disc(c.flange_diameter), bottom, bottom + c.flange_thickness)
    return _part("connector", solid, "biplane connector", "both flanges, from below")


def cap(spec: Specification) -> Part:
    """Cover that keeps the strips in a mass with six springs, which has no connector."""
    c = spec.connector
    solid = extrude(disc(c.flange_diameter), 0, c.flange_thickness)
    solid += extrude(hexagon(c.peg), 0, c.flange_thickness + c.peg_length)
    return _part("cap", solid, "cap of a mass with six springs")


def fitting(spec: Specification) -> Part:
    """End of a shape-memory spring: a strip's plug with a stud for the coil and a hole for the wire.

    Printed standing on the stud; the plug points up.
    """
    f, s = spec.fitting, spec.strip
    start = spec.coil_seat
    end = start + f.stud_length
    tongue = plug(spec.bulb_radius_at, s.bulb_diameter, s.thickness, end - f.stud_length / 2)
    solid = extrude(tongue, -s.height / 2, s.height / 2)
    stud = extrude(disc(f.stud_diameter), 0, f.stud_length).rotate((0, 90, 0)).translate((start, 0, 0))
    guide = extrude(disc(f.wire_guide, spec.guide_at), -s.height, s.height)
    # Along +x as in the robot; stood upright with the stud's end at z = 0.
    standing = (solid + stud - guide).translate((-end, 0, 0)).rotate((0, 90, 0))
    return _part("spring_end", standing, "end fitting of a shape-memory spring")


def _socket(spec: Specification) -> CrossSection:
    """A plug grown by the clearance, out through the mass's side, in all poses that the plug can turn to."""
    s, gap, at, reach = spec.strip, spec.clearance, spec.bulb_radius_at, spec.mass.across_flats
    straight = plug(at, s.bulb_diameter + 2 * gap, s.thickness + 2 * gap, reach)
    if s.turn_deg == 0:
        return straight
    slot = box(0, -s.thickness / 2 - gap, reach, s.thickness / 2 + gap)
    swept = CrossSection.batch_hull([slot.rotate(turn) for turn in (-s.turn_deg, s.turn_deg)])
    # The hull of the two end poses reaches behind the hinge; in front of it, it is the flare.
    return straight + (swept ^ box(0, -reach, reach, reach)).translate((at, 0))


def _part(name: str, solid: Manifold, purpose: str, supports: str = "none") -> Part:
    return Part(name, solid, mesh_of(solid, name), purpose, supports)
