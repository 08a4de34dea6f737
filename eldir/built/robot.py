"""The printed robot: masses, strips and shape-memory springs of one plane; and whether it stands.

A robot stands if its centre of mass lies over its feet and no mechanism lets it collapse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eldir.core.arguments import require_count, require_shape, require_value
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters, Joints
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters

SOFT_TENSION = 20e3
"""Stiffness in tension of the strips of a coarse robot [N/m]."""
COARSE_DAMPING, COARSE_INERTIA = 0.25, 2.0
"""Damping of the strips and inertia of a coarse robot with hubs, as parts of those of the robot."""
_ON_GROUND = 1e-6  # height below which a mass is a foot [m]
_RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True, eq=False)
class PrintedRobot(Record):
    """One plane of a printed robot; springs are in the design's order, motors are the active ones."""

    positions: FloatArray
    """Rest positions on the table y = 0 [m], shape (M, 2)."""
    springs: IntArray
    """Mass indices of every spring, shape (S, 2)."""
    active: BoolArray
    """Whether a spring is a motor, shape (S,)."""
    masses: FloatArray
    """Masses [kg], shape (M,)."""
    rest_lengths: FloatArray
    """Rest lengths of the strips; of active springs the pitch [m], shape (S,)."""
    stiffness: FloatArray
    """Stiffness in tension [N/m], shape (S,); of active springs when hot."""
    buckling: FloatArray
    """Compression at which buckling begins [N], shape (S,); infinite for active springs."""
    damping: FloatArray
    """Dashpots [N s/m], shape (S,)."""
    feet: FloatArray
    """Friction of each mass as a multiple of `parameters.friction`, shape (M,)."""
    parameters: BuiltParameters
    coil: SpringParameters = field(default_factory=SpringParameters)
    """The springs of the motors, whose size decides when they buckle."""

    @property
    def body_length(self) -> float:
        """Initial horizontal extent of the mass centres [m]."""
        return float(np.ptp(self.positions[:, 0]))

    @property
    def friction(self) -> FloatArray:
        """Coulomb coefficient between each mass and the table, shape (M,)."""
        return self.parameters.friction * self.feet

    @property
    def joints(self) -> Joints:
        """What joins the strips."""
        return self.parameters.joints

    @property
    def bending(self) -> FloatArray:
        """E I / l of the strips, 0 for active springs [N m], shape (S,)."""
        return np.where(self.active, 0.0, self.parameters.bending)

    @property
    def inertias(self) -> FloatArray:
        """Moments of inertia about the masses [kg m2], shape (M,)."""
        return self.masses * self.parameters.gyration**2

    def with_parameters(self, parameters: BuiltParameters) -> PrintedRobot:
        """The same robot, with its ballast and the errors of its strips and feet, of other parameters."""
        p, now = parameters, self.parameters
        grown = p.scale / now.scale
        grown_masses = _masses(p, self.springs, self.active) - _masses(now, self.springs, self.active)
        return replace(
            self._with_masses(self.masses + grown_masses, p),
            positions=grown * self.positions,
            rest_lengths=grown * self.rest_lengths,
        )

    def coarse(
        self, tension: float = SOFT_TENSION, damping: float = COARSE_DAMPING, inertia: float = COARSE_INERTIA
    ) -> PrintedRobot:
        """A robot that walks on a table nearly as this one in a seventh of the time, for choices among many:
        with strips of at most `tension` [N/m] and, if it has hubs, `damping` times their damping and
        `inertia` times the inertia, so that longer steps are stable. On rugged ground it walks otherwise.

        With pins it keeps its masses, because it would fold. Clamped strips stay as they are.
        docs/reference/evolving-for-building.md and decision 56 have the error.
        """
        p = self.parameters
        if self.joints == "clamped":
            return self
        soft = replace(p, tension=min(p.tension, tension))
        if self.joints == "pins":
            return self.with_parameters(soft)
        soft = replace(soft, strip_damping=damping * p.strip_damping)
        return self.with_parameters(soft).with_mass_scaling(inertia)

    def with_mass_scaling(self, factor: float) -> PrintedRobot:
        """The robot with `factor` times the inertia and the same weight (mass scaling, as in explicit finite
        elements of slow processes). Drag and dashpots change so that all of it is as if time went slower.
        Raises `InputError` for a factor below 1."""
        require_value("factor", 1 <= factor < np.inf, "1 or more", factor)
        p, slower = self.parameters, np.sqrt(factor)
        return replace(
            self,
            masses=factor * self.masses,
            damping=np.where(self.active, self.damping, slower * self.damping),
            parameters=replace(
                p, gravity=p.gravity / factor, drag=p.drag / slower, hexagon=factor * p.hexagon
            ),
        )

    def with_ballast(self, ballast: float | FloatArray) -> PrintedRobot:
        """The same robot with more ballast [kg]; see `build`."""
        masses = _add_ballast(self.masses.copy(), self.positions, ballast)
        return self._with_masses(masses, self.parameters)

    def _with_masses(self, masses: FloatArray, p: BuiltParameters) -> PrintedRobot:
        stiffness, buckling, damping = _spring_values(p, masses, self.springs, self.active)
        return replace(
            self, masses=masses, stiffness=stiffness, buckling=buckling, damping=damping, parameters=p
        )

    @property
    def directions(self) -> FloatArray:
        """Unit vectors from the second to the first mass of every spring, as assembled, shape (S, 2)."""
        a, b = self.springs.T
        along = self.positions[a] - self.positions[b]
        return along / np.linalg.norm(along, axis=1, keepdims=True)

    @property
    def bending_delay(self) -> float:
        """Time [s] by which the rotation of a strip is taken ahead, so that bending is damped.

        With this time, two bare hexagons that swing across a clamped strip (stiffness 12 E I / l^3) have the
        damping ratio of the strip. A bare hub that swings in its sockets is damped six times as much.
        """
        p = self.parameters
        if self.joints == "pins":
            return 0.0
        return 2 * p.strip_damping * float(np.sqrt(p.hexagon / 2 * p.pitch**2 / (12 * p.bending)))


def build(
    morphology: Morphology,
    parameters: BuiltParameters | RobotParameters | None = None,
    *,
    without_motor: int | None = None,
    ballast: float | FloatArray = 0.0,
    rng: np.random.Generator | None = None,
) -> PrintedRobot:
    """The printed robot of a design.

    `without_motor`: this motor (0 is the first) is replaced by a strip, as in the paper's control.
    `ballast` [kg]: a number is put on the foremost mass, shape (M,) on each mass. With `rng`, the lengths of
    the strips are sampled with the standard deviation `parameters.geometry`. `RobotParameters` may hold the
    length of every strip, which is added, and the friction of every foot. Raises `InputError` for a motor,
    strips or feet that the body does not have, and for a ballast that does not fit or leaves no mass.
    """
    robot = parameters
    if not isinstance(robot, RobotParameters):
        robot = RobotParameters(robot or BuiltParameters())
    p, strips, feet = robot.printed, robot.strips, robot.feet
    if len(strips):
        require_count("strips", len(strips), len(morphology.springs), "spring")
    if len(feet):
        require_count("feet", len(feet), len(morphology.positions), "mass")
    active = _active_springs(morphology, without_motor)
    x = (morphology.positions - morphology.positions.min(axis=0)) * p.scale
    masses = _add_ballast(_masses(p, morphology.springs, active), x, ballast)
    stiffness, buckling, damping = _spring_values(p, masses, morphology.springs, active)
    noise = p.geometry * rng.standard_normal(len(active)) if rng is not None else 0.0
    lengths = morphology.rest_lengths * p.scale + np.where(active, 0.0, noise)
    return PrintedRobot(
        positions=x,
        springs=morphology.springs,
        active=active,
        masses=masses,
        rest_lengths=lengths + strips if len(strips) else lengths,
        stiffness=stiffness,
        buckling=buckling,
        damping=damping,
        feet=feet if len(feet) else np.ones(len(x)),
        parameters=p,
        coil=robot.springs,
    )


def _active_springs(morphology: Morphology, without_motor: int | None) -> BoolArray:
    """Whether each spring is a motor, shape (S,), after one motor is replaced by a strip."""
    active = morphology.active.copy()
    if without_motor is not None:
        motors = np.flatnonzero(active)
        known = 0 <= without_motor < len(motors)
        require_value("without_motor", known, f"0 to {len(motors) - 1}", without_motor)
        active[motors[without_motor]] = False
    return active


def _spring_values(
    p: BuiltParameters, masses: FloatArray, springs: IntArray, active: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stiffness, buckling load and dashpot of every spring; see `PrintedRobot`."""
    a, b = springs.T
    reduced = masses[a] * masses[b] / (masses[a] + masses[b])
    return (
        np.where(active, p.hot_stiffness, p.tension),
        np.where(active, np.inf, p.buckling),
        np.where(active, p.active_damping, 2 * p.strip_damping * np.sqrt(p.tension * reduced)),
    )


def _masses(p: BuiltParameters, springs: IntArray, active: BoolArray) -> FloatArray:
    """Masses [kg], shape (M,): hexagons, half of each spring at either end, and connectors at the edge of the
    body."""
    masses = np.full(int(springs.max()) + 1, p.hexagon)
    half = np.where(active, p.active_spring, p.strip) / 2
    for ends in springs.T:
        np.add.at(masses, ends, half)
    degree = np.bincount(springs.ravel(), minlength=len(masses))
    return masses + np.where(degree < 6, p.half_connector, 0.0)


def _add_ballast(masses: FloatArray, positions: FloatArray, ballast: float | FloatArray) -> FloatArray:
    """Masses with ballast [kg]. Raises `InputError` for one that does not fit or leaves no mass."""
    require_shape("ballast", np.shape(ballast), (), masses.shape)
    if np.ndim(ballast):
        masses = masses + ballast
    else:
        masses[foremost_mass(positions)] += ballast
    require_value("ballast", ((masses > 0) & np.isfinite(masses)).all(), "0 kg or more", ballast)
    return masses


def foremost_mass(positions: FloatArray) -> int:
    """Index of the foremost mass, of equal ones the lowest."""
    return int(np.lexsort((positions[:, 1], -positions[:, 0]))[0])


def rest_state(robot: PrintedRobot) -> FloatArray:
    """State at rest as assembled: x, y, vx, vy; unless strips are pinned, also cosine, sine, spin of
    hexagons; shape (4 or 7, M)."""
    masses = len(robot.positions)
    rotations = np.repeat([[1.0], [0.0], [0.0]], masses, axis=1)[: 3 * (robot.joints != "pins")]
    return np.concatenate([robot.positions.T, np.zeros((2, masses)), rotations])


def feet(robot: PrintedRobot) -> IntArray:
    """Indices of the masses that touch the table as assembled."""
    return np.flatnonzero(robot.positions[:, 1] < _ON_GROUND)


def static_margin(robot: PrintedRobot) -> float:
    """Horizontal distance of the centre of mass inside the feet [m]; negative: the robot falls over."""
    stands = robot.positions[feet(robot), 0]
    centre = float(robot.masses @ robot.positions[:, 0] / robot.masses.sum())
    return min(centre - float(stands.min()), float(stands.max()) - centre)


def height_over_base(robot: PrintedRobot) -> float:
    """Height of the robot divided by the distance of its outermost feet."""
    stands = robot.positions[feet(robot), 0]
    base = float(np.ptp(stands))
    return float(np.ptp(robot.positions[:, 1])) / base if base > 0 else np.inf


def triangles(springs: IntArray) -> IntArray:
    """All triples of masses that are connected with each other, ascending, shape (F, 3)."""
    count = int(springs.max()) + 1
    joined = np.zeros((count, count), bool)
    joined[springs[:, 0], springs[:, 1]] = True
    return np.array(
        [(a, b, c) for a, b in springs for c in np.flatnonzero(joined[a] & joined[b]) if c > b], np.int32
    ).reshape(-1, 3)


def min_area_ratio(robot: PrintedRobot, positions: FloatArray) -> float:
    """The smallest area of any triangle during a motion, as a fraction of its area at rest.

    Near 0 or negative: a mass has passed through the opposite spring, which real parts cannot.
    `positions`: [m], shape (T, M, 2).
    """
    corners = triangles(robot.springs)

    def areas(x: FloatArray) -> FloatArray:
        u, v = (
            x[..., corners[:, 1], :] - x[..., corners[:, 0], :],
            x[..., corners[:, 2], :] - x[..., corners[:, 0], :],
        )
        return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]

    return float((areas(positions) / areas(robot.positions)).min())


def min_mass_distance(positions: FloatArray) -> float:
    """The smallest distance between two masses during a motion [m]; `positions`: [m], shape (T, M, 2)."""
    a, b = np.triu_indices(positions.shape[1], 1)
    return float(np.sqrt((positions[:, a] - positions[:, b]) ** 2 @ np.ones(2)).min())


def find_shape_fault(robot: PrintedRobot) -> str:
    """Why the body does not keep its shape, or why its motors cannot change it; empty if neither is the
    case."""
    pinned = robot.parameters.bending == 0  # clamped strips hold a body that would fold on pins
    if pinned and (loose := count_mechanisms(robot.positions, robot.springs)):
        return f"{loose} free mechanisms with all springs in place"
    if not count_mechanisms(robot.positions, robot.springs[~robot.active]):
        return "rigid without its motors: they hardly move it"
    return ""


def find_held_motors(positions: FloatArray, springs: IntArray, active: BoolArray) -> IntArray:
    """Indices of the active springs whose two masses the strips hold in their places to each other, whatever
    the other motors do."""
    strips = springs[~active]
    free = count_mechanisms(positions, strips)
    held = [s for s in np.flatnonzero(active) if count_mechanisms(positions, [*strips, springs[s]]) == free]
    return np.array(held, np.int32)


def count_mechanisms(positions: FloatArray, springs: IntArray | Sequence[IntArray]) -> int:
    """Number of independent mechanisms: motions, beside the three rigid ones, that change no spring's length.

    2 M - 3 - rank of the rigidity matrix, for masses in general position: small random displacements remove
    the special angles of the lattice, so that only mechanisms of the graph count.
    """
    shaken = positions + 0.1 * 0.05 * np.random.default_rng(0).uniform(-1, 1, positions.shape)
    a, b = np.asarray(springs, np.int32).reshape(-1, 2).T  # none, where all springs are motors
    matrix = np.zeros((len(a), len(positions), 2))
    rows = np.arange(len(a))
    matrix[rows, a], matrix[rows, b] = shaken[a] - shaken[b], shaken[b] - shaken[a]
    sizes = np.linalg.svd(matrix.reshape(len(a), 2 * len(positions)), compute_uv=False)
    return 2 * len(positions) - 3 - int((sizes > _RANK * sizes.max(initial=0.0)).sum())
