"""What else stands before the camera: second robots, caps of bottles, a table that reflects, lamps."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from eldir_hardware.camera.plane import Image
from eldir_hardware.markers.registration import PALETTE, nominal_bgr
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import BODY, MARKED, SPACE, SPRINGS, cover, film, walk


def shifted(x: float, y: float, body: np.ndarray = BODY) -> np.ndarray:
    """A body moved by so much [m]."""
    return body + np.array([x, y])


def park(
    camera: VirtualCamera, body: np.ndarray, marked: np.ndarray = MARKED, names: tuple[str, ...] = ()
) -> VirtualCamera:
    """A second robot that stands still: masses at `body` (M, 2) [m], discs on the masses `marked`."""
    camera.paint_body(camera.background, (0, 0), body, SPRINGS)
    for name, mass in zip(names or PALETTE, marked, strict=False):
        camera.paint_marker(camera.background, (0, 0), body[mass], name)
    camera.background = camera.background  # develops it
    return camera


def add_cap(camera: VirtualCamera, name: str, place: np.ndarray, diameter: float = 0.0105) -> VirtualCamera:
    """The cap of a bottle with the colour of a marker, `diameter` [m] wide."""
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    circle = np.asarray(place) + diameter / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cover = camera.coverage(circle[None], (0, 0), camera.background.shape[:2])[..., None]
    ink = ((nominal_bgr(name) / 255) ** 2.2).astype(np.float32)
    camera.background += cover * (ink - camera.background)
    return camera


def reflect(camera: VirtualCamera, image: Image, share: float) -> Image:
    """The picture before a table that reflects this share of the light."""
    mirrored = camera.plane.to_pixels(camera.pixel_positions * [1, -1]).astype(np.float32)
    seen = cv2.remap(image, mirrored, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    table = (camera.pixel_positions[..., 1] < 0)[..., None]
    return np.where(table, (1 - share) * image + share * seen, image).round().astype(np.uint8)


def lamp(image: Image, place: tuple[float, float], strength: float, colour: tuple[float, ...]) -> Image:
    """The picture with light of a colour (BGR, relative) around a place in parts of the picture; strong
    lamps saturate."""
    height, width = image.shape[:2]
    x, y = np.meshgrid(np.arange(width) / width, np.arange(height) / width)
    glow = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / 0.02)[..., None]
    return np.clip(image * (1 + strength * glow * np.array(colour)), 0, 255).round().astype(np.uint8)


class DisturbedFilm(NamedTuple):
    """A film with random things in it."""

    words: str
    """What is in it."""
    camera: VirtualCamera
    frames: list[tuple[float, Image]]
    truth: np.ndarray
    """Where the marks are, shape (T, K, 2) [m]."""
    alike: bool
    """Whether a robot is in it that cannot be told from ours."""


def disturbed_film(seed: int, count: int = 16) -> DisturbedFilm:
    """Random caps, second robots, reflection, lamps, light that changes, and cards that cover marks."""
    rng = np.random.default_rng([seed, 0xD157])
    camera = VirtualCamera(1000 + seed, SPACE, noise=rng.uniform(1, 4))
    words, alike = [], False
    for _ in range(rng.integers(0, 4)):
        name = str(rng.choice(list(PALETTE)))
        place = np.array([rng.uniform(SPACE.min_x, SPACE.max_x), rng.uniform(0.01, SPACE.height)])
        add_cap(camera, name, place, width := rng.uniform(0.008, 0.014))
        words.append(f"cap {name} {1e3 * width:.0f} mm at {place.round(3).tolist()}")
    if rng.random() < 0.2:
        side = rng.choice([-1, 1])
        park(camera, shifted(side * rng.uniform(0.25, 0.35), rng.uniform(0, 0.01)))
        words.append("a robot alike")
        alike = True
    elif rng.random() < 0.4:
        other = shifted(rng.uniform(-0.1, 0.55), 0, BODY * rng.uniform(0.8, 1.2, 2) * (-1, 1))
        marked = rng.choice(len(BODY), rng.integers(1, 6), replace=False)
        park(camera, other, marked, tuple(rng.choice(list(PALETTE), len(marked), replace=False).tolist()))
        words.append(f"another robot with {len(marked)} marks")
    start, covered = rng.uniform(0, 6), rng.random() < 0.5
    times = 0.15 * np.arange(count)
    share = rng.choice([0, 0, rng.uniform(0.1, 0.4)])
    lamps = [
        (rng.uniform(0, 1, 2), rng.uniform(0.2, 1.2), rng.uniform(0.5, 1, 3))
        for _ in range(rng.integers(0, 3))
    ]
    dim = rng.uniform(0.5, 1.0)
    words += [f"reflection {share:.2f}", f"{len(lamps)} lamps", f"light {dim:.2f}", f"covered {covered}"]
    truth = np.array([walk(t + start)[MARKED] for t in times])
    frames = film(camera, times, lambda t: walk(t + start))
    for i, (_, image) in enumerate(frames):
        if covered and (i % 5 > 2 or i == 0):
            for mass in rng.choice(5, rng.integers(1, 6), replace=False):
                cover(image, camera, truth[i, mass] + rng.normal(0, 0.006, 2), rng.uniform(0.012, 0.04))
        seen = image if not share else reflect(camera, image, share)
        for place, strength, colour in lamps[: 1 if i < count // 2 else None]:  # the second is switched on
            seen = lamp(seen, place, strength, colour)
        frames[i] = (times[i], np.clip(dim * seen.astype(float), 0, 255).astype(np.uint8))
    return DisturbedFilm("; ".join(words), camera, frames, truth, alike)
