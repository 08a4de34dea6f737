"""Walks of printed robots: displacement, and what makes its prediction useless: falls, folding, coils that
buckle, and ties, in which chance decides which foot slips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import numpy as np

from eldir.built.gait import CYCLES, FreeLengths, Gait, free_lengths_batch
from eldir.built.ground import heights
from eldir.built.motion import OK, PrintedMotion, drive
from eldir.built.robot import PrintedRobot, min_area_ratio, min_mass_distance
from eldir.core.arguments import require_count, require_whole_number
from eldir.core.records import BoolArray, FloatArray
from eldir.parameters.springs import SpringParameters
from eldir.terrain import Terrain

TOPPLED_ANGLE = np.deg2rad(45)
"""Rotation beyond which a body has fallen over [rad]."""
FOLDED_AREA_RATIO = 0.1
"""A triangle that shrinks below this part of its area has folded: parts have passed through each other."""
_TOUCHING = 0.014  # between centres of two masses: hexagons of 12 mm across their flats touch [m]
_SAMPLE = 20  # intervals between positions kept: one second
_FINE_SAMPLE = 2  # the same where sliding is looked at: 0.1 s
MAX_TIE_SHARE = 0.3
"""A larger share of ties makes a prediction doubtful."""
_EVEN = 0.05  # of the load: both outer feet bear 45 to 55 per cent
_CONTACT = 1e-4  # heights up to this count as on the table [m]
_CORNER_ANGLES = np.radians(np.arange(-60, 61, 5))  # of a corner from straight down


@overload
def walk(
    robots: PrintedRobot,
    gait: Gait,
    springs: SpringParameters | None = None,
    *,
    cycles: int = CYCLES,
    terrain: Terrain | None = None,
) -> float: ...


@overload
def walk(
    robots: Sequence[PrintedRobot],
    gait: Gait | Sequence[Gait],
    springs: SpringParameters | None = None,
    *,
    cycles: int = CYCLES,
    terrain: Terrain | None = None,
) -> FloatArray: ...


def walk(
    robots: PrintedRobot | Sequence[PrintedRobot],
    gait: Gait | Sequence[Gait],
    springs: SpringParameters | None = None,
    *,
    cycles: int = CYCLES,
    terrain: Terrain | None = None,
) -> float | FloatArray:
    """Forward displacement of printed robots with a gait [body lengths per five cycles].

    One robot gives a number; n robots give shape (n,), with one gait for all or one for each. Minus infinity
    means that the robot fell over, folded until parts touch, or that a coil buckled. `springs`: the
    parameters of all motors' springs, by default nominal ones on the nominal supply. The first cycle is not
    measured, so that temperatures repeat; then `cycles` are measured. All robots run side by side.
    `terrain`: the ground, by default a table; see `eldir.built.ground`.
    Raises `InputError` for another number of gaits than robots, a gait of other motors, or no cycle.

    >>> import numpy as np
    >>> from eldir.built.gait import Gait
    >>> from eldir.built.robot import build
    >>> from eldir.built.walking import walk
    >>> from eldir.genotype import random_genotypes
    >>> from eldir.lattice import Lattice
    >>> from eldir.morphology import develop
    >>> lattice = Lattice(3, 6)
    >>> genotype = random_genotypes(lattice, 1, np.random.default_rng(10), max_active=2)[0]
    >>> robot = build(develop(lattice, genotype))
    >>> gait = Gait(period=20.0, phase=np.array([0.0, 0.125]), duty=np.array([0.3, 0.3]))
    >>> round(walk(robot, gait, cycles=1), 1)
    0.1
    """
    alone = isinstance(robots, PrintedRobot)
    every = [robots] if isinstance(robots, PrintedRobot) else list(robots)
    gaits = [gait] * len(every) if isinstance(gait, Gait) else list(gait)
    cycles = require_whole_number("cycles", cycles, 1)
    require_count("gaits", len(gaits), len(every))
    spring = springs or SpringParameters()
    heated = [(own, [spring] * int(robot.active.sum())) for own, robot in zip(gaits, every, strict=True)]
    hubs = [robot.springs[robot.active] for robot in every]
    tables = free_lengths_batch(heated, cycles, hubs=hubs)
    free = spring.cold_length, spring.hot_length
    every = [replace(robot, coil=spring) for robot in every]
    walks = displacements(every, tables, cycles, free, terrain=terrain)
    return float(walks[0]) if alone else walks


def displacements(
    robots: Sequence[PrintedRobot],
    tables: Sequence[FreeLengths],
    cycles: int,
    free: tuple[float, float] | Sequence[tuple[float, float]],
    max_coil_load: float = 1.0,
    terrain: Terrain | None = None,
) -> FloatArray:
    """Displacement under prescribed free lengths [body lengths per five cycles], shape (n,); minus infinity
    if the robot fell or folded, or if a coil buckled: then nothing is predicted.

    `free`: cold and hot free length [m], and `terrain`, as `drive` takes them.
    `max_coil_load`: the compression of a coil that counts as buckling, over that at which it buckles; less
    than one is a margin.
    """
    if not robots:
        return np.zeros(0)
    motions = _simulate(robots, tables, _SAMPLE, free, terrain)
    return np.array(
        [_displacement(*one, cycles, max_coil_load) for one in zip(robots, motions, tables, strict=True)]
    )


def displacements_and_ties(
    robots: Sequence[PrintedRobot],
    tables: Sequence[FreeLengths],
    cycles: int,
    free: tuple[float, float] | Sequence[tuple[float, float]],
    terrain: Terrain | None = None,
) -> tuple[FloatArray, FloatArray]:
    """`displacements`, and the share of ties of each robot after its first cycle
    (`tie_share`), shape (n,) each; NaN where the robot fell or folded."""
    if not robots:
        return np.zeros(0), np.zeros(0)
    motions = _simulate(robots, tables, _FINE_SAMPLE, free, terrain)
    walks, ties = np.zeros(len(robots)), np.full(len(robots), np.nan)
    for r, (robot, motion, table) in enumerate(zip(robots, motions, tables, strict=True)):
        part = slice(None, None, _SAMPLE // _FINE_SAMPLE)
        seconds = replace(motion, positions=motion.positions[part], rotations=motion.rotations[part])
        walks[r] = _displacement(robot, seconds, table, cycles)
        if np.isfinite(walks[r]):
            ties[r] = tie_share(robot, motion.positions[table.first_cycle // _FINE_SAMPLE :], terrain)
    return walks, ties


def _simulate(
    robots: Sequence[PrintedRobot],
    tables: Sequence[FreeLengths],
    every: int,
    free: tuple[float, float] | Sequence[tuple[float, float]],
    terrain: Terrain | None,
) -> list[PrintedMotion]:
    lengths, interval = [t.lengths for t in tables], tables[0].interval
    return drive(robots, lengths, interval, every=every, free=free, terrain=terrain)


def _displacement(
    robot: PrintedRobot, motion: PrintedMotion, table: FreeLengths, cycles: int, max_coil_load: float = 1.0
) -> float:
    """`motion` is kept every `_SAMPLE` intervals."""
    if not stays_upright(robot, motion, table.lengths[::_SAMPLE], max_coil_load):
        return -np.inf
    first = table.first_cycle // _SAMPLE
    forward = motion.positions[-1, :, 0].mean() - motion.positions[first, :, 0].mean()
    return float(forward / robot.body_length * CYCLES / cycles)


def stays_upright(
    robot: PrintedRobot, motion: PrintedMotion, lengths: FloatArray, max_coil_load: float = 1.0
) -> bool:
    """Whether a robot stays upright and does not fold until parts touch, and no coil buckles: otherwise
    nothing is predicted. `lengths`: free lengths of its motors at the instants of `motion` [m].
    `max_coil_load` as in `displacements`."""
    if motion.status != OK or np.abs(rotation(robot.positions, motion.positions)).max() > TOPPLED_ANGLE:
        return False
    if (
        min_area_ratio(robot, motion.positions) < FOLDED_AREA_RATIO
        or min_mass_distance(motion.positions) < _TOUCHING
    ):
        return False
    return bool(coil_load(robot, motion, lengths).max(initial=0.0) <= max_coil_load)


def coil_load(robot: PrintedRobot, motion: PrintedMotion, lengths: FloatArray) -> FloatArray:
    """Shortening of each coil over the one at which it buckles, shape (T, A); negative in tension.

    The simulation knows coils as straight springs. One that buckles bows sideways, carries less and touches
    other parts: predictions of such a robot mean nothing. Of a hundred random designs, walkers reach less
    than half of the load; bodies that their motors can hardly move reach several times the load.

    Coils are measured between their hinges. `lengths`: free lengths at the instants of the motion [m], shape
    (T, A).
    """
    a, b = robot.springs[robot.active].T
    between, free = motion.positions[:, a] - motion.positions[:, b], lengths[: len(motion.positions)]
    if robot.joints == "hubs":
        x, y = robot.directions[robot.active].T
        for hubs in (a, b):
            c, s = np.moveaxis(motion.rotations[:, hubs], 2, 0)
            between = between - robot.parameters.socket * np.stack([c * x - s * y, s * x + c * y], axis=2)
    present = np.linalg.norm(between, axis=2) + 2 * robot.parameters.socket
    return (free - present) / robot.coil.buckling_shortening(free)


def rotation(rest: FloatArray, positions: FloatArray) -> FloatArray:
    """Rotation of the body as a whole from its rest pose [rad], shape (T,).

    The rotation that fits best in the least squares' sense (Procrustes), in the plane:
    atan2(sum of cross products, sum of dot products) of the centred positions.
    """
    a = rest - rest.mean(axis=0)
    b = positions - positions.mean(axis=1, keepdims=True)
    cross = (a[:, 0] * b[..., 1] - a[:, 1] * b[..., 0]).sum(axis=1)
    return np.arctan2(cross, (a * b).sum(axis=(1, 2)))


def describe_ties(share: float) -> str:
    """A share of ties in words."""
    words = f"ties: in {share:.0%} of the feet's sliding both outer feet bear about the same load"
    if share > MAX_TIE_SHARE:
        return f"{words}; chance decides which one slips, so this prediction is doubtful"
    return f"{words} (above {MAX_TIE_SHARE:.0%} a prediction is doubtful)"


def describe_doubt(share: float | None) -> str:
    """Ties in words where there are so many that a prediction is doubtful, else nothing; None: not known."""
    return "" if share is None or share <= MAX_TIE_SHARE else describe_ties(share)


def tie_share(robot: PrintedRobot, positions: FloatArray, terrain: Terrain | None = None) -> float:
    """Share of the feet's sliding during which both outer feet bear 45 to 55 per cent of the load; 0 for a
    robot that does not slide.

    Ties are times in which it is open which of a robot's outer feet slips. A robot that pushes its feet apart
    slides on the foot that grips less. Where both outer feet bear about the same load, small differences of
    friction decide. Predictions of such a walk are worth little: where ties take 42 % of the sliding and
    more, another simulation of the same robot differed by 0.14 to 0.35 body lengths, sometimes in sign; where
    they take 25 % or less, by 0.05 (docs/reference/second-physics.md).

    `positions` [m], shape (T, M, 2): a few instants in each second. The loads are those of a body at rest on
    its two outer feet (law of the lever).
    """
    standing = _may_stand(robot, positions, terrain)
    touching = standing[:-1] & standing[1:]
    x = (positions[:-1, :, 0] + positions[1:, :, 0]) / 2
    slid = np.where(touching, np.abs(np.diff(positions[..., 0], axis=0)), 0.0).sum(axis=1)
    rear = np.where(touching, x, np.inf).min(axis=1)
    front = np.where(touching, x, -np.inf).max(axis=1)
    stands = front > rear
    middle = x @ robot.masses / robot.masses.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (middle - rear) / (front - rear)
    tied = stands & (np.abs(share - 0.5) < _EVEN)
    total = slid[stands].sum()
    return float(slid[tied].sum() / total) if total > 0 else 0.0


def _may_stand(robot: PrintedRobot, positions: FloatArray, terrain: Terrain | None) -> BoolArray:
    """Whether each mass may stand on the ground, shape (T, M). Where its rotation is not known, a hub may
    stand on any point of the circle through its corners: on a slope it is then higher than on its lowest
    corner."""
    if terrain is None or robot.joints != "hubs":
        return heights(positions, terrain) < _CONTACT
    arms = [robot.parameters.corner * np.array([np.sin(a), 1 - np.cos(a)]) for a in _CORNER_ANGLES]
    return np.min([heights(positions + arm, terrain) for arm in arms], axis=0) < _CONTACT
