"""The parts of a robot and their positions: two identical planes at a distance [mm].

Axes: +x is the direction of travel, +y up, +z towards the front face, from which the body is seen as
in its design. The planes stand at equal distances from z = 0; masses open towards each other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from eldir.core.records import FloatArray, IntArray
from eldir.design import marked_masses
from eldir.morphology import Morphology
from eldir.parameters.wiring import FACES, Face
from eldir_cad.geometry import parts as kit
from eldir_cad.geometry.parts import Part
from eldir_cad.kit.specification import Specification

_MAX_GAP = 1.0  # wider gaps are not measured [mm]
_HALF_TURN_ABOUT_X = np.diag([1.0, -1.0, -1.0])
_Z_TO_X = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Placement:
    """One printed part in the robot: world = rotation @ printed + translation."""

    part: str
    rotation: FloatArray
    """Rotation matrix, shape (3, 3)."""
    translation: FloatArray
    """Translation [mm], shape (3,)."""
    masses: tuple[int, ...]
    """Indices of the mass that the part is, or of the masses that it touches."""
    face: Face | None
    """Face of the robot; None for parts that join both faces."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """The different parts of a robot, and the placements of all of them."""

    morphology: Morphology
    centres: FloatArray
    """Positions of the masses in their plane, from the lower left corner [mm], shape (M, 2)."""
    marks: IntArray
    """Mass indices of m1, m2, ..."""
    parts: Mapping[str, Part]
    placements: tuple[Placement, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Number of each part, in the order of `parts`."""
        counts = Counter(p.part for p in self.placements)
        return {name: counts[name] for name in self.parts}

    @property
    def volume(self) -> float:
        """Volume of all printed parts [mm3]."""
        return sum(self.parts[name].volume * n for name, n in self.counts.items())


def assemble(
    morphology: Morphology,
    spec: Specification,
    marks: IntArray | None = None,
    ballast: tuple[int, Part] | None = None,
    disc_faces: Sequence[Face] = FACES,
) -> Assembly:
    """All parts of both faces with their placements. `marks`: mass indices of m1, m2, ...; by default those
    of `marked_masses`.

    `ballast`: a mass, and the holder that it gets on each face. `disc_faces`: the faces on which m1, m2, ...
    have seats for discs; by default both, so that they weigh the same.
    """
    centres = (morphology.positions - morphology.positions.min(axis=0)) * spec.scale
    directions = spring_directions(morphology)
    marks = marked_masses(morphology) if marks is None else marks
    marker_names = {int(m): f"m{i + 1}" for i, m in enumerate(marks)}
    standard = [kit.strip(spec), kit.fitting(spec), kit.connector(spec), kit.cap(spec)]
    strip, fitting, connector, cap = standard
    parts: dict[str, Part] = {}
    placements: list[Placement] = []
    for face in FACES:
        for i, centre in enumerate(centres):
            marker = marker_names.get(i) if face in disc_faces else None
            part = kit.mass(spec, i, directions[i], face, marker)
            parts[part.name] = part
            placements.append(_place_mass(part.name, face, i, centre, spec))
            if len(directions[i]) == 6:
                placements.append(_place_cap(cap.name, face, i, centre, spec))
        for (a, b), active in zip(morphology.springs.tolist(), morphology.active, strict=True):
            ends = centres[a], centres[b]
            if active:
                placements.append(_place_fitting(fitting.name, face, a, *ends, spec))
                placements.append(_place_fitting(fitting.name, face, b, *ends[::-1], spec))
            else:
                placements.append(_place_strip(strip.name, face, (a, b), *ends, spec))
    length = spec.connector.gap - 2 * spec.clearance + 2 * spec.connector.peg_length
    for i, centre in enumerate(centres):
        if len(directions[i]) < 6:
            where = np.array([*centre, -length / 2])
            placements.append(Placement(connector.name, np.eye(3), where, (i,), None))
    if ballast is not None:
        mass, holder = ballast
        parts[holder.name] = holder
        placements += [_place_holder(holder, face, mass, centres[mass], spec) for face in FACES]
    used = {p.part for p in placements}
    parts |= {p.name: p for p in standard if p.name in used}
    return Assembly(morphology, centres, marks, parts, tuple(placements))


def spring_directions(morphology: Morphology) -> list[list[int]]:
    """For each mass, the directions of its springs, in multiples of 60 degrees from +x."""
    directions: list[list[int]] = [[] for _ in morphology.positions]
    for a, b in morphology.springs.tolist():
        dx, dy = morphology.positions[b] - morphology.positions[a]
        direction = round(np.degrees(np.arctan2(dy, dx)) / 60) % 6
        directions[a].append(direction)
        directions[b].append((direction + 3) % 6)
    return [sorted(d) for d in directions]


def smallest_gap(assembly: Assembly) -> tuple[float, str, str]:
    """The smallest gap between two placed parts [mm] and their names; 1 mm if no gap is smaller.

    A gap of 0 means that the parts touch or intersect. Only the front face and the parts that join the faces
    are checked; the back face is the mirror image.
    """
    placements = [p for p in assembly.placements if p.face != "back"]
    solids = [_solid(assembly, p) for p in placements]
    boxes = np.array([s.bounding_box() for s in solids]).reshape(-1, 2, 3)
    order = np.argsort(boxes[:, 0, 0])
    best = (_MAX_GAP, "", "")
    active: list[int] = []
    for i in order.tolist():
        active = [j for j in active if boxes[j, 1, 0] + _MAX_GAP > boxes[i, 0, 0]]
        for j in active:
            distance = np.maximum(boxes[i, 0] - boxes[j, 1], boxes[j, 0] - boxes[i, 1]).max()
            if distance < best[0]:
                gap = solids[i].min_gap(solids[j], _MAX_GAP)
                if gap < best[0]:
                    best = (float(gap), placements[j].part, placements[i].part)
        active.append(i)
    return best


def _solid(assembly: Assembly, placement: Placement) -> Manifold:
    matrix = np.column_stack([placement.rotation, placement.translation])
    return assembly.parts[placement.part].solid.transform(matrix)


def _place_mass(name: str, face: Face, i: int, centre: FloatArray, spec: Specification) -> Placement:
    rotation = _HALF_TURN_ABOUT_X if face == "front" else np.eye(3)
    return Placement(name, rotation, np.array([*centre, spec.outside * _sign(face)]), (i,), face)


def _place_holder(part: Part, face: Face, i: int, centre: FloatArray, spec: Specification) -> Placement:
    # The clearance between its ledge and the mass is for the glue.
    overhang = float(part.mesh.extents[2]) - spec.holder.sleeve + spec.clearance
    outermost = spec.outside + overhang
    rotation = _HALF_TURN_ABOUT_X if face == "front" else np.eye(3)
    return Placement(part.name, rotation, np.array([*centre, outermost * _sign(face)]), (i,), face)


def _place_cap(name: str, face: Face, i: int, centre: FloatArray, spec: Specification) -> Placement:
    inside = spec.connector.gap / 2 - spec.clearance - spec.connector.flange_thickness
    rotation = np.eye(3) if face == "front" else _HALF_TURN_ABOUT_X
    return Placement(name, rotation, np.array([*centre, inside * _sign(face)]), (i,), face)


def _place_strip(
    name: str, face: Face, masses: tuple[int, int], a: FloatArray, b: FloatArray, spec: Specification
) -> Placement:
    bottom = _springs_z(face, spec) - spec.strip.height / 2
    return Placement(name, _rotation_to(b - a), np.array([*(a + b) / 2, bottom]), masses, face)


def _place_fitting(
    name: str, face: Face, i: int, at: FloatArray, to: FloatArray, spec: Specification
) -> Placement:
    rotation = _rotation_to(to - at)
    reach = spec.coil_seat + spec.fitting.stud_length
    where = np.array([*at, _springs_z(face, spec)]) + rotation @ [reach, 0, 0]
    return Placement(name, rotation @ _Z_TO_X, where, (i,), face)


def _springs_z(face: Face, spec: Specification) -> float:
    """z of the middle of the springs."""
    return _sign(face) * spec.springs_at


def _sign(face: Face) -> int:
    return 1 if face == "front" else -1


def _rotation_to(along: FloatArray) -> FloatArray:
    """Rotation about z from +x to a direction in the plane."""
    c, s = along / np.linalg.norm(along)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
