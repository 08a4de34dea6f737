"""The multibody model of a robot: rigid hubs, and the strips and coils between their sockets.

Both faces are one: they are equal and heated equally, so the robot is a prism that moves in its plane, and
every strip and coil here stands for two. Lengths are in metres, in the plane: x forward, y up.
`SIMPLIFICATIONS` remove one law of the model each, to find which of them a walk depends on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eldir.built.ground import check_terrain, find_lift
from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.wiring import FACES
from eldir.terrain import Terrain
from eldir_cad.checks.strip_law import StripLaw, built_parameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification
from eldir_cad.multibody.hubs import Inertia, hub_inertias

SOCKET_FRICTION = 0.2e-3
"""Torque at which a strip begins to rotate in its sockets of both faces [N m]. Assumed: a bulb of 1.2 mm
radius under 0.3 N with a coefficient of friction of 0.3."""
_UNLIMITED = math.radians(80)  # no strip rotates so far: hubs touch each other first
_NO_RADIUS = 1e-6  # of hubs that do not touch each other [m]


@dataclass(frozen=True, eq=False)
class Hub:
    """A hexagonal mass of both faces, with its connector or its caps."""

    position: FloatArray
    """Its centre in the assembled robot, above the lowest centres [m], shape (2,)."""
    inertia: Inertia
    friction: float
    """Coulomb coefficient between it and the table."""


@dataclass(frozen=True)
class Strip:
    """A strip of each face, between the sockets of two hubs."""

    hubs: tuple[int, int]
    length: float
    """Distance of its hinges without force [m]."""
    tension: float
    """Stiffness in tension [N/m]."""
    buckling: float
    """Compression at which it buckles [N]."""
    bending: float
    """E I / l [N m]; it bends where its socket stops it."""


@dataclass(frozen=True)
class CoilSpring:
    """The shape-memory spring of each face, between the sockets of two hubs."""

    hubs: tuple[int, int]
    stiffness: tuple[float, float]
    """Cold and hot [N/m]."""
    damping: float
    """Dashpot [N s/m]."""


@dataclass(frozen=True)
class Numerics:
    """Time step and contact settings of the simulation. docs/reference/second-physics-measured.md has the
    study behind the defaults."""

    step: float = 1e-3 / 3
    """Time step [s]."""
    contact_time: float = 2e-3 / 3
    """Time constant of contacts and of stiff strips [s]; at least two steps."""
    impratio: float = 100.0
    """Ratio of the stiffness of friction to that of the normal force."""
    impedance: float = 0.99
    """Impedance of contacts, 0 to 1; lower is softer."""


@dataclass(frozen=True, eq=False)
class Multibody:
    """A robot on a table."""

    hubs: Sequence[Hub]
    strips: Sequence[Strip]
    coils: Sequence[CoilSpring]
    socket: float
    """Distance from a hub's centre to the hinges in its sockets [m]; 0: pins at the centres."""
    corner: float
    """Distance from a hub's centre to its corners [m]; 0: hubs are points that do not touch each other."""
    contact_radius: float
    """Radius at which hubs touch each other [m]."""
    max_rotation: float | None
    """Rotation of a strip in its socket, in either direction, beyond which it bends [rad]; None: it rotates
    freely, and hubs do not rotate."""
    socket_friction: float
    """Torque at which a strip begins to rotate in a socket [N m]."""
    parameters: BuiltParameters
    """Parameters of the robot. Those count that act on all parts alike (drag, friction backward); the others
    are in hubs, strips and coils."""
    gravity: float
    """Positive upwards [m/s2]."""
    tilt: float = 0.0
    """Forward slope of the table [rad]."""
    terrain: Terrain | None = None
    """The ground, as high as a corner that stands on it; by default the table at height 0."""
    numerics: Numerics = field(default_factory=Numerics)

    @property
    def lift(self) -> float:
        """Height by which the assembled robot is lifted until it touches the terrain [m]."""
        if self.terrain is None:
            return 0.0
        return find_lift(np.array([hub.position for hub in self.hubs]), self.corner, self.terrain)

    def coil_commands(self, lengths: FloatArray, free: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Lengths between hinges [m] and stiffnesses [N/m] of the coils whose free lengths between centres
        are given, shape (K, A) each. `free`: cold and hot free length [m], between which the stiffness goes
        from cold to hot."""
        share_hot = np.clip((lengths - free[0]) / (free[1] - free[0]), 0, 1)
        ends = np.array([coil.stiffness for coil in self.coils]).reshape(-1, 2)
        return lengths - 2 * self.socket, ends[:, 0] + (ends[:, 1] - ends[:, 0]) * share_hot


def build_multibody(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    parameters: BuiltParameters | None = None,
    *,
    ballast: FloatArray | None = None,
    strip_extensions: FloatArray | None = None,
    friction_factors: FloatArray | None = None,
    tilt: float = 0.0,
    terrain: Terrain | None = None,
) -> Multibody:
    """The model of a design's robot.

    `parameters` of this robot; by default those that follow from the parts. `ballast` [kg] on each hub, shape
    (M,). `strip_extensions`: length of every strip beyond the drawing [m], shape (S,). `friction_factors`:
    friction of each hub as a multiple of `parameters.friction`, shape (M,). `tilt`: additional forward slope
    of the table [rad]. `terrain`: the ground, in metres of the printed robot, as `eldir.built.motion.drive`
    takes it. Raises `InputError` for one that is too steep or too fine.
    """
    if terrain is not None:
        check_terrain(terrain)
    nominal = built_parameters(spec, printer)
    robot = nominal if parameters is None else parameters
    count = len(morphology.positions)
    weights = np.zeros(count) if ballast is None else ballast
    factors = np.ones(count) if friction_factors is None else friction_factors
    extensions = np.zeros(len(morphology.springs)) if strip_extensions is None else strip_extensions
    assembly = assemble(morphology, spec)
    inertias = hub_inertias(assembly, spec, printer.material.density, robot, nominal, weights)
    positions = 1e-3 * assembly.centres
    strips, coils = _springs(morphology, spec, printer, robot, extensions)
    return Multibody(
        [
            Hub(position, inertia, robot.friction * factor)
            for position, inertia, factor in zip(positions, inertias, factors.tolist(), strict=True)
        ],
        strips,
        coils,
        socket=1e-3 * spec.bulb_radius_at,
        corner=1e-3 * spec.mass.across_corners / 2,
        contact_radius=1e-3 * (spec.mass.across_flats / 2 + spec.mass.across_corners / 2) / 2,
        max_rotation=float(np.radians(spec.strip.turn_deg)),
        socket_friction=SOCKET_FRICTION,
        parameters=robot,
        gravity=robot.gravity,
        tilt=robot.tilt + tilt,
        terrain=terrain,
    )


def _springs(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    robot: BuiltParameters,
    extensions: FloatArray,
) -> tuple[list[Strip], list[CoilSpring]]:
    """Strips and coils of both faces, as one."""
    law, nominal = StripLaw.of(spec, printer), built_parameters(spec, printer)
    # The modulus and the section of this robot's strips differ from the drawing.
    stiffness_ratio = robot.buckling / nominal.buckling
    bending = 1e-3 * law.flexural_rigidity / law.length * stiffness_ratio
    strips: list[Strip] = []
    coils: list[CoilSpring] = []
    for (a, b), active, extension in zip(
        morphology.springs.tolist(), morphology.active, extensions.tolist(), strict=True
    ):
        if active:
            stiffness = len(FACES) * robot.cold_stiffness, len(FACES) * robot.hot_stiffness
            coils.append(CoilSpring((a, b), stiffness, len(FACES) * robot.active_damping))
        else:
            length = 1e-3 * spec.hinge_to_hinge + extension
            forces = len(FACES) * robot.tension, len(FACES) * robot.buckling, len(FACES) * bending
            strips.append(Strip((a, b), length, *forces))
    return strips, coils


def with_pins(model: Multibody) -> Multibody:
    """Hubs are points that do not rotate, and strips are pinned to their centres, as in the printed scene."""
    hubs = [replace(hub, inertia=Inertia(hub.inertia.mass, np.zeros(3), np.eye(3))) for hub in model.hubs]
    strips = [replace(strip, length=strip.length + 2 * model.socket) for strip in model.strips]
    return replace(
        model, hubs=hubs, strips=strips, socket=0.0, corner=0.0, max_rotation=None, socket_friction=0.0
    )  # fmt: skip


def without_socket_friction(model: Multibody) -> Multibody:
    """Strips rotate in their sockets without friction."""
    return replace(model, socket_friction=0.0)


def without_socket_range(model: Multibody) -> Multibody:
    """Strips rotate in their sockets without limit. Strips that push past the centre of a hub then rotate it,
    and some robots fall."""
    return replace(model, max_rotation=None if model.max_rotation is None else _UNLIMITED)


def with_equal_feet(model: Multibody) -> Multibody:
    """All hubs have the mean friction of the robot's."""
    mean = float(np.mean([hub.friction for hub in model.hubs]))
    return replace(model, hubs=[replace(hub, friction=mean) for hub in model.hubs])


def without_hub_contact(model: Multibody) -> Multibody:
    """Hubs do not touch each other."""
    return replace(model, contact_radius=_NO_RADIUS)


def on_level_table(model: Multibody) -> Multibody:
    """The table does not slope."""
    return replace(model, tilt=0.0)


SIMPLIFICATIONS: dict[str, Callable[[Multibody], Multibody]] = {
    "hubs and sockets": with_pins,
    "socket friction": without_socket_friction,
    "socket range": without_socket_range,
    "feet that differ": with_equal_feet,
    "contact between hubs": without_hub_contact,
    "slope of the table": on_level_table,
}
"""What each of them removes, and the function that does it."""
