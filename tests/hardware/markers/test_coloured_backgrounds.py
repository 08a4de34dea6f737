"""Marks before wood and coloured cloth are found; a background of a mark's own colour is named."""

from __future__ import annotations

from functools import cache
from itertools import product

import cv2
import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.images import jpeg
from eldir_hardware.markers.disc import ColourModel
from eldir_hardware.markers.discs import DiscTracker
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.markers.backdrops import CLOTHS, WOODS, before, cloth, wood
from tests.hardware.vision.walking_films import (
    BODY,
    MARKED,
    NAMES,
    SPACE,
    SPRINGS,
    TIMES,
    film,
    rms_mm,
    truth,
    walk,
)
from tests.raised import raises

_FRAMES = TIMES[:32:2]
_BACKGROUNDS = ["grey", *WOODS, "orange", "burgundy", "lilac"]
_IN_BRIEF = {("grey", 0), ("walnut", 0), ("mahogany", 1), ("orange", 1), ("lilac", 0)}
"""Without a colour, the darkest, the two nearest to the colour of a mark, and a cloth."""


@cache
def filmed_before(name: str, seed: int = 0) -> tuple[VirtualCamera, list[tuple[float, Image]], Plane]:
    """A noisy film before wood or cloth, compressed as in a log."""
    camera = VirtualCamera(seed, SPACE, noise=3.0)
    if name != "grey":
        before(camera, (wood if name in WOODS else cloth)(camera, name, seed))
    frames = [(t, jpeg.decode(jpeg.encode(image))) for t, image in film(camera, _FRAMES)]
    return camera, frames, calibrate_plane([image for _, image in frames[:4]], camera.board)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param(*pair, marks=[] if pair in _IN_BRIEF else pytest.mark.stress)
        for pair in product(_BACKGROUNDS, range(2))
    ],
)
def test_marks_are_found_and_measured_before(name: str, seed: int) -> None:
    _, frames, plane = filmed_before(name, seed)
    found = track_frames(frames, plane, layout=BODY[MARKED]).trajectory.positions
    assert np.isfinite(found).mean() > 0.99
    assert rms_mm(found, truth(_FRAMES)) < (0.12 if name == "grey" else 0.25)
    assert np.nanmax(np.linalg.norm(found - truth(_FRAMES), axis=-1)) < 1.2e-3


@pytest.mark.parametrize(
    ("name", "mark"), [("green", "m3"), pytest.param("blue", "m4", marks=pytest.mark.stress)]
)
def test_a_background_of_a_marks_colour_is_named(name: str, mark: str) -> None:
    assert name in CLOTHS
    _, frames, plane = filmed_before(name)
    with pytest.raises(
        InputError,
        match=rf"none like {mark}; the background has the colour of {mark} \(\d\d% of the picture\); "
        r"put a plain grey or white sheet behind .*marker: aruco",
    ):
        track_frames(frames, plane, layout=BODY[MARKED])


def test_a_mark_that_is_missing_before_wood_is_not_blamed_on_the_wood() -> None:
    camera = VirtualCamera(0, SPACE)
    before(camera, wood(camera, "oak"))
    few = [(0.1 * i, camera.render(walk(0.1 * i), SPRINGS, MARKED[:3])) for i in range(3)]
    plane = calibrate_plane([image for _, image in few], camera.board)
    with raises(InputError, "marks.not-seen", match=r"m4, m5; uncover them.*--marks"):
        track_frames(few, plane)


@pytest.mark.parametrize(
    "name", ["mahogany", *(pytest.param(n, marks=pytest.mark.stress) for n in ("oak", "burgundy"))]
)
def test_before_wood_a_covered_mark_is_right_or_missing(name: str) -> None:
    """Fingers, grey cards and pieces of the background itself lie over marks, wholly or in part."""
    camera, frames, plane = filmed_before(name, 1)
    lens = camera.plane
    tracker = DiscTracker(plane, NAMES, BODY[MARKED])
    rng = np.random.default_rng(1)
    missing = 0
    for i, (t, whole) in enumerate(frames):
        image, body = whole.copy(), walk(t)
        if i > 0:
            x, y = np.round(lens.to_pixels(body[rng.integers(5)] + rng.normal(0, 0.008, 2))).astype(int)
            if i % 3 == 0:
                turn = float(rng.uniform(0, 180))
                cv2.ellipse(image, (int(x), int(y)), (18, 9), turn, 0, 360, (110, 140, 200), -1, cv2.LINE_AA)
            elif i % 3 == 1:
                image[y - 10 : y + 9, x - 10 : x + 9] = 90
            else:
                image[y - 8 : y + 9, x - 8 : x + 9] = whole[20:37, 300:317]
        found = tracker.update(image, t)
        error = np.linalg.norm(found - body[MARKED], axis=1)
        missing += int(np.isnan(error).sum())
        assert (error[np.isfinite(error)] < 1.5e-3).all()
    assert 5 < missing < 27  # about one in each frame is covered
    for t in (3.1, 3.2, 3.3):
        bare = jpeg.decode(jpeg.encode(camera.render(walk(t), SPRINGS, MARKED[:0])))
        assert np.isnan(tracker.update(bare, t)).all()


def test_the_neutral_is_the_papers_and_the_wood_is_a_surface() -> None:
    """In a bluish light, saturated pixels left out."""
    camera = VirtualCamera(0, SPACE)
    before(camera, wood(camera, "oak"))
    cast = np.array([1.25, 1.0, 0.8])
    image = np.clip(camera.render(walk(0), SPRINGS, MARKED) * cast, 0, 255).astype(np.uint8)
    plane = calibrate_plane([image], camera.board)
    tracker = DiscTracker(plane, NAMES)
    learned = ColourModel.learn(image, tracker.paper)
    sheet = VirtualCamera(0, SPACE, noise=0.0)
    sheet.background = np.full_like(sheet.background, 0.5)
    light = sheet.render(BODY[:0], SPRINGS[:0], MARKED[:0]).mean(axis=(0, 1)) * cast
    np.testing.assert_allclose(learned.neutral, light / np.linalg.norm(light), atol=0.02)
    assert learned.shares.sum() > 0.5
    assert (
        float(np.median(learned.chroma_contrast(image)))
        < 10
        < float(np.median(learned.chroma_magnitude(image)))
    )
    guessed = ColourModel.learn(image)
    assert np.abs(guessed.neutral - learned.neutral).max() > 0.1  # the median is that of the wood
