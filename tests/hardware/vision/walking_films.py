"""A body that walks before the virtual camera, and films of it."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from eldir_hardware.camera.plane import FieldOfView, Plane
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.markers.registration import PALETTE
from eldir_hardware.vision.virtual_camera import VirtualCamera

NAMES = tuple(PALETTE)

# A rear edge of five masses that carry the marks, and five more columns of body before it.
_ROWS = np.arange(5)
BODY = np.concatenate(
    [np.stack([0.05 * c + 0.025 * (_ROWS % 2), 0.014 + 0.0433 * _ROWS], axis=1) for c in range(6)]
)
SPRINGS = np.array([(i, j) for j in range(30) for i in range(j) if np.hypot(*(BODY[i] - BODY[j])) < 0.06])
MARKED = np.arange(5)
SPACE = FieldOfView.around(BODY)
TIMES = np.arange(0, 6, 0.1)


def walk(t: float) -> np.ndarray:
    """The body at time t [m]: it travels, stretches, lifts and turns."""
    angle = 0.12 * np.sin(0.7 * t)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    stretched = BODY * [1 + 0.1 * np.sin(1.3 * t), 1 + 0.05 * np.sin(2 * t)]
    return stretched @ turn.T + [0.02 * t, 0.02]


def film(camera: VirtualCamera, times: np.ndarray = TIMES, motion=walk) -> list[tuple[float, np.ndarray]]:
    return [(t, camera.render(motion(t), SPRINGS, MARKED)) for t in times.tolist()]


def truth(times: np.ndarray = TIMES, motion=walk) -> np.ndarray:
    return np.array([motion(t)[MARKED] for t in times])


def rms_mm(found: np.ndarray, true: np.ndarray) -> float:
    return float(1e3 * np.sqrt(np.nanmean(((found - true) ** 2).sum(axis=-1))))


def cover(image: np.ndarray, camera: VirtualCamera, place: np.ndarray, width: float = 0.03) -> None:
    """Hold a grey card before a place in the picture."""
    x, y = np.round(camera.plane.to_pixels(place)).astype(int)
    half = round(width / 2 * camera.plane.pixels_per_metre(place))
    image[y - half : y + half + 1, x - half : x + half + 1] = 90


def without_tags(image: np.ndarray, camera: VirtualCamera) -> np.ndarray:
    """The picture where somebody took the reference tags away: the wall is grey there."""
    bare = image.copy()
    for corners in camera.plane.to_pixels(camera.board.corners):
        (left, top), (right, bottom) = (
            corners.min(axis=0).astype(int) - 8,
            corners.max(axis=0).astype(int) + 9,
        )
        bare[max(top, 0) : bottom, max(left, 0) : right] = 90
    return bare


Filmed = tuple[VirtualCamera, list[tuple[float, np.ndarray]], Plane]


@pytest.fixture(scope="session")
def first_film() -> Filmed:
    """The film that all modules look at; nobody writes into its pictures."""
    camera = VirtualCamera(7, SPACE)
    frames = film(camera)
    for _, image in frames:
        image.flags.writeable = False
    return camera, frames, calibrate_plane([image for _, image in frames[:10]], camera.board)


@pytest.fixture(scope="module")
def filmed(first_film: Filmed) -> Filmed:
    """The film, and a camera that goes on as if it had just taken it."""
    camera, frames, plane = first_film
    return copy.deepcopy(camera), list(frames), plane


@pytest.fixture(scope="session")
def recordings(first_film: Filmed, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same 20 frames as video, folder and log, and the tags' places."""
    camera, frames, _ = first_film
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "tags.json").write_text(json.dumps(camera.board.to_json()))
    video = cv2.VideoWriter(str(folder / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    (folder / "pictures").mkdir()
    with Recorder(folder / "walk.mcap") as log:
        log.attach("tags.json", (folder / "tags.json").read_bytes())
        for i, (t, image) in enumerate(frames[:20]):
            video.write(image)
            cv2.imwrite(str(folder / "pictures" / f"frame{i}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
            log.on_frame(t, image)
    video.release()
    return folder
