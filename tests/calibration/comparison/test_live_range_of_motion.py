"""Ranges of motion cycle by cycle are those of the whole run, and each comes after its cycle."""

import numpy as np
import pytest

from eldir.built.robot import build
from eldir.lattice import Lattice
from eldir.trajectory import Trajectory
from eldir_calibration.comparison.film import PredictedBody
from eldir_calibration.comparison.predictions import LivePrediction, LiveRangeOfMotion
from eldir_calibration.report.comparison import Motion
from eldir_hardware.schedule import ActuationSchedule, Event
from tests.eldir.random_design import make_design

NAMES = ("m1", "m2")
SCHEDULE = ActuationSchedule(
    2.0,
    events=(Event(0.0, 0, "front", 1, True), Event(0.5, 0, "front", 1, False)),
    cycles=3,
    conditioning_cycles=1,
    settle_s=1.0,
)
TIMES = np.arange(0, SCHEDULE.duration + 0.5, 0.05)
HEIGHTS = 0.01 * np.sin(np.pi * TIMES)[:, None] * [1.0, 2.0] * (1 + 0.1 * TIMES[:, None])
POSITIONS = np.stack([0.02 * TIMES[:, None] + [0.0, 0.05], 0.1 + HEIGHTS], axis=-1)
BODY = PredictedBody(
    TIMES, np.concatenate([POSITIONS, POSITIONS + 0.5], axis=1), np.zeros((0, 2), int), np.array([1, 0])
)
"""Four masses; the marked ones are its second and its first."""


@pytest.fixture(scope="module")
def design():
    return make_design(3, Lattice(3, 6))


def test_each_cycle_is_told_once_when_it_is_whole(design):
    live = LiveRangeOfMotion(design, SCHEDULE)
    found = [(t, live.update(t, NAMES, p)) for t, p in zip(TIMES.tolist(), POSITIONS, strict=True)]
    told = [(t, ranges) for t, ranges in found if ranges is not None]
    assert [ranges.cycle for _, ranges in told] == [1, 2, 3]
    for t, ranges in told:
        assert 0 <= t - (SCHEDULE.start_of_cycles + 2.0 * ranges.cycle) < 0.05 + 1e-9
    length = build(design.morphology).body_length
    whole = Motion(Trajectory(NAMES, TIMES, POSITIONS), SCHEDULE.start_of_cycles, 2.0, 3, length)
    np.testing.assert_allclose([r.ranges["tracked"] for _, r in told], whole.vertical_ranges(), rtol=1e-6)
    np.testing.assert_allclose([r.displacement for _, r in told], 0.02 * 2.0 / length, rtol=1e-6)


def test_predictions_appear_when_they_are_known_cycle_by_cycle(design):
    live = LiveRangeOfMotion(design, SCHEDULE)
    predicted = Motion(Trajectory(NAMES, TIMES, POSITIONS), SCHEDULE.start_of_cycles, 2.0, 3, 0.3)
    told = []
    for t, p in zip(TIMES.tolist(), POSITIONS, strict=True):
        if t > 6.0:
            live.prediction = LivePrediction({"simulated": predicted, "predicted": predicted}, BODY)
        if (ranges := live.update(t, NAMES, p)) is not None:
            told.append(ranges.ranges)
    assert [set(r) for r in told] == [{"tracked"}] + [{"simulated", "predicted", "tracked"}] * 2
    ranges = predicted.vertical_ranges()
    np.testing.assert_array_equal(told[1]["predicted"], ranges[1])
    np.testing.assert_array_equal(told[1]["simulated"], ranges[2])


def test_the_predicted_robot_begins_where_the_filmed_one_stands(design):
    """Forward; its height is that of the simulation."""
    live = LiveRangeOfMotion(design, SCHEDULE)
    live.update(0.5, NAMES, POSITIONS[10] + [0.3, 0.007])
    assert live.predicted_masses(1.0) is None, "it is not known yet"
    live.prediction = LivePrediction({}, BODY)
    live.update(1.0, NAMES, POSITIONS[20])
    moved = live.predicted_masses(1.0) - BODY.positions[20]
    np.testing.assert_allclose(moved, np.broadcast_to([0.3, 0.0], (4, 2)), atol=1e-12)
    assert live.predicted_masses(-0.1) is None and live.predicted_masses(SCHEDULE.duration + 0.1) is None


def test_late_repeated_and_early_positions_change_nothing(design):
    plain, noisy = LiveRangeOfMotion(design, SCHEDULE), LiveRangeOfMotion(design, SCHEDULE)
    assert noisy.update(-0.1, NAMES, np.ones((2, 2))) is None
    for t, p in zip(TIMES.tolist(), POSITIONS, strict=True):
        a, b = plain.update(t, NAMES, p), noisy.update(t, NAMES, p)
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            np.testing.assert_array_equal(a.ranges["tracked"], b.ranges["tracked"])
        assert noisy.update(t, NAMES, np.ones((2, 2))) is None
        assert noisy.update(t - 0.2, NAMES, np.ones((2, 2))) is None


def test_a_cycle_that_was_not_covered_is_left_out(design):
    live = LiveRangeOfMotion(design, SCHEDULE)
    late = TIMES > 4.2  # more than a quarter of the first cycle has passed
    found = [live.update(t, NAMES, p) for t, p in zip(TIMES[late].tolist(), POSITIONS[late], strict=True)]
    assert [ranges.cycle for ranges in found if ranges is not None] == [2, 3]


def test_a_mark_that_was_not_seen_has_no_range(design):
    live = LiveRangeOfMotion(design, SCHEDULE)
    hidden = POSITIONS.copy()
    hidden[(TIMES > 2.9) & (TIMES < 5.1), 1] = np.nan
    found = [live.update(t, NAMES, p) for t, p in zip(TIMES.tolist(), hidden, strict=True)]
    first, second, _ = (ranges.ranges["tracked"] for ranges in found if ranges is not None)
    assert np.isfinite(first[0]) and np.isnan(first[1]) and np.isfinite(second).all()
