"""A filmed robot that leaves its plane or falls: what the report says, and which cycles count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_calibration.comparison.departure import (
    describe_departure,
    describe_lost_cycles,
    find_robot_loss,
    marked_strips,
    measure_departure,
    observe_standing,
    require_whole_cycle,
)
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.numbers import OutOfPlaneNumbers
from eldir_hardware.camera.projection import Projection
from eldir_hardware.vision.pipeline import TrackingResult
from eldir_hardware.vision.tracking_quality import TrackingQuality
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.eldir.random_design import make_design
from tests.hardware.vision.walking_films import SPACE
from tests.raised import raises

DESIGN = make_design(1)
CAMERA = VirtualCamera(3, SPACE)
VIEW = Projection.of(CAMERA.plane, float(CAMERA.lens.focal_px[0]))
TIMES = np.arange(0.0, 30.0, 0.1)
REST = DESIGN.morphology.positions[DESIGN.marks] * 1.14


def tracked(depth: np.ndarray, shrink: np.ndarray, last: float = np.inf) -> TrackingResult:
    """The design's markers as tracked where they move behind the plane by `depth` [m], and look lower by a
    factor; none after `last` [s]."""
    places = np.tile(REST, (len(TIMES), 1, 1))
    places[..., 1] *= shrink[:, None]
    behind = np.broadcast_to(depth[:, None], places.shape[:2])
    space = np.stack([places[..., 0], behind, places[..., 1]], axis=-1)
    seen = CAMERA.plane.to_metres(VIEW.to_pixels(space))
    distance = -VIEW.position[1]
    sizes = distance / (distance + behind) * np.ones(places.shape[:2])
    seen[last < TIMES], sizes[last < TIMES] = np.nan, np.nan
    path = Trajectory(tuple(f"m{k + 1}" for k in range(len(REST))), TIMES, seen)
    return TrackingResult(path, TrackingQuality.of(path, sizes), np.zeros((2, 2, 3), np.uint8), sizes)


def test_strips_between_markers_are_those_of_the_design() -> None:
    marks, body = DESIGN.marks.tolist(), DESIGN.morphology
    pairs = {frozenset((marks[a], marks[b])) for a, b in marked_strips(DESIGN).tolist()}
    strips = {frozenset(pair) for pair in body.springs[~body.active].tolist()}
    assert len(pairs) > 1 and pairs == {pair for pair in strips if pair <= set(marks)}


@pytest.mark.parametrize("behind", [0.0, 0.06, -0.05])
def test_a_robot_that_comes_nearer_is_told_with_the_error_of_its_walk(behind: float) -> None:
    depth = behind * np.clip((TIMES - 5) / 20, 0, 1)
    found = tracked(depth, np.ones_like(TIMES))
    standing = observe_standing(found, DESIGN, CAMERA.plane, None)
    assert standing.loss is None and standing.trajectory is found.trajectory
    motion = Motion(standing.trajectory, 5.0, 12.0, 2, 0.3)
    told = measure_departure(standing, motion)
    assert told is not None and told.certain == (behind != 0.0)
    walked = (found.trajectory.positions[-5, :, 0] - found.trajectory.positions[50, :, 0]).mean()
    assert abs(walked) / 0.3 * 2.5 < told.walk_error < 0.3
    text = describe_departure(told)
    if not behind:
        assert text == ""
    else:
        assert f"distance {'behind' if behind > 0 else 'before'} it" in text
        assert "turned by at most" in text and f"uncertain by {told.walk_error:.2f} body lengths" in text


@pytest.mark.parametrize("fell", [True, False])
def test_a_robot_that_is_lost_walks_no_further_and_that_is_said(fell: bool) -> None:
    """Its markers' last places are no walk of zero; before a whole cycle there is nothing to report."""
    shrink = np.where(TIMES > 20.7, np.cos(np.clip(TIMES - 20.7, 0, 0.4) * 2 * fell), 1.0)
    standing = observe_standing(tracked(0 * TIMES, shrink, last=21.0), DESIGN, CAMERA.plane, None)
    loss = standing.loss
    assert loss is not None and loss.fell == fell and loss.last_seen_s == pytest.approx(21.0, abs=0.11)
    assert standing.trajectory.times[-1] == loss.last_seen_s
    told = measure_departure(standing, Motion(standing.trajectory, 5.0, 12.0, 1, 0.3))
    assert told is not None and (told.last_seen_s, told.fell) == (loss.last_seen_s, fell)
    said = "The robot fell over sideways at 21.0 s" if fell else "No marker after 21.0 s: it fell over"
    lost = find_robot_loss(standing, REST)
    assert lost is not None and lost.time_s == loss.last_seen_s
    assert describe_lost_cycles(lost).startswith(said) and describe_lost_cycles(None) == ""
    require_whole_cycle(lost, 17.0, "log.mcap")
    found = "the robot fell over" if fell else "no marker after"
    with raises(InputError, "film.lost", match=rf"log\.mcap: .*expected .* 25 s; found {found}"):
        require_whole_cycle(lost, 25.0, "log.mcap")


def test_an_uncertain_departure_is_not_told_in_a_sentence() -> None:
    calm = OutOfPlaneNumbers((0, 5, 20), (0, 3, 10), (-0.02, 0.0, 0.02), 0.1, False, None, False)
    assert describe_departure(calm) == "" == describe_departure(None)
    leaning = replace(calm, lean_deg=(5.0, 8.0, 12.0), certain=True)
    assert "within 2.0% of the camera's distance of it" in describe_departure(leaning)
    assert "leaned by 8 (5 to 12) degrees" in describe_departure(leaning)
