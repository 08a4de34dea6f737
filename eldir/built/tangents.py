"""Tangents: derivatives of the inputs of a printed robot's motion with respect to its parameters.

A parameter changes masses, springs, free lengths and ground all at once. A `Tangent` is the derivative of
all these inputs with respect to one parameter; `TANGENTS` lists those that have a name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from eldir.built.motion import FREE, stiffnesses
from eldir.built.robot import PrintedRobot, foremost_mass
from eldir.core.records import FloatArray, Record
from eldir.errors import InputError


@dataclass(frozen=True, eq=False)
class Tangent(Record):
    """Derivative of all inputs of `eldir.built.motion.drive` with respect to one parameter.

    Units are those below per unit of the parameter. One number stands for all masses, springs or instants.
    """

    masses: FloatArray | float = 0.0
    """Masses [kg], shape (M,)."""
    inertias: FloatArray | float = 0.0
    """Moments of inertia of the hexagons [kg m2], shape (M,)."""
    rest_lengths: FloatArray | float = 0.0
    """Rest lengths of the strips [m], shape (S,)."""
    stiffness: FloatArray | float = 0.0
    """Stiffness of the strips in tension [N/m], shape (S,)."""
    buckling: FloatArray | float = 0.0
    """Euler loads of the strips [N], shape (S,)."""
    damping: FloatArray | float = 0.0
    """Dashpots of the springs [N s/m], shape (S,)."""
    bending: FloatArray | float = 0.0
    """Bending stiffness E I / l of the strips [N m], shape (S,)."""
    bending_delay: float = 0.0
    """Bending delay [s] (`eldir.built.robot.PrintedRobot.bending_delay`)."""
    gravity: float = 0.0
    """Gravity across the table [m/s2]."""
    downhill: float = 0.0
    """Gravity along the table, positive forwards [m/s2]."""
    drag: float = 0.0
    """Drag [1/s]."""
    friction: FloatArray | float = 0.0
    """Coefficients of friction, shape (M,)."""
    lengths: FloatArray | float = 0.0
    """Free lengths of the active springs at the instants [m], shape (K + 1, A)."""
    stiffnesses: FloatArray | float = 0.0
    """Stiffness of the active springs at the instants [N/m], shape (K + 1, A)."""
    state: FloatArray | float = 0.0
    """Initial state, shape (4 or 7, M), see `eldir.built.robot.rest_state`."""


@dataclass(frozen=True)
class DriveInputs:
    """One robot and the free lengths that move it: the arguments of `eldir.built.motion.drive`."""

    robot: PrintedRobot
    lengths: FloatArray
    """Free lengths of the active springs [m], shape (K + 1, A)."""
    interval: float
    """Time between two instants [s]."""
    free: tuple[float, float] = FREE
    """Cold and hot free length [m]."""

    @property
    def heated_fraction(self) -> FloatArray:
        """Heated fraction: 0 cold, 1 hot, linear in the free length, shape (K + 1, A)."""
        cold, hot = self.free
        return (self.lengths - cold) / (hot - cold)

    @property
    def stiffnesses(self) -> FloatArray:
        """Stiffness of the active springs [N/m], shape (K + 1, A)."""
        return stiffnesses(self.robot.parameters, self.lengths, self.free)

    def length_tangent(self, d_lengths: FloatArray) -> Tangent:
        """Tangent of a parameter that acts through the free lengths, such as a current.

        `d_lengths`: derivatives of the free lengths [m], shape (K + 1, A). The stiffness follows the length.
        """
        p, (cold, hot) = self.robot.parameters, self.free
        inside = (self.heated_fraction > 0) & (self.heated_fraction < 1)
        stiffening = np.where(inside, (p.hot_stiffness - p.cold_stiffness) / (hot - cold), 0.0)
        return Tangent(lengths=d_lengths, stiffnesses=d_lengths * stiffening)

    def mass_tangent(self, d_masses: FloatArray) -> Tangent:
        """Tangent of a parameter that acts through the masses.

        `d_masses`: derivatives of the masses [kg], shape (M,). The moments of inertia of the hexagons follow,
        and the dashpots of the strips, whose damping ratio is fixed.
        """
        robot = self.robot
        (a, b), m = robot.springs.T, robot.masses
        share = (d_masses[a] / m[a] * m[b] + d_masses[b] / m[b] * m[a]) / (m[a] + m[b])
        return Tangent(
            masses=d_masses,
            inertias=d_masses * robot.parameters.gyration**2,
            damping=np.where(robot.active, 0.0, robot.damping / 2 * share),
        )


def _tension(drive: DriveInputs) -> Tangent:
    r = drive.robot
    strips = (~r.active).astype(float)
    return Tangent(stiffness=strips, damping=strips * r.damping / (2 * r.stiffness))


def _bending(drive: DriveInputs) -> Tangent:
    r = drive.robot
    if r.joints == "pins":
        raise InputError(
            "pinned strips have no bending stiffness",
            code="robot.pinned",
            remedy="start from BuiltParameters.clamped",
        )
    return Tangent(
        bending=(~r.active).astype(float), bending_delay=-r.bending_delay / (2 * r.parameters.bending)
    )


def _strip_damping(drive: DriveInputs) -> Tangent:
    r, p = drive.robot, drive.robot.parameters
    (a, b), m = r.springs.T, r.masses
    critical = 2 * np.sqrt(r.stiffness * m[a] * m[b] / (m[a] + m[b]))
    delay = 0.0 if r.joints == "pins" else 2 * np.sqrt(p.hexagon / 2 * p.pitch**2 / (12 * p.bending))
    return Tangent(damping=np.where(r.active, 0.0, critical), bending_delay=float(delay))


def _hexagon(drive: DriveInputs) -> Tangent:
    r = drive.robot
    of_masses = drive.mass_tangent(np.ones(len(r.masses)))
    return Tangent(
        masses=of_masses.masses, inertias=of_masses.inertias, damping=of_masses.damping,
        bending_delay=r.bending_delay / (2 * r.parameters.hexagon),
    )  # fmt: skip


def _halves(drive: DriveInputs, of: FloatArray) -> Tangent:
    """Derivative of the masses [kg] when springs add mass: half of each at either end."""
    ends = drive.robot.springs.ravel()
    share = np.bincount(ends, np.repeat(of / 2, 2), minlength=len(drive.robot.masses))
    return drive.mass_tangent(share.astype(np.float64))


def _half_connector(drive: DriveInputs) -> Tangent:
    degree = np.bincount(drive.robot.springs.ravel(), minlength=len(drive.robot.masses))
    return drive.mass_tangent((degree < 6).astype(float))


def _ballast(drive: DriveInputs) -> Tangent:
    d_masses = np.zeros(len(drive.robot.positions))
    d_masses[foremost_mass(drive.robot.positions)] = 1.0
    return drive.mass_tangent(d_masses)


def _gravity(drive: DriveInputs) -> Tangent:
    tilt = drive.robot.parameters.tilt
    return Tangent(gravity=float(np.cos(tilt)), downhill=float(-np.sin(tilt)))


def _tilt(drive: DriveInputs) -> Tangent:
    g, tilt = drive.robot.parameters.gravity, drive.robot.parameters.tilt
    return Tangent(gravity=float(-g * np.sin(tilt)), downhill=float(-g * np.cos(tilt)))


def _lag(drive: DriveInputs) -> Tangent:
    return Tangent(
        lengths=-np.gradient(drive.lengths, drive.interval, axis=0),
        stiffnesses=-np.gradient(drive.stiffnesses, drive.interval, axis=0),
    )


TANGENTS: dict[str, Callable[[DriveInputs], Tangent]] = {
    "tension": _tension,
    "buckling": lambda d: Tangent(buckling=(~d.robot.active).astype(float)),
    "bending": _bending,
    "strip_damping": _strip_damping,
    "cold_stiffness": lambda d: Tangent(stiffnesses=1 - np.clip(d.heated_fraction, 0, 1)),
    "hot_stiffness": lambda d: Tangent(stiffnesses=np.clip(d.heated_fraction, 0, 1)),
    "active_damping": lambda d: Tangent(damping=d.robot.active.astype(float)),
    "cold_length": lambda d: Tangent(lengths=1 - d.heated_fraction),
    "hot_length": lambda d: Tangent(lengths=d.heated_fraction),
    "lag": _lag,
    "friction": lambda d: Tangent(friction=d.robot.feet),
    "gravity": _gravity,
    "tilt": _tilt,
    "drag": lambda d: Tangent(drag=1.0),
    "hexagon": _hexagon,
    "half_connector": _half_connector,
    "strip": lambda d: _halves(d, (~d.robot.active).astype(float)),
    "active_spring": lambda d: _halves(d, d.robot.active.astype(float)),
    "gyration": lambda d: Tangent(inertias=2 * d.robot.masses * d.robot.parameters.gyration),
    "ballast": _ballast,
}
"""Tangents by name: fields of `BuiltParameters`; cold and hot free length [m], with the same heating; a lag
of all motors [s]; ballast on the foremost mass [kg]."""
