"""The built robot: masses, strips and shape-memory springs of one printed plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eldir.core.arguments import require_number, require_shape, require_value
from eldir.core.records import BoolArray, FloatArray, IntArray, Record
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters, Joints
from eldir.parameters.robot import RobotParameters


@dataclass(frozen=True, eq=False)
class BuiltRobot(Record):
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
) -> BuiltRobot:
    """The printed robot of a design.

    `without_motor`: this motor (0 is the first) is replaced by a strip, as in the paper's control.
    `ballast` [kg]: a number is put on the foremost mass, shape (M,) on each mass. With `rng`, the lengths of
    the strips are drawn with the standard deviation `parameters.geometry`. `RobotParameters` may hold the
    length of every strip, which is added, and the friction of every foot. Raises `InputError` for a motor,
    strips or feet that the body does not have, and for a ballast that does not fit or leaves no mass.
    """
    robot = parameters
    if not isinstance(robot, RobotParameters):
        robot = RobotParameters(robot or BuiltParameters())
    p, strips, feet = robot.printed, robot.strips, robot.feet
    if len(strips):
        require_number("strips", len(strips), len(morphology.springs), "spring")
    if len(feet):
        require_number("feet", len(feet), len(morphology.positions), "mass")
    active = morphology.active.copy()
    if without_motor is not None:
        motors = np.flatnonzero(active)
        require_value(
            "without_motor", 0 <= without_motor < len(motors), f"0 to {len(motors) - 1}", without_motor
        )
        active[motors[without_motor]] = False
    x = (morphology.positions - morphology.positions.min(axis=0)) * p.scale
    a, b = morphology.springs.T
    masses = np.full(len(x), p.hexagon)
    half = np.where(active, p.active_spring, p.strip) / 2
    np.add.at(masses, a, half)
    np.add.at(masses, b, half)
    degree = np.bincount(morphology.springs.ravel(), minlength=len(x))
    masses += np.where(degree < 6, p.half_connector, 0.0)
    require_shape("ballast", np.shape(ballast), (), masses.shape)
    if np.ndim(ballast):
        masses += ballast
    else:
        masses[np.lexsort((x[:, 1], -x[:, 0]))[0]] += ballast
    require_value("ballast", ((masses > 0) & np.isfinite(masses)).all(), "0 kg or more", ballast)
    reduced = masses[a] * masses[b] / (masses[a] + masses[b])
    noise = p.geometry * rng.standard_normal(len(a)) if rng is not None else 0.0
    lengths = morphology.rest_lengths * p.scale + np.where(active, 0.0, noise)
    return BuiltRobot(
        positions=x,
        springs=morphology.springs,
        active=active,
        masses=masses,
        rest_lengths=lengths + strips if len(strips) else lengths,
        stiffness=np.where(active, p.hot_stiffness, p.tension),
        buckling=np.where(active, np.inf, p.buckling),
        damping=np.where(active, p.active_damping, 2 * p.strip_damping * np.sqrt(p.tension * reduced)),
        feet=feet if len(feet) else np.ones(len(x)),
        parameters=p,
    )


def rest_state(robot: BuiltRobot) -> FloatArray:
    """State at rest as assembled: x, y, vx, vy; clamped also cosine, sine, spin of hexagons; shape (4 or 7,
    M)."""
    masses = len(robot.positions)
    rotations = np.repeat([[1.0], [0.0], [0.0]], masses, axis=1)[: 3 * (robot.joints != "pins")]
    return np.concatenate([robot.positions.T, np.zeros((2, masses)), rotations])
