"""Other things in view that look like markers: the right places, or a line that says what is in the way."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.camera.plane import Image
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.images import jpeg
from eldir_hardware.vision.pipeline import TrackingResult, track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.emulated_rigs import each_once
from tests.hardware.markers.other_things_in_view import add_cap, disturbed_film, lamp, park, reflect, shifted
from tests.hardware.vision.walking_films import (
    BODY,
    MARKED,
    NAMES,
    SPACE,
    SPRINGS,
    TIMES,
    cover,
    film,
    truth,
    walk,
)
from tests.raised import raises

FRAMES = TIMES[:14:2]
LAYOUT = BODY[MARKED]
WARM, COLD = (0.5, 0.8, 1.0), (1.0, 0.8, 0.6)

LIGHTS: dict[str, Callable[[Image], Image]] = {
    "even": lambda image: image,
    "dim": lambda image: (0.55 * image).astype(np.uint8),
    "a warm lamp": lambda image: lamp(image, (0.8, 0.2), 0.8, WARM),
    "a cold lamp": lambda image: lamp(image, (0.2, 0.3), 0.8, COLD),
}

OBJECTS: dict[str, Callable[[VirtualCamera], VirtualCamera]] = {
    "caps": lambda c: add_cap(add_cap(c, "m3", [0.30, 0.12]), "m1", [-0.10, 0.08]),
    "a larger cap": lambda c: add_cap(c, "m2", [-0.1, 0.05], 0.013),
    "a robot of another design": lambda c: park(c, shifted(-0.05, 0, BODY * (-1, 1))),
    "a robot with two of the marks": lambda c: park(c, shifted(0.34, 0), MARKED[:2]),
}


@cache
def _first_camera() -> VirtualCamera:
    return VirtualCamera(7, SPACE)


def a_camera() -> VirtualCamera:
    """Each time the same one, which has not taken a picture."""
    return copy.deepcopy(_first_camera())


def watched(camera: VirtualCamera, frames: list[tuple[float, Image]]) -> TrackingResult:
    images = [(t, jpeg.decode(jpeg.encode(image))) for t, image in frames]
    return track_frames(images, calibrate_plane([f for _, f in images[:4]], camera.board), NAMES, LAYOUT)


def worst(found: TrackingResult, times: np.ndarray = FRAMES) -> float:
    """Largest distance from the truth [m]."""
    return float(np.nanmax(np.linalg.norm(found.trajectory.positions - truth(times), axis=-1)))


@pytest.mark.parametrize(("thing", "light"), each_once([*OBJECTS], [*LIGHTS]))
def test_other_things_are_no_markers(thing: str, light: str) -> None:
    camera = OBJECTS[thing](a_camera())
    found = watched(camera, [(t, LIGHTS[light](image)) for t, image in film(camera, FRAMES)])
    assert np.mean(found.quality.seen) > 0.97
    assert worst(found) < 1e-3
    assert any("are not tracked" in remark for remark in found.quality.remarks(NAMES))


@pytest.mark.parametrize(("share", "light"), each_once([0.35, 0.25], [*LIGHTS]))
def test_a_table_that_reflects_shows_no_markers(share: float, light: str) -> None:
    camera = a_camera()
    frames = [(t, LIGHTS[light](reflect(camera, image, share))) for t, image in film(camera, FRAMES)]
    found = watched(camera, frames)
    assert np.mean(found.quality.seen) > 0.97
    assert worst(found) < 1e-3


@pytest.mark.parametrize("light", LIGHTS)
def test_two_robots_alike_are_refused(light: str) -> None:
    """The control robot of the how-to: the same layout, the same colours."""
    camera = park(a_camera(), shifted(0.34, 0.006))
    frames = [(t, LIGHTS[light](image)) for t, image in film(camera, FRAMES)]
    with raises(InputError, "marks.two-robots", match=r"m1 at x = 0\.0\d m.*0\.34 m.*cover"):
        watched(camera, frames)


def test_a_robot_alike_is_refused_where_a_card_covers_a_mark_of_ours() -> None:
    """Then the other robot is the only whole one."""
    camera = park(a_camera(), shifted(0.34, 0.006))
    frames = film(camera, FRAMES)
    for i, (_, image) in enumerate(frames[:5]):
        cover(image, camera, truth(FRAMES)[i, 2])
    with raises(InputError, "marks.two-robots"):
        watched(camera, frames)


def test_a_robot_alike_is_told_with_both_places_where_cards_cover_two_marks_of_ours() -> None:
    """Nothing says which of the two is ours: the first frame tells of the second set."""
    camera = park(a_camera(), shifted(0.34, 0.006))
    frames = film(camera, FRAMES[:3])
    for i, (_, image) in enumerate(frames):
        cover(image, camera, truth(FRAMES)[i, 2])
        cover(image, camera, truth(FRAMES)[i, 1])
    (note,) = [n for n in watched(camera, frames).quality.notes if "second set" in n]
    assert "At 0.0 s" in note and "m1 at (0.00, 0.0" in note and "tracked one has it at (0.34, 0.02)" in note


def test_a_disc_that_blends_with_ours_in_the_first_frame_is_told() -> None:
    """Another robot's m3 stands 12 mm behind ours, 5 pixels: no frame is clean before ours has walked on."""
    found = disturbed_film(173)
    images = [(t, jpeg.decode(jpeg.encode(image))) for t, image in found.frames[:6]]
    plane = calibrate_plane([image for _, image in images], found.camera.board)
    tracked = track_frames(images, plane, NAMES, LAYOUT)
    off = np.linalg.norm(tracked.trajectory.positions[1:5] - found.truth[1:5], axis=-1)
    assert off[:, 2].max() > 1e-3, "otherwise the film shows nothing"
    assert off[:, [0, 1, 3, 4]].max() < 1e-3
    (note,) = [note for note in tracked.quality.notes if "does not look like a whole disc" in note]
    assert note.startswith("m3 ")


def test_without_a_design_a_second_disc_of_a_colour_is_refused() -> None:
    camera = add_cap(a_camera(), "m3", [0.30, 0.12])
    frames = film(camera, FRAMES)
    plane = calibrate_plane([f for _, f in frames[:4]], camera.board)
    with raises(InputError, "marks.too-many", match=r"m3.* 0\.00 m and 0\.30 m.*--design"):
        track_frames(frames, plane, NAMES)


def test_markers_far_from_the_design_are_told() -> None:
    def folded(t: float) -> np.ndarray:
        bent = BODY.copy()
        bent[3:5] += [[-0.03, -0.02], [-0.07, -0.05]]
        return bent + np.array([0.02 * t + 0.05, 0.02])

    camera = a_camera()
    found = watched(camera, film(camera, FRAMES, folded))
    off = np.linalg.norm(found.trajectory.positions - truth(FRAMES, folded), axis=-1)
    assert np.nanmax(off) < 1e-3
    assert any("from their places in the design" in r for r in found.quality.remarks(NAMES))


def test_a_cap_is_not_taken_for_a_mark_that_is_covered() -> None:
    """A hand covers m3 for a second; a cap of its colour stands 6 cm beside."""
    camera = add_cap(a_camera(), "m3", shifted(-0.06, 0.01)[2])
    frames = film(camera, TIMES[:40])
    for i in range(12, 24):
        cover(frames[i][1], camera, truth()[i, 2])
    found = watched(camera, frames)
    measured = ~found.trajectory.bridged[:, 2] & np.isfinite(found.trajectory.positions[:, 2, 0])
    assert not measured[12:24].any() and measured[26:].all()
    assert worst(found, TIMES[:40]) < 1e-3


@pytest.mark.parametrize("beside", [0.025, 0.04, 0.05])
def test_a_cap_that_comes_into_view_is_not_taken_for_a_mark_that_is_covered(beside: float) -> None:
    """A hand puts a cap beside m4 while it covers all marks but m1: only m1 tells where m4 should be."""
    camera = a_camera()
    frames = film(camera, TIMES[:40])
    add_cap(camera, "m4", truth()[12, 3] + [-beside, 0.0])
    frames[12:] = film(camera, TIMES[:40])[12:]
    for i in range(12, 24):
        for mass in MARKED[1:]:
            cover(frames[i][1], camera, truth()[i, mass], 0.02)
    found = watched(camera, frames)
    measured = ~found.trajectory.bridged[:, 3] & np.isfinite(found.trajectory.positions[:, 3, 0])
    assert not measured[12:24].any() and measured[26:].all()
    assert worst(found, TIMES[:40]) < 1e-3


def test_a_thing_seen_beside_a_mark_is_remembered_while_the_mark_is_covered() -> None:
    """The body walks towards a cap that came after the first frame: it is near, and then m3 is covered."""
    camera = a_camera()
    frames = film(camera, TIMES[:40])
    cap = truth()[30, 2] + [0.009, 0.0]
    add_cap(camera, "m3", cap)
    for i in range(3, 40):
        frames[i] = (TIMES[i], camera.render(walk(TIMES[i]), SPRINGS, MARKED))
    for i in range(25, 33):
        cover(frames[i][1], camera, truth()[i, 2] - [0.004, 0], 0.012)
    found = watched(camera, frames)
    assert worst(found, TIMES[:40]) < 2e-3


def test_a_mark_that_is_a_cap_is_told_by_name() -> None:
    """A cap of m4's colour stands 28 mm beside m4 at first, which is covered; the cap fits the layout."""
    camera = add_cap(a_camera(), "m4", BODY[3] + [-0.02, 0.04])
    frames = film(camera, TIMES[:30])
    for i, (_, image) in enumerate(frames):
        cover(image, camera, truth()[i, 3], 0.01)
    found = watched(camera, frames)
    off = np.nanmax(np.linalg.norm(found.trajectory.positions - truth(TIMES[:30]), axis=-1), axis=0)
    assert off[3] > 2e-3 and np.delete(off, 3).max() < 1e-3
    assert any("m4 at" in remark and "not at its place" in remark for remark in found.quality.notes)


def test_a_foot_that_sags_is_no_stranger() -> None:
    """One marker of a sound robot may lie 15 mm from its design, as m1 of the demo's does."""

    def sagged(t: float) -> np.ndarray:
        bent = walk(t).copy()
        bent[MARKED[0]] += [0.012, 0.009]
        return bent

    camera = a_camera()
    found = watched(camera, film(camera, FRAMES, sagged))
    assert np.nanmax(np.linalg.norm(found.trajectory.positions - truth(FRAMES, sagged), axis=-1)) < 1e-3
    assert found.quality.notes == ()


@pytest.mark.parametrize("lost", [MARKED, MARKED[:3]])
def test_markers_that_come_back_are_taken_from_one_robot(lost: np.ndarray) -> None:
    """A hand covers marks for two seconds, while a robot alike is carried into the picture."""
    camera = a_camera()
    frames = film(camera, TIMES)
    park(camera, shifted(0.3, 0.006))
    frames[15:] = film(camera, TIMES)[15:]
    for i in range(15, 40):
        for mass in lost:
            cover(frames[i][1], camera, truth()[i, mass])
    found = watched(camera, frames)
    assert worst(found, TIMES) < 1e-3
    measured = np.isfinite(found.trajectory.positions[..., 0]) & ~found.trajectory.bridged
    assert not measured[16:39][:, lost].any() and measured[45:].all()
