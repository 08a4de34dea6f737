"""Pictures tracked while they arrive give what tracking the whole film gives, whatever comes first."""

from __future__ import annotations

import numpy as np
import pytest

from eldir.errors import EldirError
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.vision.pipeline import LiveTracker, track_frames
from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import BODY, MARKED, NAMES

Filmed = tuple[VirtualCamera, list[tuple[float, Image]], Plane]
LAYOUT = BODY[MARKED]
START = 1_700_000_000_000_000_000  # [ns]


def stamped(frames: list[tuple[float, Image]]) -> list[tuple[int, Image]]:
    return [(START + round(1e9 * t), image) for t, image in frames]


def test_it_gives_what_tracking_the_whole_film_gives(filmed: Filmed) -> None:
    camera, frames, plane = filmed
    live = LiveTracker(camera.board, None, LAYOUT)
    assert live.plane is None and live.names == NAMES
    pictures = stamped(frames[:25])
    found = [live.update(stamp, image) for stamp, image in pictures]
    assert [len(tracked) for tracked in found] == [0] * (CALIBRATION_FRAMES - 1) + [CALIBRATION_FRAMES] + [
        1
    ] * 15
    flat = [one for tracked in found for one in tracked]
    assert [stamp for stamp, _, _ in flat] == [stamp for stamp, _ in pictures]
    assert all(a is b for (_, _, a), (_, b) in zip(flat, pictures, strict=True))
    np.testing.assert_array_equal(live.plane.homography, plane.homography)  # type: ignore[union-attr]
    whole = track_frames(frames[:25], plane, layout=LAYOUT).trajectory.positions
    np.testing.assert_allclose([places for _, places, _ in flat], whole, atol=1e-9)


def test_pictures_wait_for_the_tags_and_only_the_last_are_kept(filmed: Filmed) -> None:
    camera, frames, _ = filmed
    live = LiveTracker(None, None, None)
    pictures = stamped(frames[:21])
    for stamp, image in pictures[:20]:
        assert live.update(stamp, image) == []
    live.set_board(camera.board)
    found = live.update(*pictures[20])
    assert [stamp for stamp, _, _ in found] == [stamp for stamp, _ in pictures[21 - CALIBRATION_FRAMES :]]
    assert np.isfinite([places for _, places, _ in found]).all()


def test_a_known_board_is_not_replaced(filmed: Filmed) -> None:
    camera, frames, plane = filmed
    live = LiveTracker(camera.board, None, LAYOUT)
    live.set_board(TagBoard.at(camera.board.centres + 0.5, camera.board.side_m))
    for stamp, image in stamped(frames[:CALIBRATION_FRAMES]):
        live.update(stamp, image)
    np.testing.assert_array_equal(live.plane.homography, plane.homography)  # type: ignore[union-attr]


def test_a_given_plane_needs_no_waiting_and_survives_a_reset(filmed: Filmed) -> None:
    _, frames, plane = filmed
    live = LiveTracker(None, plane, LAYOUT[:3])
    assert live.names == NAMES[:3]
    pictures = stamped(frames[:4])
    for _ in range(2):
        for stamp, image in pictures:
            ((at, places, _),) = live.update(stamp, image)
            assert at == stamp and places.shape == (3, 2)
        live.reset(origin_ns=pictures[0][0])
        assert live.plane is plane


def test_after_a_reset_the_plane_comes_from_the_pictures_that_follow(filmed: Filmed) -> None:
    camera, frames, _ = filmed
    live = LiveTracker(camera.board, None, LAYOUT)
    pictures = stamped(frames[:20])
    for stamp, image in pictures[:13]:
        live.update(stamp, image)
    live.reset()
    assert live.plane is None
    assert all(live.update(stamp, image) == [] for stamp, image in pictures[: CALIBRATION_FRAMES - 1])


def test_pictures_that_show_no_tags_are_an_error_and_then_forgotten(filmed: Filmed) -> None:
    camera, frames, _ = filmed
    live = LiveTracker(camera.board, None, LAYOUT)
    dark = np.zeros_like(frames[0][1])
    for i in range(CALIBRATION_FRAMES - 1):
        assert live.update(i, dark) == []
    with pytest.raises(EldirError, match="too few tags"):
        live.update(CALIBRATION_FRAMES, dark)
    pictures = stamped(frames[:CALIBRATION_FRAMES])
    assert [len(live.update(stamp, image)) for stamp, image in pictures][-1] == CALIBRATION_FRAMES
