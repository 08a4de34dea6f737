"""The marked masses m1 to m5, whose motion is compared between simulation and camera (paper, Fig. Sim2real).

They lie on the rear boundary of the body, where the prototype's motors were.
"""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology

MARKS = 5
_ROUNDING = 9  # decimals [m] below which two distances or heights are the same


def marked_masses(morphology: Morphology) -> IntArray:
    """Mass indices of m1, m2, ... from the ground up, shape (at most five,).

    The five masses of the rear boundary path that are nearest to the active springs; of equally
    near ones, and in a body without motors, the lower. A shorter path gives fewer.
    """
    path = rear_path(morphology)
    distance = _distance_to_motors(morphology, morphology.positions[path])
    nearest = np.argsort(np.round(distance, _ROUNDING), kind="stable")[:MARKS]
    return path[np.sort(nearest)]


def rear_path(morphology: Morphology) -> IntArray:
    """Masses met on the outer face from the rearmost of the lowest row, along the rear (-x), to
    the rearmost of the top row; each once, where it is first met."""
    x, y = np.round(morphology.positions, _ROUNDING).T
    start = int(np.lexsort((x, y))[0])
    end = int(np.lexsort((x, -y))[0])
    around = _neighbours_by_angle(morphology)
    path, here, back = [start], start, -np.pi / 2  # as if come from below, where nothing is
    while here != end:
        here, back = _step(around, morphology.positions, here, back)
        path.append(here)
    return np.array(list(dict.fromkeys(path)), dtype=np.int32)


def _step(
    around: list[list[tuple[float, int]]], positions: FloatArray, here: int, back: float
) -> tuple[int, float]:
    """The next mass, keeping the outside on the left: the first edge clockwise of the way back."""
    full = 2 * np.pi

    def clockwise(edge: tuple[float, int]) -> float:
        turn = (back - edge[0]) % full
        return full if min(turn, full - turn) < 1e-6 else turn  # turning round comes last

    _, to = min(around[here], key=clockwise)
    return to, _angle(positions[here] - positions[to])


def _neighbours_by_angle(morphology: Morphology) -> list[list[tuple[float, int]]]:
    around: list[list[tuple[float, int]]] = [[] for _ in morphology.positions]
    for a, b in morphology.springs.tolist():
        along = morphology.positions[b] - morphology.positions[a]
        around[a].append((_angle(along), b))
        around[b].append((_angle(-along), a))
    return around


def _angle(along: FloatArray) -> float:
    return float(np.arctan2(along[1], along[0]))


def _distance_to_motors(morphology: Morphology, points: FloatArray) -> FloatArray:
    """From each point to the nearest active spring's segment [m], shape (len(points),)."""
    a, b = (morphology.positions[i] for i in morphology.springs[morphology.active].T)
    if len(a) == 0:
        return np.full(len(points), np.inf)
    along = b - a
    reach = points[:, None] - a
    share = np.clip((reach * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(reach - share[..., None] * along, axis=-1).min(axis=1)
