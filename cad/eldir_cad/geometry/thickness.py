"""Thickness of a solid and width of its slots, along rays; and whether its surface intersects itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from eldir.core.records import BoolArray, FloatArray, IntArray

_LEVEL = 0.999  # vertical component of the normal of a level face
_FACING = -0.5  # cosine of the angle between normals, below which two sides form a wall or a slot


def measure_section(contours: Sequence[FloatArray]) -> tuple[float, float]:
    """Thinnest wall and narrowest slot of a plane figure: distances from each side to the opposite side.

    `contours` are closed, shape (n, 2) each, the figure to their left.
    """
    if not contours:
        return np.inf, np.inf
    start = np.concatenate(contours)
    end = np.concatenate([np.roll(c, -1, axis=0) for c in contours])
    length = np.linalg.norm(end - start, axis=1)
    keep = length > 1e-4
    start, end, length = start[keep], end[keep], length[keep]
    along = (end - start) / length[:, None]
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1)  # solid lies to the left
    facing = inward @ inward.T < _FACING
    wall, gap = np.inf, np.inf
    for share in (0.1, 0.5, 0.9):
        origin = start + share * (end - start)
        # Ray from side i along its normal n, side j: origin + t n = start_j + s along_j.
        reach = start[None] - origin[:, None]  # (i, j, 2)
        det = inward[:, None, 0] * along[None, :, 1] - inward[:, None, 1] * along[None, :, 0]
        safe = np.where(np.abs(det) < 1e-9, np.inf, det)
        t = (reach[..., 0] * along[None, :, 1] - reach[..., 1] * along[None, :, 0]) / safe
        s = (reach[..., 0] * inward[:, None, 1] - reach[..., 1] * inward[:, None, 0]) / safe
        hit = facing & (s >= 0) & (s <= length[None]) & np.isfinite(safe)
        wall = min(wall, float(t[hit & (t > 1e-6)].min(initial=np.inf)))
        gap = min(gap, float(-t[hit & (t < -1e-6)].max(initial=-np.inf)))
    return wall, gap


def measure_levels(mesh: trimesh.Trimesh) -> tuple[float, float]:
    """Thinnest floor and lowest slot between level faces: distances upwards from the middle of each face."""
    triangles, up = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)[:, 2]
    level = np.abs(up) > _LEVEL
    flat = triangles[level]
    upper: BoolArray = np.asarray(up[level] > 0)
    origin = flat.mean(axis=1)
    u, v = flat[:, 1, :2] - flat[:, 0, :2], flat[:, 2, :2] - flat[:, 0, :2]
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    # Row: the face that the ray leaves, upwards; column: the face that it meets.
    x = origin[:, None, 0] - flat[None, :, 0, 0]
    y = origin[:, None, 1] - flat[None, :, 0, 1]
    first, second = (x * v[:, 1] - y * v[:, 0]) / det, (u[:, 0] * y - u[:, 1] * x) / det
    rise = flat[None, :, 0, 2] - origin[:, None, 2]
    hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (rise > 1e-6)
    floors, slots = hit & ~upper[:, None] & upper[None], hit & upper[:, None] & ~upper[None]
    return float(rise[floors].min(initial=np.inf)), float(rise[slots].min(initial=np.inf))


def measure_inclined(mesh: trimesh.Trimesh, indices: IntArray) -> tuple[float, float]:
    """Thinnest wall and narrowest slot of a solid, along the normals of the faces with these indices."""
    triangles, normals = np.asarray(mesh.triangles), np.asarray(mesh.face_normals)
    a, u, v = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    wall, gap = np.inf, np.inf
    for i in indices.tolist():
        facing = np.flatnonzero(normals @ normals[i] < _FACING)
        along = -normals[i]
        cross = np.cross(along, v[facing])
        det = (u[facing] * cross).sum(-1)
        from_a = triangles[i].mean(axis=0) - a[facing]
        turned = np.cross(from_a, u[facing])
        first, second = (from_a * cross).sum(-1) / det, turned @ along / det
        t = (v[facing] * turned).sum(-1) / det
        hit = (first >= 0) & (second >= 0) & (first + second <= 1)
        wall = min(wall, float(t[hit & (t > 1e-6)].min(initial=np.inf)))
        gap = min(gap, float(-t[hit & (t < -1e-6)].max(initial=-np.inf)))
    return wall, gap


def self_intersections(mesh: trimesh.Trimesh) -> list[tuple[int, int]]:
    """Pairs of faces without a common corner where an edge of one goes through the other."""
    triangles, faces = np.asarray(mesh.triangles), np.asarray(mesh.faces)
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    order = np.argsort(low[:, 0], kind="stable")
    last = np.searchsorted(low[order, 0], high[order, 0] - 1e-9)
    counts = np.maximum(last - np.arange(len(order)) - 1, 0)
    first = np.repeat(np.arange(len(order)), counts)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    i, j = order[first], order[second]
    overlaps = ((low[i] < high[j] - 1e-9) & (low[j] < high[i] - 1e-9)).all(axis=1)
    i, j = i[overlaps], j[overlaps]
    is_separate = ~(faces[i][:, :, None] == faces[j][:, None, :]).any(axis=(1, 2))
    i, j = i[is_separate], j[is_separate]
    hit = np.zeros(len(i), bool)
    for k in range(3):
        hit |= _pierces(triangles[i][:, k], triangles[i][:, (k + 1) % 3], triangles[j])
        hit |= _pierces(triangles[j][:, k], triangles[j][:, (k + 1) % 3], triangles[i])
    return list(zip(i[hit].tolist(), j[hit].tolist(), strict=True))


def _pierces(p: FloatArray, q: FloatArray, triangle: FloatArray) -> BoolArray:
    """Whether segments pq go through the inside of triangles, row by row (Moeller and Trumbore)."""
    a, u, v = triangle[:, 0], triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    along = q - p
    normal = np.cross(along, v)
    det = (u * normal).sum(-1)
    flat = np.abs(det) < 1e-12
    scale = 1 / np.where(flat, 1.0, det)
    from_a = p - a
    first = (from_a * normal).sum(-1) * scale
    turned = np.cross(from_a, u)
    second = (along * turned).sum(-1) * scale
    t = (v * turned).sum(-1) * scale
    edge = 1e-6
    inside = (first > edge) & (second > edge) & (first + second < 1 - edge)
    return np.asarray(inside & (t > edge) & (t < 1 - edge) & ~flat)
