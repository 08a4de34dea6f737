"""Motions of a body: hinges, mechanisms, and the stroke of its motors.

To first order, the lengths of the springs change by R u, with R the rigidity matrix and u the velocities of
the masses. A body in the plane moves rigidly in three ways; every further motion without a change of length
is a degree of freedom: 2 M - 3 - rank R.

The stroke is how far the motors deform a body. Strips rotate freely at the masses, without weight or
friction. Each pose is the equilibrium of the shape-memory springs with strips that are rods in tension and
buckle at their Euler load. Sockets that limit the rotation, friction and weight make the real motion smaller:
parts that do not touch here do not touch on the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import networkx as nx
import numpy as np
from scipy.optimize import leastsq

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.strip_law import StripLaw, spring_parameters
from eldir_cad.kit.specification import Specification

_RANK_TOLERANCE = 1e-9  # of the largest singular value
AT_REST = "at rest"
"""Label of the pose in which no motor is heated."""
_STEPS = 3  # poses from rest to each end of the stroke
_ANCHOR = 1.0  # stiffness against rigid motions [N/m]; a motor is fifty times stiffer


def rigidity_matrix(positions: FloatArray, springs: IntArray) -> FloatArray:
    """Change of each spring's length per displacement of (x, y) of each mass, shape (S, 2 M)."""
    a, b = springs.T
    along = positions[a] - positions[b]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    matrix = np.zeros((len(springs), len(positions), 2))
    rows = np.arange(len(springs))
    matrix[rows, a], matrix[rows, b] = along, -along
    return matrix.reshape(len(springs), -1)


def degrees_of_freedom(positions: FloatArray, springs: IntArray) -> int:
    """Number of independent motions without change of length, beside the rigid ones, in exactly these
    positions."""
    if len(springs) == 0:
        return 2 * len(positions) - 3
    sizes = np.linalg.svd(rigidity_matrix(positions, springs), compute_uv=False)
    rank = int((sizes > _RANK_TOLERANCE * sizes[0]).sum())
    return 2 * len(positions) - 3 - rank


def find_mechanisms(positions: FloatArray, springs: IntArray) -> FloatArray:
    """One motion for each degree of freedom, orthogonal to the rigid motions, shape (F, M, 2).

    The motions are independent and have the same norm; their sums are motions too.
    """
    x, y = (positions - positions.mean(axis=0)).T
    ones, zeros = np.ones_like(x), np.zeros_like(x)
    size = np.sqrt((x**2 + y**2).mean()) or 1.0
    rigid = [np.stack(pair, axis=1).ravel() for pair in ((ones, zeros), (zeros, ones), (-y / size, x / size))]
    rows = np.vstack([*rigid, rigidity_matrix(positions, springs)])
    _, sizes, motions = np.linalg.svd(rows)
    rank = int((sizes > _RANK_TOLERANCE * sizes[0]).sum())
    return motions[rank:].reshape(-1, len(positions), 2)


@dataclass(frozen=True)
class Hinge:
    """A mass that is the only connection of its neighbouring parts at that place: they share no edge
    there."""

    mass: int
    parts: int
    """Number of groups of triangles around it that share edges."""
    separates: bool
    """Whether the mass alone holds its parts together: without it the body falls apart."""


def find_hinges(morphology: Morphology) -> list[Hinge]:
    """Every mass that joins parts of the body by a vertex alone."""
    body = _graph(morphology)
    cuts = set(nx.articulation_points(body))
    hinges = []
    for mass in sorted(body):
        # Two triangles at a mass share an edge where a neighbour belongs to both. So the groups are the
        # connected components of the neighbours and the springs between them.
        parts = nx.number_connected_components(body.subgraph(body[mass]))
        if parts > 1:
            hinges.append(Hinge(mass, parts, mass in cuts))
    return hinges


def _graph(morphology: Morphology) -> nx.Graph:
    graph = nx.Graph()
    graph.add_nodes_from(range(len(morphology.positions)))
    graph.add_edges_from(morphology.springs.tolist())
    return graph


@dataclass(frozen=True, eq=False)
class Stroke:
    """Poses between the ends of the motors' stroke [mm]."""

    rest: FloatArray
    """Positions at rest [mm], shape (M, 2)."""
    poses: FloatArray
    """Positions in each pose [mm], shape (P, M, 2)."""
    labels: tuple[str, ...]
    """Which motors are cold and which are hot in each pose, as text."""


def simulate_stroke(
    morphology: Morphology,
    spec: Specification,
    law: StripLaw,
    springs: SpringParameters | None = None,
) -> Stroke:
    """Poses for every combination of cold and hot motors, and poses between rest and these.

    `springs`: of the motors; by default those of the specification.
    """
    rest = (morphology.positions - morphology.positions.min(axis=0)) * spec.scale
    coil = RobotParameters.nominal(springs or spring_parameters(spec)).printed
    cold_hot = np.array([coil.cold_stiffness, coil.hot_stiffness]) * 1e-3  # [N/mm]
    poses, labels = [], []
    for ends in product((0, 1), repeat=morphology.motors):
        pose = rest
        goal = np.array(spec.motor_range)[list(ends)]
        stiffness = cold_hot[list(ends)]
        for step in range(1, _STEPS + 1):
            length = spec.pitch + (goal - spec.pitch) * step / _STEPS
            pose = _equilibrium(pose, morphology, spec.pitch, length, stiffness, law)
            poses.append(pose)
            labels.append(_label(ends))
    return Stroke(rest, np.array(poses), tuple(labels))


def _label(ends: tuple[int, ...]) -> str:
    return "with " + ", ".join(f"S{motor} {('cold', 'hot')[hot]}" for motor, hot in enumerate(ends))


def _equilibrium(
    start: FloatArray,
    morphology: Morphology,
    pitch: float,
    lengths: FloatArray,
    stiffness: FloatArray,
    law: StripLaw,
) -> FloatArray:
    """The pose of least energy near `start`; the residuals of the fit are square roots of twice the
    energies."""
    springs, active = morphology.springs, morphology.active
    natural = np.full(len(springs), pitch)
    natural[active] = lengths
    buckling_stroke = law.buckling / law.tension
    root = np.full(len(springs), np.sqrt(law.tension))
    root[active] = np.sqrt(stiffness)
    anchor = np.sqrt(_ANCHOR * 1e-3)

    def stretch(x: FloatArray) -> FloatArray:
        a, b = x.reshape(-1, 2)[springs.T]
        return np.asarray(np.linalg.norm(a - b, axis=1) - natural)

    def residuals(x: FloatArray) -> FloatArray:
        s = stretch(x)
        bent = np.sqrt(law.tension * np.maximum(buckling_stroke * (2 * np.abs(s) - buckling_stroke), 0))
        force = np.where(_is_buckled(s, active, buckling_stroke), -bent, root * s)
        return np.concatenate([force, anchor * (x - start.ravel())])

    def jacobian(x: FloatArray) -> FloatArray:
        s = stretch(x)
        bent = np.sqrt(
            law.tension * buckling_stroke / np.maximum(2 * np.abs(s) - buckling_stroke, buckling_stroke)
        ) * np.sqrt(buckling_stroke)
        gradient = np.where(_is_buckled(s, active, buckling_stroke), bent, root)
        rows = gradient[:, None] * rigidity_matrix(x.reshape(-1, 2), springs)
        return np.vstack([rows, anchor * np.eye(len(x))])

    # MINPACK: for so few unknowns its plain loops are faster than a threaded LAPACK on busy cores. Called
    # directly, because the overhead of `least_squares` takes longer than the residuals.
    pose, _ = leastsq(residuals, start.ravel(), Dfun=jacobian, xtol=1e-8, ftol=1e-10, gtol=1e-8, maxfev=200)
    return np.asarray(pose.reshape(-1, 2))


def _is_buckled(stretch: FloatArray, active: BoolArray, buckling_stroke: float) -> BoolArray:
    return np.asarray((stretch < -buckling_stroke) & ~active)


def max_shortening(motion: Stroke, morphology: Morphology) -> FloatArray:
    """Greatest shortening of each spring over the poses [mm], shape (S,)."""
    return np.asarray(np.maximum(-_elongations(motion, morphology.springs), 0).max(axis=0))


def foot_stroke(motion: Stroke) -> float:
    """Greatest change of distance between two masses of the lowest row [mm]; 0 for a single foot."""
    low = motion.rest[:, 1] < motion.rest[:, 1].min() + 1e-6
    i, j = np.triu_indices(int(low.sum()), 1)
    if len(i) == 0:
        return 0.0
    return float(np.abs(_elongations(motion, np.flatnonzero(low)[np.stack([i, j], axis=1)])).max())


def socket_turns(motion: Stroke, morphology: Morphology) -> FloatArray:
    """Greatest rotation of the springs of each mass in their sockets, in either direction [rad], shape (M,).

    The mass rotates with its springs. So the result is half the difference between the springs that rotate
    most and least.
    """
    a, b = morphology.springs.T
    rest = motion.rest[b] - motion.rest[a]
    along = motion.poses[:, b] - motion.poses[:, a]
    cross = rest[:, 0] * along[..., 1] - rest[:, 1] * along[..., 0]
    rotations = np.arctan2(cross, (rest * along).sum(axis=-1))  # (P, S)
    turns = np.zeros(len(motion.rest))
    for mass in range(len(turns)):
        own = rotations[:, (a == mass) | (b == mass)]
        turns[mass] = np.ptp(own, axis=1).max() / 2
    return turns


def _elongations(motion: Stroke, pairs: IntArray) -> FloatArray:
    """Change of distance between pairs of masses in every pose, shape (P, pairs)."""
    a, b = pairs.T
    rest = np.linalg.norm(motion.rest[a] - motion.rest[b], axis=-1)
    return np.asarray(np.linalg.norm(motion.poses[:, a] - motion.poses[:, b], axis=-1) - rest)
