"""Where a printed ground lies in a film, and its colour; test_ground_circle.py has films of robots."""

import colorsys

import numpy as np
import pytest

from eldir_hardware.images.video import GROUND_COLOUR
from eldir_hardware.markers.registration import PALETTE
from eldir_hardware.vision.printed_ground import PrintedGround, predict_ground, start_offset
from tests.eldir.random_design import make_design

SIMULATED = np.array([[0.0, 0.01], [0.03, 0.06], [0.0, 0.11]])
SHIFT = np.array([0.12, 0.018])
TIMES = np.array([0.0, 0.3, 0.6, 0.9, 1.2])


def film() -> np.ndarray:
    """A robot that settles, stands, and walks from 1 s."""
    positions = np.tile(SIMULATED + SHIFT, (len(TIMES), 1, 1))
    positions[:2, :, 1] += 0.01
    positions[4, :, 0] += 0.05
    return positions


def test_the_offset_is_that_of_the_robot_that_has_settled():
    assert start_offset(TIMES, film(), SIMULATED) == pytest.approx(SHIFT)
    surface = np.array([[-0.1, 0.0], [0.3, 0.02]])
    assert PrintedGround(SIMULATED, surface).in_plane(TIMES, film()) == pytest.approx(surface + SHIFT)


def test_markers_that_were_not_tracked_are_left_out():
    positions = film()
    positions[:, 1] = np.nan
    positions[2] = np.nan
    assert start_offset(TIMES, positions, SIMULATED) == pytest.approx(SHIFT)


@pytest.mark.parametrize("seen", [slice(0, 2), slice(4, 5)])
def test_nothing_is_known_from_before_the_robot_has_settled_and_from_later(seen: slice):
    assert start_offset(TIMES[seen], film()[seen], SIMULATED) is None
    positions = film()
    positions[2:4] = np.nan
    assert start_offset(TIMES, positions, SIMULATED) is None


def test_a_robot_that_stands_otherwise_than_simulated_has_no_ground():
    positions = film()
    positions[:, 0, 0] += 0.02
    assert start_offset(TIMES, positions, SIMULATED) is None
    positions[:, 0, 0] -= 0.015  # 2.5 mm is within what robots differ in
    assert start_offset(TIMES, positions, SIMULATED) is not None


def test_a_design_for_a_table_has_no_ground():
    assert predict_ground(make_design(1)) is None


def test_no_marker_has_the_colour_of_the_ground():
    """Hues are at least 30 degrees apart."""
    hue = colorsys.rgb_to_hsv(*(c / 255 for c in GROUND_COLOUR[::-1]))[0]
    for colour in PALETTE.values():
        apart = abs(hue - colorsys.rgb_to_hsv(*(c / 255 for c in colour))[0])
        assert 360 * min(apart, 1 - apart) > 30
