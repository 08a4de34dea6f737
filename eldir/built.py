"""The built robot as a scene of the engine: printed strips, gram masses, springs that heat.

Constants are assumptions from data sheets and geometry until they are measured; docs/reference/built.md
tells where each comes from. Those of the printed parts are what `cad.law` derives from the specification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np

from eldir.errors import EldirError, InputError
from eldir.frozen import BoolArray, FloatArray, IntArray, Record
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology
from eldir.stability import stable_step, stable_step_in_any_pose

if TYPE_CHECKING:
    from eldir.engine.driven_batch import Member

FINE = -1
_MAY_BE_ZERO = {"friction", "drag", "strip_damping", "active_damping", "geometry", "bending"}
_SAFETY = 0.95  # of the largest step that is stable in any pose


@dataclass(frozen=True)
class BuiltParameters:
    """What the build, not the design, decides."""

    pitch: float = 0.057
    """Distance of neighbouring masses [m]."""
    gravity: float = -9.81
    """[m/s2]"""
    friction: float = 0.5
    """Coulomb coefficient between a mass and the table."""
    drag: float = 1.0
    """Velocities decay at this rate [1/s]."""
    tension: float = 161e3
    """Of a strip in tension, E A / l [N/m]."""
    buckling: float = 3.51
    """Euler load of a strip whose ends turn in their sockets [N]."""
    bending: float = 0.0
    """E I / l of a strip whose ends are clamped in its hexagons [N m]; 0: pinned, hexagons do not turn."""
    strip_damping: float = 0.05
    """Damping ratio of a strip between its two masses, along it and, clamped, across."""
    cold_stiffness: float = 49.0
    """Of a shape-memory spring, all martensite [N/m]."""
    hot_stiffness: float = 124.0
    """All austenite [N/m]."""
    active_damping: float = 0.5
    """Of a shape-memory spring [N s/m]."""
    hexagon: float = 0.905e-3
    """Mass of a hexagon with its cap [kg]."""
    half_connector: float = 0.61e-3
    """What half a connector and fewer sockets add, on every mass with fewer than six springs [kg]."""
    strip: float = 0.324e-3
    """Mass of a strip [kg], half to each end."""
    active_spring: float = 1.95e-3
    """Mass of a shape-memory spring with its two ends [kg], half to each end."""
    gyration: float = 4.47e-3
    """Radius of gyration of a hexagon 12 mm across its flats [m]."""
    geometry: float = 0.0
    """Standard deviation of every strip's rest length from the drawing [m]."""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            allowed_zero = name in (
                "friction",
                "drag",
                "strip_damping",
                "active_damping",
                "geometry",
                "bending",
            )
            ok = np.isfinite(value) and (
                value < 0 if name == "gravity" else value > 0 or (allowed_zero and value == 0)
            )
            if not ok:
                raise InputError(f"BuiltParameters.{name} is wrong", found=repr(value))

    @property
    def scale(self) -> float:
        """Lengths of the built robot over those of the simulated one."""
        return self.pitch / (2 * HALF_SIDE)

    def perturbed(self, rng: np.random.Generator) -> BuiltParameters:
        """Another specimen: friction 0.7 to 1.3 of nominal, stiffness, damping and masses off by some per
        cent, strips 0.3 mm long or short (one sigma)."""
        off = {
            "tension": 0.1, "buckling": 0.1, "strip_damping": 0.2, "active_damping": 0.2, "drag": 0.1,
            "hexagon": 0.05, "half_connector": 0.05, "strip": 0.05, "active_spring": 0.02,
        }  # fmt: skip
        values: dict[str, float] = {
            name: getattr(self, name) * float(np.exp(s * rng.standard_normal())) for name, s in off.items()
        }
        soft = float(np.exp(0.05 * rng.standard_normal()))
        values |= {"cold_stiffness": self.cold_stiffness * soft, "hot_stiffness": self.hot_stiffness * soft}
        values |= {"friction": self.friction * float(rng.uniform(0.7, 1.3)), "geometry": 0.3e-3}
        values |= {"bending": self.bending * float(np.exp(0.1 * rng.standard_normal()))}
        return replace(self, **values)

    def to_json(self) -> dict[str, float]:
        """Plain values; the inverse of `from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, float]) -> BuiltParameters:
        """From `to_json`; names an unknown or missing field."""
        known = {f.name for f in fields(cls)}
        if set(values) != known:
            raise InputError(
                "the built scene's fields are wrong",
                expected=", ".join(sorted(known)),
                found=", ".join(sorted(values)),
            )
        return cls(**values)

    @classmethod
    def clamped(cls) -> BuiltParameters:
        """Strips of 1 mm clamped in their hexagons: they bend, and bear four times the load."""
        return cls(tension=178e3, buckling=17.1, bending=0.0194, hexagon=0.947e-3, half_connector=0.596e-3)


@dataclass(frozen=True, eq=False)
class BuiltRobot(Record):
    """One plane of a printed robot; springs in the design's order, motors are those still active."""

    positions: FloatArray
    """At rest on the table y = 0 [m], shape (M, 2)."""
    springs: IntArray
    """Shape (S, 2)."""
    active: BoolArray
    """Shape (S,)."""
    masses: FloatArray
    """[kg], shape (M,)."""
    rest_lengths: FloatArray
    """Of the strips; of active springs the pitch [m], shape (S,)."""
    stiffness: FloatArray
    """In tension [N/m], shape (S,); of active springs the hot one."""
    buckling: FloatArray
    """Greatest compression at its onset [N], shape (S,); infinite for active springs."""
    damping: FloatArray
    """[N s/m], shape (S,)."""
    parameters: BuiltParameters

    @property
    def body_length(self) -> float:
        """Initial horizontal extent of the mass centres [m]."""
        return float(np.ptp(self.positions[:, 0]))

    @property
    def clamped(self) -> bool:
        """Whether hexagons turn and bend the strips clamped in them."""
        return self.parameters.bending > 0

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
        """From the second to the first mass of every spring as assembled, of length 1, shape (S, 2)."""
        a, b = self.springs.T
        along = self.positions[a] - self.positions[b]
        return along / np.linalg.norm(along, axis=1, keepdims=True)

    @property
    def bending_delay(self) -> float:
        """A strip's bending moment is as if its rotation were ahead by this time [s].

        It gives two bare hexagons that swing across a clamped strip, with stiffness 12 E I / l^3, the
        strip's damping ratio.
        """
        p = self.parameters
        if not self.clamped:
            return 0.0
        return 2 * p.strip_damping * float(np.sqrt(p.hexagon / 2 * p.pitch**2 / (12 * p.bending)))


@dataclass(frozen=True, eq=False)
class Driven(Record):
    """A built robot's motion."""

    times: FloatArray
    """[s], shape (T,)."""
    positions: FloatArray
    """[m], shape (T, M, 2); NaN from where it blew up."""
    state: FloatArray
    """x, y, vx, vy (clamped: and cosine, sine, spin) at the end, to go on from, shape (4 or 7, M)."""
    status: int
    """`FINE` (-1), or the interval in which it blew up."""


def build(
    morphology: Morphology,
    parameters: BuiltParameters | None = None,
    *,
    without_motor: int | None = None,
    ballast: float | FloatArray = 0.0,
    rng: np.random.Generator | None = None,
) -> BuiltRobot:
    """The printed robot of a design.

    `without_motor`: this motor (0 is the first) is replaced by a strip, as in the paper's control.
    `ballast` [kg] sits on the foremost mass, or, shape (M,), on each. `rng` draws the strips' lengths where
    `parameters.geometry` is not 0.
    """
    p = parameters or BuiltParameters()
    active = morphology.active.copy()
    if without_motor is not None:
        motors = np.flatnonzero(active)
        if not 0 <= without_motor < len(motors):
            raise InputError(
                "there is no such motor", expected=f"0 to {len(motors) - 1}", found=str(without_motor)
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
    if np.ndim(ballast):
        masses += ballast
    else:
        masses[np.lexsort((x[:, 1], -x[:, 0]))[0]] += ballast
    reduced = masses[a] * masses[b] / (masses[a] + masses[b])
    noise = p.geometry * rng.standard_normal(len(a)) if rng is not None else 0.0
    return BuiltRobot(
        positions=x,
        springs=morphology.springs,
        active=active,
        masses=masses,
        rest_lengths=morphology.rest_lengths * p.scale + np.where(active, 0.0, noise),
        stiffness=np.where(active, p.hot_stiffness, p.tension),
        buckling=np.where(active, np.inf, p.buckling),
        damping=np.where(active, p.active_damping, 2 * p.strip_damping * np.sqrt(p.tension * reduced)),
        parameters=p,
    )


def rest_state(robot: BuiltRobot) -> FloatArray:
    """x, y, vx, vy as assembled and, clamped, cosine, sine and spin of hexagons, shape (4 or 7, M)."""
    masses = len(robot.positions)
    turned = np.repeat([[1.0], [0.0], [0.0]], masses, axis=1)[: 3 * robot.clamped]
    return np.concatenate([robot.positions.T, np.zeros((2, masses)), turned])


def drive(
    robots: Sequence[BuiltRobot],
    lengths: Sequence[FloatArray],
    interval: float,
    *,
    states: Sequence[FloatArray] | None = None,
    every: int = 1,
    step: float | None = None,
    free: tuple[float, float] | Sequence[tuple[float, float]] = (0.035, 0.075),
) -> list[Driven]:
    """Move robots by prescribed free lengths of their active springs.

    `lengths[r]`: (K + 1, A) [m] at instants 0, interval, ..., linear between. Positions are kept at
    every `every`-th instant. `states` go on from earlier motions. `step` [s] is refused where it
    exceeds the stable one; by default it is 0.95 of what is stable in any pose. Stiffness goes from cold to
    hot as the free length goes from `free[0]` to `free[1]`, for all robots or each with its own.
    """
    from eldir.engine import driven_batch

    check_tables(robots, lengths)
    if not robots:
        return []
    ranges = np.broadcast_to(np.asarray(free, np.float64), (len(robots), 2)).tolist()
    members = [
        member(robot, np.asarray(table, np.float64), interval, step, (cold, hot), state)
        for robot, table, (cold, hot), state in zip(
            robots, lengths, ranges, states if states is not None else map(rest_state, robots), strict=True
        )
    ]
    motions = []
    for x, end, blown, _ in driven_batch.run(members, every):
        if blown != FINE:
            x[blown // every + 1 :] = np.nan
        motions.append(Driven(np.arange(len(x)) * every * interval, x, end, blown))
    return motions


def check_tables(robots: Sequence[BuiltRobot], lengths: Sequence[FloatArray]) -> None:
    """Whether there are free lengths for every active spring, at two instants at least."""
    for r, (robot, table) in enumerate(zip(robots, lengths, strict=True)):
        if table.ndim != 2 or table.shape[1] != robot.active.sum() or len(table) < 2:
            raise InputError(
                f"lengths of robot {r} have the wrong shape",
                expected=f"(2 or more, {robot.active.sum()})",
                found=str(table.shape),
            )


def member(
    robot: BuiltRobot,
    lengths: FloatArray,
    interval: float,
    step: float | None,
    free: tuple[float, float],
    state: FloatArray,
) -> Member:
    """What the engine wants to know of one robot."""
    from eldir.engine.driven_batch import Member

    p, (cold, hot) = robot.parameters, free
    order = np.argsort(~robot.active, kind="stable")
    substeps = _substeps(robot, interval, step)
    dt = interval / substeps
    heated = np.clip((lengths - cold) / (hot - cold), 0, 1)
    finite = np.where(np.isinf(robot.buckling), 1e30, robot.buckling)
    strips = np.stack([robot.rest_lengths, robot.stiffness, finite, robot.damping, robot.bending])
    return Member(
        springs=robot.springs[order],
        direction=robot.directions[order],
        strips=strips[:, order],
        per_mass=1 / np.stack([robot.masses, robot.inertias]),
        properties=np.array(
            [dt, p.gravity * dt, np.exp(-p.drag * dt), p.friction, substeps, robot.bending_delay]
        ),
        lengths=lengths,
        stiffnesses=p.cold_stiffness + (p.hot_stiffness - p.cold_stiffness) * heated,
        state=state,
    )


def _substeps(robot: BuiltRobot, interval: float, step: float | None) -> int:
    if step is None:
        return int(np.ceil(interval / (_SAFETY * stable_step_in_any_pose(robot))))
    largest = stable_step(robot)
    if step > largest:
        raise EldirError(
            "the step is too large for this robot",
            expected=f"at most {largest * 1e3:.4g} ms",
            found=f"{step * 1e3:.4g} ms",
            remedy="leave the step to the engine",
        )
    return int(np.ceil(interval / step))
