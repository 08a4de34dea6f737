"""The parts of the kit as closed solids in the pose they are printed in, lowest point at z = 0 [mm]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import trimesh
from manifold3d import CrossSection, Manifold, OpType

from eldir.core.arguments import require_value
from eldir.parameters.wiring import FACES, Face
from eldir_cad.geometry.shapes import box, circle, extrude, hexagon, number, plug, to_mesh
from eldir_cad.kit.specification import Specification

_MIN_FILL, _MAX_FILL = 1.5, 40.0  # depth of the filling of a ballast holder [mm]


@dataclass(frozen=True, eq=False)
class Part:
    """A solid to print."""

    name: str
    solid: Manifold
    mesh: trimesh.Trimesh
    purpose: str
    """Purpose, for the bill of materials."""
    pose: str
    """Printing pose on the plate."""

    @property
    def volume(self) -> float:
        """Volume [mm3]."""
        return float(self.mesh.volume)


def mass(
    spec: Specification, index: int, directions: Sequence[int], face: Face, marker: str | None = None
) -> Part:
    """The mass `index` with a socket in each of its `directions` (multiples of 60 degrees from +x).

    Directions are those of the body as seen from the front. The mass is printed on its floor, which is the
    outer face of the robot. Therefore the engraving is mirrored here, in y for the front face and in x for
    the back face, and the sockets of the front face are mirrored in y.
    """
    m = spec.mass
    body = extrude(hexagon(m.across_flats), 0, m.height)
    sockets = [socket(spec).rotate(60.0 * d) for d in directions]
    opening = CrossSection.batch_boolean([hexagon(m.peg_hole), *sockets], OpType.Add)
    digits = number(index, m.digit_height, m.stroke, FACES.index(face) + 1)
    if face == "front":
        opening, digits = opening.mirror((0, 1)), digits.mirror((0, 1))
    else:
        digits = digits.mirror((1, 0))
    cuts = extrude(opening, m.floor, m.height + 1)
    seat = m.disc_depth if marker else 0.0
    if marker:
        cuts += extrude(circle(m.disc_diameter), -1, seat)
    cuts += extrude(digits, -1, seat + m.engraving_depth)
    purpose = f"mass {index}, {face} face" + (f", seat for the disc of {marker}" if marker else "")
    return make_part(f"mass_{index:02d}_{face}", body - cuts, purpose, "on its outer face, sockets up")


def mass_volume(spec: Specification, sockets: int) -> float:
    """Volume of a mass with this number of sockets, without engraving and seat [mm3]."""
    m = spec.mass
    hexagonal = hexagon(m.across_flats)
    cut = (hexagonal ^ socket(spec)).area() * sockets + hexagon(m.peg_hole).area()
    return float(hexagonal.area() * m.height - cut * m.socket_depth)


def engraved_volume(spec: Specification, masses: int) -> float:
    """Volume that the numbers of the masses 0 to `masses` - 1 take from both faces [mm3]."""
    m = spec.mass
    numbers = (number(i, m.digit_height, m.stroke, 1 + k) for i in range(masses) for k in range(len(FACES)))
    return m.engraving_depth * sum(float((digits ^ hexagon(m.across_flats)).area()) for digits in numbers)


def seat_volume(spec: Specification) -> float:
    """Volume that the seat of a tracking disc takes from a mass [mm3]."""
    return float(circle(spec.mass.disc_diameter).area()) * spec.mass.disc_depth


def strip(spec: Specification) -> Part:
    """Passive spring, printed on its edge so that its thickness is drawn by pixels, not layers."""
    s = spec.strip
    half = s.length / 2 - s.bulb_diameter / 2
    figure = box(-half, -s.thickness / 2, half, s.thickness / 2)
    figure = figure + circle(s.bulb_diameter, -half) + circle(s.bulb_diameter, half)
    return make_part("passive_spring", extrude(figure, 0, s.height), "passive spring", "on its edge")


def connector(spec: Specification) -> Part:
    """Biplane connector: peg, flange, column, flange, peg; printed upright."""
    c = spec.connector
    rise = c.gap - 2 * spec.clearance
    solid = extrude(hexagon(c.peg), 0, rise + 2 * c.peg_length)
    solid += extrude(circle(c.column_diameter), c.peg_length, c.peg_length + rise)
    for bottom in (c.peg_length, c.peg_length + rise - c.flange_thickness):
        solid += extrude(circle(c.flange_diameter), bottom, bottom + c.flange_thickness)
    return make_part("connector", solid, "biplane connector", "upright on one peg")


def cap(spec: Specification) -> Part:
    """Cover that keeps the strips in a mass with six springs, which has no connector."""
    c = spec.connector
    solid = extrude(circle(c.flange_diameter), 0, c.flange_thickness)
    solid += extrude(hexagon(c.peg), 0, c.flange_thickness + c.peg_length)
    return make_part("cap", solid, "cap of a mass with six springs", "on its flange, peg up")


def fitting(spec: Specification) -> Part:
    """End of a shape-memory spring: a strip's plug with a stud for the coil and a hole for the wire.

    Printed standing on the stud; the plug points up.
    """
    f, s = spec.fitting, spec.strip
    start = spec.coil_seat
    end = start + f.stud_length
    tongue = plug(spec.bulb_radius_at, s.bulb_diameter, s.thickness, end - f.stud_length / 2)
    solid = extrude(tongue, -s.height / 2, s.height / 2)
    stud = extrude(circle(f.stud_diameter), 0, f.stud_length).rotate((0, 90, 0)).translate((start, 0, 0))
    guide = extrude(circle(f.wire_guide, spec.guide_at), -s.height, s.height)
    # Along +x as in the robot; rotated upright, with the stud's end at z = 0.
    upright = (solid + stud - guide).translate((-end, 0, 0)).rotate((0, 90, 0))
    return make_part("spring_end", upright, "end fitting of a shape-memory spring", "on its stud, plug up")


def holder(spec: Specification, grams: float, resin: float) -> tuple[Part, float]:
    """Ballast holder that weighs `grams` when filled, of resin [g/cm3], and the weight of its filling [g].

    A tube without floor, glued over a mass's outer face; printed with its narrow bore down.
    """
    h, density = spec.holder, 1e-3 * resin
    outer, bore = hexagon(h.across_flats), hexagon(h.bore)
    sleeve = outer - hexagon(spec.mass.across_flats + 2 * spec.clearance)
    empty = density * sleeve.area() * h.sleeve
    grams_per_mm = density * (outer - bore).area() + 1e-3 * h.fill_density * bore.area()
    depth = (grams - empty) / grams_per_mm
    min_grams, max_grams = (2 * (empty + grams_per_mm * d) for d in (_MIN_FILL, _MAX_FILL))
    expected = f"{min_grams:.1f} to {max_grams:.1f} g in two holders"
    require_value("ballast", _MIN_FILL <= depth <= _MAX_FILL, expected, f"{2 * grams:g} g")
    solid = extrude(outer - bore, 0, depth) + extrude(sleeve, depth, depth + h.sleeve)
    part = make_part("ballast_holder", solid, "ballast holder", "on its narrow end")
    return part, 1e-3 * h.fill_density * bore.area() * depth


def socket(spec: Specification) -> CrossSection:
    """The socket of a plug along +x from a mass's centre: the plug, enlarged by the clearance, in all poses
    to which it can rotate, out through the mass's side."""
    s, gap, at, reach = spec.strip, spec.clearance, spec.bulb_radius_at, spec.mass.across_flats
    straight = plug(at, s.bulb_diameter + 2 * gap, s.thickness + 2 * gap, reach)
    if s.turn_deg == 0:
        return straight
    slot = box(0, -s.thickness / 2 - gap, reach, s.thickness / 2 + gap)
    swept = CrossSection.batch_hull([slot.rotate(turn) for turn in (-s.turn_deg, s.turn_deg)])
    # The hull of the two end poses reaches behind the hinge; in front of it, it is the flare.
    return straight + (swept ^ box(0, -reach, reach, reach)).translate((at, 0))


def make_part(name: str, solid: Manifold, purpose: str, pose: str) -> Part:
    """A part with the mesh of its solid, which must be closed."""
    return Part(name, solid, to_mesh(solid, name), purpose, pose)
