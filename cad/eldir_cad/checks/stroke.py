"""The stroke: how far the motors deform a body.

Strips rotate freely at the masses, without weight or friction. Each pose is the equilibrium of the
shape-memory springs with strips that are rods in tension and buckle at their Euler load. Sockets that limit
the rotation, friction and weight make the real motion smaller: parts that do not touch here do not touch on
the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import leastsq

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir_cad.checks.rigidity import rigidity_matrix
from eldir_cad.checks.strip_law import StripLaw
from eldir_cad.kit.specification import Specification

AT_REST = "at rest"
_STEPS = 3  # poses on the way from rest to each end of the stroke
_COLD, _HOT = BuiltParameters.cold_stiffness, BuiltParameters.hot_stiffness
_ANCHOR = 1.0  # holds what nothing else does [N/m]; a motor is fifty times stiffer


@dataclass(frozen=True, eq=False)
class Stroke:
    """Poses between the ends of the motors' stroke [mm]."""

    rest: FloatArray
    """Positions at rest [mm], shape (M, 2)."""
    poses: FloatArray
    """Positions in each pose [mm], shape (P, M, 2)."""
    labels: tuple[str, ...]
    """The hot motors of each pose, as a text."""


def stroke(morphology: Morphology, spec: Specification, law: StripLaw) -> Stroke:
    """Poses for every combination of cold and hot motors, and poses between rest and these."""
    rest = (morphology.positions - morphology.positions.min(axis=0)) * spec.scale
    poses, labels = [], []
    for ends in product((0, 1), repeat=morphology.motors):
        pose = rest
        goal = np.array(spec.motor_range)[list(ends)]
        stiffness = np.array([_COLD, _HOT])[list(ends)] * 1e-3  # [N/mm]
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

    # MINPACK: at this size its plain loops beat a threaded LAPACK on busy cores. Called directly: what
    # `least_squares` does around each residual takes longer than the residual.
    found, _ = leastsq(residuals, start.ravel(), Dfun=jacobian, xtol=1e-8, ftol=1e-10, gtol=1e-8, maxfev=200)
    return np.asarray(found.reshape(-1, 2))


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


def socket_turns(motion: Stroke, morphology: Morphology) -> FloatArray:
    """Greatest rotation of the springs of each mass in their sockets, in either direction [rad], shape (M,).

    The mass rotates with its springs. So the result is half the difference between the springs that rotate
    most and least.
    """
    a, b = morphology.springs.T
    rest = motion.rest[b] - motion.rest[a]
    along = motion.poses[:, b] - motion.poses[:, a]
    cross = rest[:, 0] * along[..., 1] - rest[:, 1] * along[..., 0]
    turned = np.arctan2(cross, (rest * along).sum(axis=-1))  # (P, S)
    found = np.zeros(len(motion.rest))
    for mass in range(len(found)):
        own = turned[:, (a == mass) | (b == mass)]
        found[mass] = np.ptp(own, axis=1).max() / 2
    return found


def _stretches(motion: Stroke, pairs: IntArray) -> FloatArray:
    """Change of distance between pairs of masses in every pose, shape (P, pairs)."""
    a, b = pairs.T
    rest = np.linalg.norm(motion.rest[a] - motion.rest[b], axis=-1)
    return np.asarray(np.linalg.norm(motion.poses[:, a] - motion.poses[:, b], axis=-1) - rest)
