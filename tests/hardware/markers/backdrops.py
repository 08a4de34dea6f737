"""Coloured tables and cloths behind the robot, before which the virtual camera films."""

from __future__ import annotations

import cv2
import numpy as np

from eldir_hardware.vision.virtual_camera import VirtualCamera

WOODS = {
    "pine": (222, 184, 135),
    "oak": (181, 137, 90),
    "beech": (205, 150, 105),
    "mahogany": (150, 80, 55),
    "walnut": (105, 75, 52),
}
"""sRGB of planed and oiled woods."""

CLOTHS = {
    "blue": (60, 95, 160),
    "green": (80, 130, 85),
    "burgundy": (115, 40, 60),
    "orange": (215, 120, 50),
    "lilac": (150, 120, 180),
}


def before(camera: VirtualCamera, reflectance: np.ndarray) -> VirtualCamera:
    """The same camera, with linear `reflectance` (H, W, 3), BGR, wherever there is no paper of a tag."""
    board = camera.board
    around = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * 0.72 * board.side_m
    paper = camera.coverage(board.centres[:, None] + around, (0, 0), camera.background.shape[:2])[..., None]
    camera.background = (paper * camera.background + (1 - paper) * reflectance).astype(np.float32)
    return camera


def wood(camera: VirtualCamera, name: str, seed: int = 0) -> np.ndarray:
    """Planks with year rings, streaks and knots: linear reflectance, shape (H, W, 3), BGR."""
    rng = np.random.default_rng([seed, 0x300D])
    x, y = np.moveaxis(camera.pixel_positions.astype(np.float32), -1, 0).copy()
    plank = np.floor(y / 0.09)  # planks of 90 mm
    shift = np.sin(plank * 12.9898) * 0.5
    bend, knots = np.zeros_like(x), np.zeros_like(x)
    for _ in range(14):
        dx = x - np.float32(rng.uniform(x.min(), x.max()))
        dy = y - np.float32(rng.uniform(y.min(), y.max()))
        bend += np.exp(-((dx / 0.02) ** 2) - (dy / 0.009) ** 2)
        knots += np.exp(-((dx / 0.006) ** 2) - (dy / 0.005) ** 2)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (y / 0.012 + 0.4 * np.sin(4 * x + 9 * shift) + 1.5 * bend + shift))
    fibres = cv2.GaussianBlur(rng.normal(0, 1, x.shape), (0, 0), sigmaX=12, sigmaY=0.7)
    dark = np.clip(0.35 * rings**2 + 0.8 * fibres + 0.15 * shift + 0.8 * knots, 0, 1)
    gaps = np.abs(y / 0.09 - np.round(y / 0.09)) < 0.008
    light = (np.array(WOODS[name][::-1]) / 255) ** 2.2
    late = light * [0.35, 0.45, 0.6]  # late wood is darker and redder
    colour = light + dark[..., None] * (late - light)
    return np.where(gaps[..., None], 0.3 * colour, colour)


def cloth(camera: VirtualCamera, name: str, seed: int = 0) -> np.ndarray:
    """A plain woven cloth with folds: linear reflectance, shape (H, W, 3), BGR."""
    rng = np.random.default_rng([seed, 0xC107])
    x, y = np.moveaxis(camera.pixel_positions, -1, 0)
    folds = 1 + 0.2 * np.sin(2 * np.pi * (x / 0.21 + 0.3 * np.sin(5 * y)))
    weave = 1 + 0.1 * cv2.GaussianBlur(rng.normal(0, 1, x.shape), (0, 0), 0.8)
    return (np.array(CLOTHS[name][::-1]) / 255) ** 2.2 * (folds * weave)[..., None]
