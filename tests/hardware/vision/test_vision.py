"""Eyes: discs to a part of a pixel, and tracks against the virtual camera's truth."""

from __future__ import annotations

import ast
import itertools
from pathlib import Path

import cv2
import numpy as np
import pytest

import eldir_hardware.vision
from eldir.errors import InputError
from eldir_hardware.camera.plane import TagBoard
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.images import jpeg
from eldir_hardware.markers.disc import ColourModel, measure_disc
from eldir_hardware.markers.discs import DiscTracker
from eldir_hardware.markers.registration import DISC_DIAMETER, PALETTE
from eldir_hardware.vision import pipeline
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import (
    BODY,
    MARKED,
    NAMES,
    SPACE,
    SPRINGS,
    TIMES,
    cover,
    film,
    rms_mm,
    truth,
    walk,
)
from tests.raised import raises

# Discs


def test_a_circles_centroid_is_its_centre_within_a_fiftieth_of_a_millimetre() -> None:
    """Perspective moves the centroid of a projected circle off its centre: how much, exactly."""
    from eldir_hardware.vision.virtual_camera import sample_pose

    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for seed in range(10):
        _, lens = sample_pose(np.random.default_rng(seed), TagBoard.around(SPACE), (640, 480))
        for place in np.array([(SPACE.min_x, 0), (SPACE.max_x, SPACE.height)]):
            ring = place + DISC_DIAMETER / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            x, y = lens.to_pixels(ring).T
            cross = x * np.roll(y, -1) - y * np.roll(x, -1)
            area = cross.sum() / 2
            centroid = np.array([((v + np.roll(v, -1)) * cross).sum() for v in (x, y)]) / (6 * area)
            assert np.linalg.norm(lens.to_metres(centroid) - place) < 2e-5


def test_rendered_discs_are_where_the_lens_projects_them() -> None:
    camera = VirtualCamera(5, SPACE, noise=0.0)
    lens = camera.plane
    colour = ColourModel.learn(camera.render(walk(0), SPRINGS, MARKED))
    for t in np.linspace(0, 5, 10):
        body = walk(t)
        image = camera.render(body, SPRINGS, MARKED)
        for mass in MARKED:
            true = lens.to_pixels(body[mass])
            disc = measure_disc(
                image, colour, true + 1.0, DISC_DIAMETER / 2 * lens.pixels_per_metre(body[mass])
            )
            assert disc is not None
            assert np.linalg.norm(disc.centre - true) < 0.04  # of which rounding to 8 bits is a part


def test_same_seed_same_frames_and_others_differ() -> None:
    first, second = (VirtualCamera(4, SPACE).render(BODY, SPRINGS, MARKED) for _ in range(2))
    assert first.dtype == np.uint8 and first.shape == (480, 640, 3)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, VirtualCamera(5, SPACE).render(BODY, SPRINGS, MARKED))


# Tracks


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.stress) for s in (1, 2))])
def test_tracks_agree_with_the_truth(seed: int) -> None:
    camera = VirtualCamera(seed, SPACE)
    times = TIMES[:40:2]
    frames = film(camera, times)
    plane = calibrate_plane([f for _, f in frames[:4]], camera.board)
    found = track_frames(frames, plane, layout=BODY[MARKED]).trajectory
    assert np.isfinite(found.positions).all()
    assert rms_mm(found.positions, truth(times)) < 0.1
    lens = camera.plane
    off = lens.to_pixels(found.positions) - lens.to_pixels(truth(times))
    assert np.sqrt((off**2).sum(axis=-1).mean()) < 0.05


def test_tracks_from_the_logs_jpeg_agree_with_the_truth(filmed) -> None:
    camera, frames, _ = filmed
    packed = [(t, jpeg.encode(image)) for t, image in frames[::3]]
    assert np.mean([len(data) for _, data in packed]) < 20_000
    images = [(t, jpeg.decode(data)) for t, data in packed]
    plane = calibrate_plane([image for _, image in images[:4]], camera.board)
    found = track_frames(images, plane, layout=BODY[MARKED]).trajectory
    assert np.isfinite(found.positions).all()
    assert rms_mm(found.positions, truth(TIMES[::3])) < 0.1


def test_noise_light_and_blur_of_a_poor_camera() -> None:
    camera = VirtualCamera(11, SPACE, noise=6.0)
    times = TIMES[::3]
    frames = [(t, cv2.GaussianBlur(image, (0, 0), 0.9)) for t, image in film(camera, times)]
    plane = calibrate_plane([f for _, f in frames[:4]], camera.board)
    found = track_frames(frames, plane, layout=BODY[MARKED]).trajectory
    assert np.isfinite(found.positions).mean() > 0.99
    assert rms_mm(found.positions, truth(times)) < 0.2


def test_what_is_covered_is_nan_and_found_again(filmed) -> None:
    camera, frames, plane = filmed
    hidden = []
    for i, (t, whole) in enumerate(frames):
        image = whole.copy()
        if 20 <= i < 30:
            cover(image, camera, truth()[i, 2])
        hidden.append((t, image))
    found = track_frames(hidden, plane, layout=BODY[MARKED]).trajectory.positions
    missing = np.isnan(found[..., 0])
    assert missing[20:30, 2].all()
    assert missing.sum() == 10
    assert rms_mm(found, truth()) < 0.1


def test_a_shadow_that_passes_leaves_the_marks_what_they_are(filmed) -> None:
    """Somebody leans over the table for half a second; afterwards it is a little brighter than before."""
    _, frames, plane = filmed
    light = np.repeat([0.8, 0.46, 0.97], [5, 6, 19])
    shaded = [(t, (image * s).astype(np.uint8)) for (t, image), s in zip(frames, light, strict=False)]
    found = track_frames(shaded, plane, layout=BODY[MARKED]).trajectory.positions
    assert np.isfinite(found[11:]).all()
    assert rms_mm(found, truth()[:30]) < 0.2


def test_a_half_covered_mark_is_right_or_missing(filmed) -> None:
    """A card slides over m3 pixel by pixel: a centroid of what is left would be millimetres off."""
    camera, frames, plane = filmed
    lens = camera.plane
    tracker = DiscTracker(plane, NAMES, BODY[MARKED])
    tracker.update(frames[0][1], 0.0)
    x, y = np.round(lens.to_pixels(truth()[0, 2])).astype(int)
    outcomes = []
    for edge in np.arange(-12, 13):
        image = frames[0][1].copy()
        image[y - 15 : y + 16, x - 20 : x + edge] = 90
        found = tracker.update(image, 0.1 + 0.01 * edge)[2]
        outcomes.append(np.isnan(found[0]))
        assert np.isnan(found[0]) or np.linalg.norm(found - truth()[0, 2]) < 6e-4
    assert outcomes[-1] and not outcomes[0]


def test_marks_that_cross_keep_their_names(filmed) -> None:
    """m2 and m4 swap places, one passing before the other."""

    def swap(t: float) -> np.ndarray:
        body = BODY + np.array([0.1, 0.02])
        middle, reach = (body[1] + body[3]) / 2, (body[3] - body[1]) / 2
        turn = np.pi * np.clip((t - 1) / 3, 0, 1)
        side = np.array([np.sin(2 * turn) * 0.004, 0])
        body[1], body[3] = middle - reach * np.cos(turn) + side, middle + reach * np.cos(turn) - side
        return body

    camera, _, plane = filmed
    found = track_frames(film(camera, TIMES, swap), plane, layout=BODY[MARKED]).trajectory.positions
    error = np.linalg.norm(found - truth(TIMES, swap), axis=-1)
    assert np.nanmax(error) < 1e-3
    assert np.isfinite(error[-10:]).all()
    assert np.isfinite(error[:, [0, 2, 4]]).mean() > 0.7  # m3 is in between for a while


def test_coloured_things_about_do_not_confuse(filmed) -> None:
    _, frames, plane = filmed
    red, blue = (tuple(int(c) for c in PALETTE[m][::-1]) for m in ("m1", "m4"))
    disturbed = []
    for t, whole in frames:
        image = whole.copy()
        cv2.circle(image, (600, 250), 30, red, -1)
        cv2.rectangle(image, (560, 180), (570, 200), blue, -1)
        disturbed.append((t, image))
    found = track_frames(disturbed, plane, layout=BODY[MARKED]).trajectory
    assert rms_mm(found.positions, truth()) < 0.1


def test_no_name_on_the_overlay_covers_another() -> None:
    ends = [("m1", np.array([100.0, 50.0])), ("m2", np.array([103.0, 52.0])), ("m3", np.array([99.0, 48.0]))]
    places = dict(pipeline.declutter_labels(ends))
    for one, other in itertools.combinations(places.values(), 2):
        assert (np.abs(one - other) >= pipeline._LABEL_SIZE).any()
    assert np.array_equal(places["m3"], ends[2][1])


def test_fewer_marks_than_five(filmed) -> None:
    camera, _, plane = filmed
    frames = [(t, camera.render(walk(t), SPRINGS, MARKED[:3])) for t in TIMES[:10].tolist()]
    found = track_frames(frames, plane, NAMES[:3], BODY[MARKED[:3]]).trajectory
    assert rms_mm(found.positions, truth(TIMES[:10])[:, :3]) < 0.1


def test_a_body_that_has_folded_is_tracked_all_the_same(filmed) -> None:
    def folded(t: float) -> np.ndarray:
        bent = BODY.copy()
        bent[3:5] += [[-0.03, -0.02], [-0.07, -0.05]]
        return bent + np.array([0.02 * t + 0.05, 0.02])

    camera, _, plane = filmed
    times = TIMES[:10]
    found = track_frames(film(camera, times, folded), plane, layout=BODY[MARKED]).trajectory
    assert rms_mm(found.positions, truth(times, folded)) < 0.1


def test_what_is_wrong_with_marks_and_pictures_is_named(filmed) -> None:
    camera, frames, plane = filmed
    bare = [(t, camera.render(walk(t), SPRINGS, MARKED[:0])) for t in (0.0, 0.1)]
    with raises(InputError, "marks.not-seen", match="m1, m2, m3, m4, m5"):
        track_frames(bare, plane)
    few = [(0.0, camera.render(BODY, SPRINGS, MARKED[:3]))]
    with raises(InputError, "marks.not-seen", match="m4, m5"):
        track_frames(few, plane)
    with raises(InputError, "marks.elsewhere", match="m4 where m2 should be, m2 where m4 should be"):
        track_frames(frames[:3], plane, layout=BODY[[0, 3, 2, 1, 4]])
    with raises(InputError, "marks.elsewhere"):
        track_frames(frames[:3], plane, layout=BODY[MARKED[::-1]])
    with raises(InputError, "camera.other-size", match="640 x 480.*320 x 240"):
        track_frames([(0.0, frames[0][1][::2, ::2])], plane)


def test_the_tracker_knows_nothing_of_the_renderer() -> None:
    folder = Path(eldir_hardware.vision.__file__).parent
    for file in folder.glob("*.py"):
        if file.name == "virtual_camera.py":
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            imported = [a.name for a in getattr(node, "names", [])] if isinstance(node, ast.Import) else []
            imported += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any("virtual_camera" in name for name in imported), file.name
