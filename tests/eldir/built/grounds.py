"""Terrains on which small robots meet many segments at once."""

import numpy as np

from eldir.terrain import Terrain


def polyline(x: np.ndarray, y: np.ndarray) -> Terrain:
    """Level before the first point and after the last."""
    slope = np.append(np.diff(y) / np.diff(x), 0.0)
    first = Terrain(np.append(x[0] - 1.0, x), np.append(0.0, slope), np.append(y[0], y - slope * x))
    return first


def zigzag(seed: int, steepest: float = 0.5) -> Terrain:
    """Segments of 8 to 20 mm from 0.3 m behind the start to 0.6 m before it."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.uniform(0.008, 0.02, 70)) - 0.3
    rises = np.diff(x, append=x[-1]) * rng.uniform(-steepest, steepest, 70)
    return polyline(x, np.cumsum(rises))


def steps(height: float = 0.003, width: float = 0.025, slope: float = 15.0) -> Terrain:
    """Steps up and down by turns, whose faces are nearly upright."""
    edges = np.arange(-0.3, 0.6, width)
    x = np.stack([edges, edges + height / slope], axis=1).ravel()
    y = np.resize([0.0, height, height, 0.0], len(x))
    return polyline(x, y)


def plane(slope: float, intercept: float = 0.0) -> Terrain:
    return Terrain(np.zeros(1), np.array([slope]), np.array([intercept]))
