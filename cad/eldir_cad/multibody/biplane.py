"""The robot with its two faces apart: discs joined by biplane connectors, strips and coils of each face.

`Multibody` treats both faces as one, so it moves in its plane. Here each face has its own strips, coils and
feet, and hubs move in all directions: the robot may twist, turn and fall over sideways. Axes: x forward, y to
the back, z up; the front face is at negative y.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain
from eldir_cad.checks.strip_law import built_parameters
from eldir_cad.checks.tipping import lateral_rotation
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification
from eldir_cad.multibody.discs import DiscPair, pair_discs
from eldir_cad.multibody.hubs import disc_inertias
from eldir_cad.multibody.model import CoilSpring, Multibody, Strip, build_multibody

POISSON_RATIO = 0.35
"""Of the cured resin: assumed, as of most glassy polymers."""


@dataclass(frozen=True)
class ConnectorStiffness:
    """A biplane connector between its two discs."""

    twist: float
    """Moment about its axis for each radian between the discs [N m/rad]."""
    shear: float
    """Force across it for each metre between the discs, which stay parallel [N/m]."""


@dataclass(frozen=True, eq=False)
class FaceParts:
    """The strips, coils and feet of one face, in the order of the planar model's."""

    strips: Sequence[Strip]
    coils: Sequence[CoilSpring]
    friction: FloatArray
    """Coulomb coefficient between each disc and the table, shape (M,)."""


@dataclass(frozen=True, eq=False)
class Biplane:
    """A robot of two faces on a table."""

    plane: Multibody
    """The same robot with both faces as one: places, table, sockets in the plane, common parameters."""
    front: FaceParts
    back: FaceParts
    discs: Sequence[DiscPair]
    """The discs of each hub, and whether their connector yields."""
    springs_at: float
    """Distance from the middle of the robot to the springs of a face [m]."""
    outside: float
    """Distance from the middle of the robot to the outer edge of its discs, on which it stands [m]."""
    connector: ConnectorStiffness
    """Stiffness of the connectors that yield."""
    lateral_rotation: float
    """Rotation of a strip out of its plane in a socket beyond which it bends, in either direction [rad]."""
    lateral_bending: float
    """E I / l of a strip out of its plane, as a multiple of that in the plane."""
    side_tilt: float = 0.0
    """Slope of the table to the back of the robot [rad]."""

    @property
    def faces(self) -> tuple[FaceParts, FaceParts]:
        """Front and back."""
        return self.front, self.back

    def coil_commands(self, lengths: FloatArray, free: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """As `Multibody.coil_commands`, for coils in the order front and back of the first motor, front and
        back of the second: shape (K, 2A) each."""
        pairs = zip(self.front.coils, self.back.coils, strict=True)
        both = replace(self.plane, coils=tuple(coil for pair in pairs for coil in pair))
        return both.coil_commands(lengths, free)


def build_biplane(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    parameters: BuiltParameters | None = None,
    *,
    ballast: FloatArray | None = None,
    strip_extensions: FloatArray | None = None,
    friction_factors: FloatArray | None = None,
    tilt: float = 0.0,
    side_tilt: float = 0.0,
    terrain: Terrain | None = None,
) -> Biplane:
    """The model of a design's robot with its faces apart.

    As `build_multibody`, except: `strip_extensions` of both faces, shape (2, S), and `friction_factors` of
    the feet of both, shape (2, M), front first. `side_tilt`: slope of the table to the back [rad].
    Connectors are rigid, because they change a walk by less than two robots differ; see
    `with_yielding_connectors`.
    """
    count = len(morphology.positions)
    extensions = np.zeros((2, len(morphology.springs))) if strip_extensions is None else strip_extensions
    factors = np.ones((2, count)) if friction_factors is None else friction_factors
    plane = build_multibody(
        morphology,
        spec,
        printer,
        parameters,
        ballast=ballast,
        strip_extensions=extensions.mean(axis=0),
        friction_factors=factors.mean(axis=0),
        tilt=tilt,
        terrain=terrain,
    )
    weights = np.zeros(count) if ballast is None else ballast
    nominal, density = built_parameters(spec, printer), printer.material.density
    parts = disc_inertias(assemble(morphology, spec), spec, density, plane.parameters, nominal, weights)
    lengths = 1e-3 * spec.hinge_to_hinge + extensions[:, ~morphology.active]
    front, back = (
        FaceParts(
            [_share_strip(strip, length) for strip, length in zip(plane.strips, own, strict=True)],
            [_share_coil(coil) for coil in plane.coils],
            plane.parameters.friction * feet,
        )
        for own, feet in zip(lengths.tolist(), factors, strict=True)
    )
    return Biplane(
        plane,
        front,
        back,
        [pair_discs(own["front"], own["back"], own.get("connector")) for own in parts],
        springs_at=1e-3 * spec.springs_at,
        outside=1e-3 * spec.outside,
        connector=connector_stiffness(spec, printer),
        lateral_rotation=lateral_rotation(spec),
        lateral_bending=(spec.strip.height / spec.strip.thickness) ** 2,
        side_tilt=side_tilt,
    )


def connector_stiffness(spec: Specification, printer: Printer) -> ConnectorStiffness:
    """Stiffness of a connector's column between the discs: a round bar of the resin. Torsion G J / l; shear
    of a beam whose ends stay parallel, 12 E I / l^3 and k G A / l in a row (Timoshenko; k = 0.9 of a
    circle)."""
    length, radius = 1e-3 * spec.connector.gap, 5e-4 * spec.connector.column_diameter
    material = printer.material
    shear_modulus = 1e6 * material.tensile_modulus / (2 * (1 + POISSON_RATIO))
    section = math.pi * radius**2
    bending = 12 * 1e6 * material.flexural_modulus * section * radius**2 / 4 / length**3
    return ConnectorStiffness(
        twist=shear_modulus * section * radius**2 / 2 / length,
        shear=1 / (1 / bending + length / (0.9 * shear_modulus * section)),
    )


def with_yielding_connectors(model: Biplane) -> Biplane:
    """Connectors that twist and shear as the part does: the motion takes twice the time."""
    return replace(
        model,
        discs=[replace(d, joining="yielding") if d.joining == "rigid" else d for d in model.discs],
    )


def with_lateral_rotation(model: Biplane, angle: float) -> Biplane:
    """Sockets that hold strips out of their plane at another angle [rad]; 0: without play."""
    return replace(model, lateral_rotation=angle)


def _share_strip(strip: Strip, length: float) -> Strip:
    """Of one face."""
    shared = strip.tension / 2, strip.buckling / 2, strip.bending / 2
    return Strip(strip.hubs, length, *shared)


def _share_coil(coil: CoilSpring) -> CoilSpring:
    """Of one face."""
    cold, hot = coil.stiffness
    return CoilSpring(coil.hubs, (cold / 2, hot / 2), coil.damping / 2)
