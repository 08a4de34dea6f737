"""The largest stable step of a robot in the learning scenes, and how larger steps are divided.

Small motions about rest, M x'' = -K x - c x', grow by the roots of z^2 - (1 + e - dt h lambda) z + e in a
step, for every eigenvalue lambda of M^-1 K, e = exp(-c dt), and forces acting for h, which is dt or, in the
second-order scheme, (1 - e) / c. Both stay within the unit circle while dt h lambda < 2 (1 + e) (Jury's
criterion).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.core.records import BoolArray, FloatArray, IntArray
from eldir.errors import EldirError
from eldir.morphology import Bodies, Morphology
from eldir.physics import Physics, resolve_physics
from eldir.scene import SOFTENING, Scene

_SAFETY = 0.95  # of the largest stable step, where steps are divided: motors stiffen a spring a little


def stable_step(morphology: Morphology, scene: Scene, physics: Physics | None = None) -> float:
    """The largest stable step about the body's rest, its motors at rest [s]; infinite without stiffness."""
    own = physics if physics is not None else Physics.of(morphology, scene)
    return _stable_step_at(largest_eigenvalue(morphology, own), scene, own.damping)


def is_stable(
    morphologies: Sequence[Morphology], scene: Scene, physics: Sequence[Physics] | None = None
) -> BoolArray:
    """Whether the scene's step is stable for each robot, shape (n,).

    A bound decides for nearly all robots: x K x <= 2 sum_i x_i D_i x_i, with D_i the sum of the 2 x 2
    stiffnesses of the springs of mass i. On the lattice it is at most 6 k; whole robots have 5.5 k.
    """
    owns = physics if physics is not None else resolve_physics(morphologies, scene, None)
    schemes = {own.damping: scene.scheme_at(own.damping) for own in owns}
    limits = {c: 2 * (1 + scheme.decay) / (scene.dt * scheme.force) for c, scheme in schemes.items()}
    largest = np.array([limits[own.damping] for own in owns])
    below = eigenvalue_bounds(Bodies(morphologies), owns) < largest if morphologies else np.zeros(0, bool)
    for i in np.flatnonzero(~below).tolist():
        below[i] = largest_eigenvalue(morphologies[i], owns[i]) < largest[i]
    return below


def substeps(
    morphologies: Sequence[Morphology], scene: Scene, physics: Sequence[Physics] | None = None
) -> IntArray:
    """Number of parts into which each robot's steps are divided, shape (n,); 0 for a refused robot.

    Raises `EldirError` if no robot remains, because then the scene is wrong and not a robot.
    """
    if scene.large_step == "run":
        return np.ones(len(morphologies), int)
    owns = physics if physics is not None else resolve_physics(morphologies, scene, None)
    counts = is_stable(morphologies, scene, owns).astype(int)
    if scene.large_step == "subdivide":
        for i in np.flatnonzero(counts == 0).tolist():
            counts[i] = int(np.ceil(scene.dt / (_SAFETY * stable_step(morphologies[i], scene, owns[i]))))
    if len(counts) and not counts.any():
        largest = max(stable_step(m, scene, own) for m, own in zip(morphologies, owns, strict=True))
        raise EldirError(
            "the step is too large for " + ("every robot" if len(counts) > 1 else "this robot"),
            code="scene.large-step",
            expected=f"Scene.dt at most {_round_down_ms(largest)} ms",
            found=f"{scene.dt * 1e3:.4g} ms",
            remedy="reduce Scene.dt, or set Scene.large_step to 'subdivide'",
        )
    return counts


def subdivide_steps(scene: Scene, parts: int) -> Scene:
    """The same time in shorter steps; the states of every `parts`-th step are those of the scene."""
    if parts == 1:
        return scene
    window = None if scene.window is None else scene.window * parts
    return scene.replace(dt=scene.dt / parts, steps=scene.steps * parts, window=window)


def _round_down_ms(seconds: float) -> str:
    """Milliseconds with four digits, rounded down, so that the step is accepted."""
    ms = seconds * 1e3
    unit = 10.0 ** (np.floor(np.log10(ms)) - 3)
    return f"{np.floor(ms / unit) * unit:.4g}"


def _stable_step_at(eigenvalue: float, scene: Scene, damping: float) -> float:
    from scipy.optimize import brentq  # a fifth of a second, for few robots

    if eigenvalue <= 0:
        return np.inf

    def excess(dt: float) -> float:
        scheme = replace(scene, dt=dt).scheme_at(damping)
        return dt * scheme.force * eigenvalue - 2 * (1 + scheme.decay)

    undamped = 2 / np.sqrt(eigenvalue)
    return float(brentq(excess, 0.1 * undamped, 1e6 * undamped, xtol=1e-9 * undamped))


def _stiffness_matrices(bodies: Bodies, physics: Sequence[Physics], least: float) -> FloatArray:
    """Second derivatives of every spring's energy in x and y of xa - xb, about rest: xx, xy, yy [N/m], shape
    (3, S). Along the spring and across it they are at least `least`.

    Along the spring k (1 - L / l + r L / l^2), across k (1 - L / l): l = r + softening is the length that
    the engine computes with, L the rest length.
    """
    a, b = bodies.springs.T
    positions = bodies["positions"]
    stiffness, rest_lengths = (
        np.concatenate([getattr(own, key) for own in physics]) for key in ("stiffness", "rest_lengths")
    )
    d = positions[a] - positions[b]
    distance = np.linalg.norm(d, axis=1)
    length = distance + SOFTENING
    ratio = rest_lengths / length
    nx, ny = np.divide(d, distance[:, None], out=np.zeros_like(d), where=distance[:, None] > 0).T
    across = stiffness * (1 - ratio)
    along = across + stiffness * ratio * distance / length
    directions = np.stack([nx * nx, nx * ny, ny * ny])
    sideways = np.array([[1.0], [0.0], [1.0]]) - directions
    return np.maximum(along, least) * directions + np.maximum(across, least) * sideways


def largest_eigenvalue(body: Morphology, own: Physics) -> float:
    """Largest eigenvalue of the stiffness matrix over 1 kg [1/s2]. By Lanczos' method, because LAPACK's
    threads slow each other down on a busy machine and take seconds."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import eigsh

    springs = _stiffness_matrices(Bodies([body]), [own], -np.inf)
    m, (a, b) = len(body.positions), body.springs.T
    blocks = [
        (2 * i + row, 2 * j + column, sign * values)
        for i, j, sign in ((a, a, 1), (b, b, 1), (a, b, -1), (b, a, -1))
        for row, column, values in zip((0, 0, 1, 1), (0, 1, 0, 1), springs[[0, 1, 1, 2]], strict=True)
    ]
    rows, columns, values = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    matrix = coo_array((values, (rows, columns)), shape=(2 * m, 2 * m)).tocsr()
    start = np.random.default_rng(0).standard_normal(2 * m)
    return float(eigsh(matrix, 1, which="LA", v0=start, tol=1e-8, return_eigenvectors=False)[0])


def eigenvalue_bounds(bodies: Bodies, physics: Sequence[Physics]) -> FloatArray:
    """An upper bound of each body's eigenvalues [1/s2], shape (n,): without negative stiffness."""
    ends, m = bodies.springs.ravel(), bodies.mass_at[-1]
    springs = _stiffness_matrices(bodies, physics, 0.0)
    xx, xy, yy = (np.bincount(ends, np.repeat(values, 2), minlength=m) for values in springs)
    return np.maximum.reduceat(xx + yy + np.hypot(xx - yy, 2 * xy), bodies.mass_at[:-1])
