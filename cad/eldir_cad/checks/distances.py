"""Distances between points and segments, in the length unit of their coordinates.

A module of its own, which needs NumPy alone: a rig is driven without the rest of the build filter.
"""

from __future__ import annotations

import numpy as np

from eldir.core.records import FloatArray


def segment_distance(p: FloatArray, q: FloatArray, r: FloatArray, s: FloatArray) -> FloatArray:
    """Distances between segments pq and rs in the plane, row by row; 0 where they cross."""
    end_distances = [
        point_distance(p, r, s),
        point_distance(q, r, s),
        point_distance(r, p, q),
        point_distance(s, p, q),
    ]
    distance = np.min(end_distances, axis=0)
    crossing = (_side(p, q, r) * _side(p, q, s) < 0) & (_side(r, s, p) * _side(r, s, q) < 0)
    return np.where(crossing, 0.0, distance)


def point_distance(point: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distances from points to segments ab, row by row."""
    along = b - a
    square = np.maximum((along**2).sum(-1), 1e-12)
    fraction = np.clip(((point - a) * along).sum(-1) / square, 0, 1)
    return np.asarray(np.linalg.norm(point - a - fraction[:, None] * along, axis=-1))


def _side(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Positive where c lies to the left of the line from a to b."""
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
