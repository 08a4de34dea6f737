"""A camera whose lens is known: corners and photographs of a printed pattern that it sees."""

from __future__ import annotations

import cv2
import numpy as np

from eldir_hardware.camera.plane import Image
from eldir_hardware.camera.views import Pattern, View, Views

SIZE = (640, 480)
MATRIX = np.array([[610.0, 0, 326], [0, 612, 233], [0, 0, 1]])
DISTORTION = np.array([-0.22, 0.08, 0.001, -0.0005, 0.0])
PATTERN = Pattern()
# Where the pattern's middle appears [share of the picture], its turns [degrees], its distance [m].
_PLACES = [(0.25, 0.3), (0.5, 0.3), (0.75, 0.3), (0.25, 0.7), (0.5, 0.7), (0.75, 0.7)] * 2
_TURNS = [(25, 0), (-25, 5), (0, 30), (0, -30), (20, 20), (-20, 20)]
_TURNS += [(5, -25), (-25, 15), (30, 5), (0, 0), (20, -20), (-10, 10)]
_FAR = [0.35, 0.42, 0.5] * 4
POSES = [(*place, *turn, z) for place, turn, z in zip(_PLACES, _TURNS, _FAR, strict=True)]


def pose(x: float, y: float, a: float, b: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    turn, _ = cv2.Rodrigues(np.radians([a, b, 3.0]))
    ray = np.linalg.inv(MATRIX) @ [x * SIZE[0], y * SIZE[1], 1]
    middle = np.array([PATTERN.columns, PATTERN.rows, 0]) * PATTERN.square / 2
    return turn, z * ray - turn @ middle


def views(
    poses: list[tuple[float, ...]] = POSES,
    noise: float = 0.1,
    distortion: np.ndarray = DISTORTION,
    seed: int = 1,
) -> Views:
    """Corners projected by OpenCV, with noise."""
    rng = np.random.default_rng(seed)
    points = PATTERN.board.getChessboardCorners().astype(np.float64)
    found = []
    for i, p in enumerate(poses):
        turn, shift = pose(*p)
        pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], shift, MATRIX, distortion)
        pixels = pixels[:, 0] + rng.normal(0, noise, (len(points), 2))
        inside = ((pixels > 0) & (pixels < np.array(SIZE) - 1)).all(axis=1)
        found.append(View(f"view{i}.png", points[inside], pixels[inside]))
    return Views(SIZE, found, [], 0)


def photographs(poses: list[tuple[float, ...]] = POSES) -> list[tuple[str, Image]]:
    """What the camera sees of the printed sheet: each pixel traced back to it."""
    step = 56
    board = PATTERN.board.generateImage((PATTERN.columns * step, PATTERN.rows * step), marginSize=0)
    board = cv2.copyMakeBorder(board, step, step, step, step, cv2.BORDER_CONSTANT, value=255)
    x, y = np.meshgrid(*(np.arange(n) for n in SIZE))
    seen_rays = (np.stack([x.ravel(), y.ravel()], axis=1) - MATRIX[:2, 2]) / np.diag(MATRIX)[:2]
    rays = seen_rays.copy()
    k1, k2, p1, p2, _ = DISTORTION
    for _ in range(12):  # the inverse of the lens, by iteration
        u, v = rays.T
        q = u * u + v * v
        shift = np.stack(
            [2 * p1 * u * v + p2 * (q + 2 * u * u), p1 * (q + 2 * v * v) + 2 * p2 * u * v], axis=1
        )
        rays = (seen_rays - shift) / (1 + q * (k1 + q * k2))[:, None]
    pictures = []
    rng = np.random.default_rng(2)
    for i, p in enumerate(poses):
        turn, shift = pose(*p)
        to_board = np.linalg.inv(np.column_stack([turn[:, :2], shift]))
        on = np.column_stack([rays, np.ones(len(rays))]) @ to_board.T
        at = (on[:, :2] / on[:, 2:] / PATTERN.square + 1) * step - 0.5
        seen = cv2.remap(
            board, at.reshape(*x.shape, 2).astype(np.float32), None, cv2.INTER_LINEAR, borderValue=128
        )
        small = cv2.GaussianBlur(seen, (0, 0), 0.8)
        noisy = np.clip(30 + 0.75 * small + rng.normal(0, 2, small.shape), 0, 255).astype(np.uint8)
        pictures.append((f"view{i}.png", cv2.cvtColor(noisy, cv2.COLOR_GRAY2BGR)))
    return pictures
