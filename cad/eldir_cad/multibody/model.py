"""The multibody model of a robot: hubs that are rigid, and the strips and coils between their sockets.

Both faces are one: they are alike and heated alike, so the robot is a prism that moves in its plane, and
every strip and coil here stands for two. Lengths are in metres, in the plane: x forward, y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from eldir.core.records import FloatArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir_cad.checks.strip_law import StripLaw, built_parameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification
from eldir_cad.multibody.hubs import Inertia, hub_inertias

SOCKET_FRICTION = 0.2e-3
"""Torque at which a strip begins to turn in its sockets of both faces [N m]. Assumed: a bulb of 1.2 mm radius
under 0.3 N with a coefficient of friction of 0.3."""
_FACES = 2


@dataclass(frozen=True, eq=False)
class Hub:
    """A hexagonal mass of both faces with what joins them."""

    place: FloatArray
    """Its centre in the robot as assembled, over the lowest centres [m], shape (2,)."""
    inertia: Inertia
    friction: float
    """Coulomb coefficient between it and the table."""


@dataclass(frozen=True)
class Strip:
    """A strip of each face, between the sockets of two hubs."""

    hubs: tuple[int, int]
    length: float
    """From hinge to hinge, without force [m]."""
    tension: float
    """Stiffness in tension [N/m]."""
    buckling: float
    """Compression at which it buckles [N]."""
    bending: float
    """E I / l [N m]; it bends where its socket stops it."""


@dataclass(frozen=True)
class Coil:
    """The shape-memory spring of each face, between the sockets of two hubs."""

    hubs: tuple[int, int]
    stiffness: tuple[float, float]
    """Cold and hot [N/m]."""
    damping: float
    """Dashpot [N s/m]."""


@dataclass(frozen=True)
class Numerics:
    """How finely the model is computed. docs/reference/second-physics-measured.md has the study behind the
    defaults."""

    step: float = 1e-3 / 3
    """Time step [s]."""
    contact_time: float = 2e-3 / 3
    """Time constant of contacts and of stiff strips [s]; at least two steps."""
    impratio: float = 100.0
    """How much stiffer friction is than the normal force."""
    impedance: float = 0.99
    """Of contacts, 0 to 1; the rest yields."""


@dataclass(frozen=True, eq=False)
class Multibody:
    """A robot on a table."""

    hubs: Sequence[Hub]
    strips: Sequence[Strip]
    coils: Sequence[Coil]
    socket: float
    """Distance from a hub's centre to the hinges in its sockets [m]; 0: pins at the centres."""
    corner: float
    """Distance from a hub's centre to its corners [m]; 0: hubs are points that do not touch each other."""
    touching: float
    """Radius at which hubs touch each other [m]."""
    turn: float | None
    """Rotation of a strip in its socket, either way, beyond which it bends [rad]; None: it turns freely, and
    hubs do not rotate."""
    socket_friction: float
    """Torque at which a strip begins to turn in a socket [N m]."""
    drag: float
    """Rate at which velocities decay [1/s]."""
    gravity: float
    """Positive upwards [m/s2]."""
    tilt: float = 0.0
    """The table falls forward by this angle [rad]."""
    numerics: Numerics = field(default_factory=Numerics)

    def coil_commands(self, lengths: FloatArray, free: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Lengths between hinges [m] and stiffnesses [N/m] of the coils whose free lengths between centres
        are given, shape (K, A) each. `free`: cold and hot free length [m], between which the stiffness goes
        from cold to hot."""
        hot = np.clip((lengths - free[0]) / (free[1] - free[0]), 0, 1)
        ends = np.array([coil.stiffness for coil in self.coils]).reshape(-1, 2)
        return lengths - 2 * self.socket, ends[:, 0] + (ends[:, 1] - ends[:, 0]) * hot


def multibody(
    morphology: Morphology,
    spec: Specification,
    printer: Printer,
    parameters: BuiltParameters | None = None,
    *,
    ballast: FloatArray | None = None,
    strips: FloatArray | None = None,
    feet: FloatArray | None = None,
    tilt: float = 0.0,
) -> Multibody:
    """The model of a design's robot.

    `parameters` of this robot; by default those that follow from the parts. `ballast` [kg] on each hub, shape
    (M,). `strips`: length of every strip beyond the drawing [m], shape (S,). `feet`: friction of each hub as
    a multiple of `parameters.friction`, shape (M,). `tilt`: the table falls forward by this angle more [rad].
    """
    nominal = built_parameters(spec, printer)
    own = nominal if parameters is None else parameters
    count, law = len(morphology.positions), StripLaw.of(spec, printer)
    weights = np.zeros(count) if ballast is None else ballast
    longer = np.zeros(len(morphology.springs)) if strips is None else strips
    factors = np.ones(count) if feet is None else feet
    assembly = assemble(morphology, spec)
    inertias = hub_inertias(assembly, spec, printer.material.density, own, nominal, weights)
    places = 1e-3 * assembly.centres
    stiff = (
        own.buckling / nominal.buckling
    )  # the strips' modulus and section, as they differ from the drawing
    bending = 1e-3 * law.flexural_rigidity / law.length * stiff
    found: list[Strip] = []
    coils: list[Coil] = []
    for (a, b), active, more in zip(
        morphology.springs.tolist(), morphology.active, longer.tolist(), strict=True
    ):
        if active:
            stiffness = _FACES * own.cold_stiffness, _FACES * own.hot_stiffness
            coils.append(Coil((a, b), stiffness, _FACES * own.active_damping))
        else:
            length = 1e-3 * spec.hinge_to_hinge + more
            forces = _FACES * own.tension, _FACES * own.buckling, _FACES * bending
            found.append(Strip((a, b), length, *forces))
    flats = spec.mass.across_flats / 2
    return Multibody(
        [
            Hub(place, inertia, own.friction * factor)
            for place, inertia, factor in zip(places, inertias, factors.tolist(), strict=True)
        ],
        found,
        coils,
        socket=1e-3 * spec.bulb_radius_at,
        corner=1e-3 * spec.mass.across_corners / 2,
        touching=1e-3 * (flats + spec.mass.across_corners / 2) / 2,
        turn=float(np.radians(spec.strip.turn_deg)),
        socket_friction=SOCKET_FRICTION,
        drag=own.drag,
        gravity=own.gravity,
        tilt=own.tilt + tilt,
    )
