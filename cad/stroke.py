"""How far the motors bend a body, and how near its parts come to each other on the way.

Strips turn freely at the masses, without weight or friction: each pose is the equilibrium of shape-memory
springs with strips that pull like rods and give way at their Euler load. Sockets that hold a strip
beyond their turn, friction and weight make the real motion smaller, so what stays clear here stays
clear on the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import least_squares

from cad.law import StripLaw
from cad.rigidity import rigidity_matrix
from cad.specification import COS_30, Specification
from eldir.built import BuiltParameters
from eldir.frozen import BoolArray, FloatArray, IntArray
from eldir.morphology import Morphology

_STEPS = 3  # poses on the way from rest to each end of the stroke
_COLD, _HOT = BuiltParameters.cold_stiffness, BuiltParameters.hot_stiffness
_ANCHOR = 1.0  # holds what nothing else does [N/m]; a motor is fifty times stiffer


@dataclass(frozen=True, eq=False)
class Stroke:
    """Poses between the ends of the motors' stroke [mm]."""

    rest: FloatArray
    """Shape (M, 2)."""
    poses: FloatArray
    """Shape (P, M, 2)."""


@dataclass(frozen=True)
class Contact:
    """Two parts that come too near."""

    parts: tuple[str, str]
    gap: float
    """Least distance between their surfaces [mm]; below 0 they overlap."""


def stroke(morphology: Morphology, spec: Specification, law: StripLaw) -> Stroke:
    """Every combination of cold and hot motors, with poses on the way there from rest."""
    rest = (morphology.positions - morphology.positions.min(axis=0)) * spec.scale
    poses = []
    for ends in product((0, 1), repeat=morphology.motors):
        pose = rest
        goal = np.array(spec.motor_range)[list(ends)]
        stiffness = np.array([_COLD, _HOT])[list(ends)] * 1e-3  # [N/mm]
        for step in range(1, _STEPS + 1):
            length = spec.pitch + (goal - spec.pitch) * step / _STEPS
            pose = _equilibrium(pose, morphology, spec.pitch, length, stiffness, law)
            poses.append(pose)
    return Stroke(rest, np.array(poses))


def _equilibrium(
    start: FloatArray,
    morphology: Morphology,
    pitch: float,
    lengths: FloatArray,
    stiffness: FloatArray,
    law: StripLaw,
) -> FloatArray:
    """The pose of least energy near `start`; residuals are roots of twice the energies."""
    springs, active = morphology.springs, morphology.active
    natural = np.full(len(springs), pitch)
    natural[active] = lengths
    give = law.buckling / law.tension
    root = np.full(len(springs), np.sqrt(law.tension))
    root[active] = np.sqrt(stiffness)
    anchor = np.sqrt(_ANCHOR * 1e-3)

    def stretch(x: FloatArray) -> FloatArray:
        a, b = x.reshape(-1, 2)[springs.T]
        return np.asarray(np.linalg.norm(a - b, axis=1) - natural)

    def residuals(x: FloatArray) -> FloatArray:
        s = stretch(x)
        bent = np.sqrt(law.tension * np.maximum(give * (2 * np.abs(s) - give), 0))
        pull = np.where(_bends(s, active, give), -bent, root * s)
        return np.concatenate([pull, anchor * (x - start.ravel())])

    def jacobian(x: FloatArray) -> FloatArray:
        s = stretch(x)
        bent = np.sqrt(law.tension * give / np.maximum(2 * np.abs(s) - give, give)) * np.sqrt(give)
        slope = np.where(_bends(s, active, give), bent, root)
        rows = slope[:, None] * rigidity_matrix(x.reshape(-1, 2), springs)
        return np.vstack([rows, anchor * np.eye(len(x))])

    # MINPACK: at this size its plain loops beat a threaded LAPACK on busy cores.
    solution = least_squares(
        residuals, start.ravel(), jac=jacobian, method="lm", xtol=1e-8, ftol=1e-10, max_nfev=200
    )
    return np.asarray(solution.x.reshape(-1, 2))


def _bends(stretch: FloatArray, active: BoolArray, give: float) -> BoolArray:
    return np.asarray((stretch < -give) & ~active)


def shortening(motion: Stroke, morphology: Morphology) -> FloatArray:
    """Greatest shortening of each spring over the poses [mm], shape (S,)."""
    return np.asarray(np.maximum(-_stretches(motion, morphology.springs), 0).max(axis=0))


def foot_stroke(motion: Stroke) -> float:
    """Greatest change of distance between two masses of the lowest row [mm]; 0 for a single foot."""
    low = motion.rest[:, 1] < motion.rest[:, 1].min() + 1e-6
    i, j = np.triu_indices(int(low.sum()), 1)
    if len(i) == 0:
        return 0.0
    return float(np.abs(_stretches(motion, np.flatnonzero(low)[np.stack([i, j], axis=1)])).max())


def nearest_contacts(motion: Stroke, morphology: Morphology, spec: Specification) -> list[Contact]:
    """Pairs of parts nearer than the clearance in any pose, at rest first, the tightest first."""
    springs = morphology.springs
    masses = len(motion.rest)
    corner = spec.mass.across_flats / 2 / COS_30
    half = np.where(morphology.active, spec.coil.outer_diameter / 2, spec.strip.thickness / 2)
    names = [f"mass {i}" for i in range(masses)]
    names += [f"spring {i} ({a}-{b})" for i, (a, b) in enumerate(springs.tolist())]
    # Every part is a segment with a radius: a mass is one of no length.
    ends = np.concatenate([np.repeat(np.arange(masses)[:, None], 2, axis=1), springs])
    radius = np.concatenate([np.full(masses, corner), half])
    i, j = np.triu_indices(len(ends), 1)
    shared = (ends[i][:, :, None] == ends[j][:, None, :]).any(axis=(1, 2))
    linked = {tuple(s) for s in springs.tolist()}
    own = np.array([(a, b) in linked for a, b in zip(i.tolist(), j.tolist(), strict=True)])
    i, j = i[~shared & ~own], j[~shared & ~own]
    gaps = np.full(len(i), np.inf)
    for pose in (motion.rest, *motion.poses):
        apart = _segment_distance(pose[ends[i, 0]], pose[ends[i, 1]], pose[ends[j, 0]], pose[ends[j, 1]])
        gaps = np.minimum(gaps, apart - radius[i] - radius[j])
    tight = np.flatnonzero(gaps < spec.clearance)
    contacts = [Contact((names[i[k]], names[j[k]]), float(gaps[k])) for k in tight[np.argsort(gaps[tight])]]
    return contacts


def _stretches(motion: Stroke, pairs: IntArray) -> FloatArray:
    """Change of distance between pairs of masses in every pose, shape (P, pairs)."""
    a, b = pairs.T
    rest = np.linalg.norm(motion.rest[a] - motion.rest[b], axis=-1)
    return np.asarray(np.linalg.norm(motion.poses[:, a] - motion.poses[:, b], axis=-1) - rest)


def _segment_distance(p: FloatArray, q: FloatArray, r: FloatArray, s: FloatArray) -> FloatArray:
    """Distances between segments pq and rs in the plane, row by row; 0 where they cross."""
    four = [
        _point_distance(p, r, s),
        _point_distance(q, r, s),
        _point_distance(r, p, q),
        _point_distance(s, p, q),
    ]
    distance = np.min(four, axis=0)
    crossing = (_side(p, q, r) * _side(p, q, s) < 0) & (_side(r, s, p) * _side(r, s, q) < 0)
    return np.where(crossing, 0.0, distance)


def _point_distance(point: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    along = b - a
    square = np.maximum((along**2).sum(-1), 1e-12)
    share = np.clip(((point - a) * along).sum(-1) / square, 0, 1)
    return np.asarray(np.linalg.norm(point - a - share[:, None] * along, axis=-1))


def _side(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
