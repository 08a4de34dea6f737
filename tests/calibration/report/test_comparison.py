"""Comparison of motions that are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir.trajectory import Trajectory
from eldir_calibration.report.comparison import (
    PHASE_SAMPLES,
    CycleMean,
    Motion,
    agreements,
    best_lag,
    compare_motions,
    mean_cycle,
)
from tests.calibration.report.striding_walkers import CYCLES, LENGTH, PERIOD, walker
from tests.raised import raises


def test_vertical_ranges_are_those_of_the_circle() -> None:
    ranges = walker().vertical_ranges()
    assert ranges.shape == (CYCLES, 2)
    assert ranges == pytest.approx(np.broadcast_to([0.006, 0.012], (CYCLES, 2)), rel=1e-3)


def test_displacement_is_speed_over_body_length() -> None:
    assert walker(speed=0.01).displacement() == pytest.approx(5 * 0.01 / LENGTH, rel=1e-6)
    assert walker(speed=-0.02).displacement() == pytest.approx(-5 * 0.02 / LENGTH, rel=1e-6)
    cycles, moved = walker(speed=0.01).advance()
    assert cycles[-1] == pytest.approx(CYCLES, abs=1e-6)
    assert moved[-1] == pytest.approx(5 * 0.01 / LENGTH, rel=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.floats(0.5, 20), st.floats(5, 40))
def test_scale_and_period_change_nothing_that_is_compared(scale: float, period: float) -> None:
    plain, scaled = walker(), walker(scale=scale, period=period, start=period, rate=200 / period)
    assert scaled.displacement() == pytest.approx(plain.displacement(), rel=1e-9)
    assert scaled.vertical_ranges() == pytest.approx(plain.vertical_ranges(), rel=1e-3)


@given(st.integers(0, PHASE_SAMPLES - 1))
def test_the_lag_between_two_motions_is_found(lag: int) -> None:
    a, b = walker().by_phase(), walker(phase=lag / PHASE_SAMPLES).by_phase()
    assert best_lag(a, b) == lag


def test_a_walk_alone_is_no_agreement() -> None:
    """Both go forward; one swings at twice the rate: nothing but the walk is common."""
    a, b = walker(speed=0.05), walker(speed=0.05)
    x = a.trajectory.positions.copy()
    twice = 4 * np.pi * a.trajectory.times / PERIOD
    x[:, :, 0] = 0.05 * a.trajectory.times[:, None] / PERIOD + 0.004 * np.sin(twice)[:, None]
    other = Motion(Trajectory(("m1", "m2"), a.trajectory.times, x), PERIOD, PERIOD, CYCLES, LENGTH)
    found = agreements(other.by_phase(), b.by_phase())
    assert all(abs(mass["horizontal"].correlation) < 0.3 for mass in found)
    same = agreements(a.by_phase(), b.by_phase())
    for mass in same:
        assert mass["vertical"].correlation == pytest.approx(1) and mass["vertical"].error == pytest.approx(0)
        assert mass["vertical"].null < 0.75


def test_error_is_the_amplitude_of_the_difference() -> None:
    a, b = walker(lift=0.003), walker(lift=0.005)
    found = agreements(a.by_phase(), b.by_phase())
    assert found[0]["vertical"].error == pytest.approx(0.002 / np.sqrt(2), rel=1e-3)
    assert found[1]["vertical"].error == pytest.approx(0.004 / np.sqrt(2), rel=1e-3)


def test_interval_is_students() -> None:
    """Five values with mean 3 and standard deviation sqrt(2.5); t(0.975, 4) = 2.776445."""
    found = CycleMean.of(np.array([1.0, 2, np.nan, 3, 4, 5]))
    half = 2.776445 * np.sqrt(2.5 / 5)
    assert (found.mean, found.low, found.high) == pytest.approx((3, 3 - half, 3 + half))
    assert np.isnan(CycleMean.of(np.array([np.nan])).mean)
    assert np.isnan(CycleMean.of(np.array([1.0, np.nan])).low)


def test_a_gap_is_bridged_and_counted() -> None:
    whole = walker(speed=0.01)
    x = whole.trajectory.positions.copy()
    t = whole.trajectory.times
    x[(t > 40) & (t < 45), 0] = np.nan
    gap = Motion(Trajectory(("m1", "m2"), t, x), PERIOD, PERIOD, CYCLES, LENGTH)
    assert gap.visible_share[0] == pytest.approx(0.95, abs=0.005) and gap.visible_share[1] == 1
    assert gap.displacement() == pytest.approx(whole.displacement(), rel=1e-9)
    short = Trajectory(("m1", "m2"), t, x).bridge(10.0)
    bridged = Motion(short, PERIOD, PERIOD, CYCLES, LENGTH)
    assert np.isfinite(short.positions).all()
    assert bridged.visible_share[0] == pytest.approx(0.95, abs=0.005), "what is bridged was not seen"
    x[:, 0] = np.nan
    never = Motion(Trajectory(("m1", "m2"), t, x), PERIOD, PERIOD, CYCLES, LENGTH)
    assert np.isnan(never.vertical_ranges()[:, 0]).all() and np.isfinite(never.vertical_ranges()[:, 1]).all()


def five_markers(*unseen: tuple[int, float, float]) -> Motion:
    """Five markers that walk one body length in five cycles, with their own phases; of each `unseen` the
    number, and the times between which it has no place [s]."""
    t = np.arange(0, (CYCLES + 1) * PERIOD + 0.2, 0.1)
    turn = 2 * np.pi * t[:, None] / PERIOD + np.arange(5)
    forward = LENGTH * t[:, None] / PERIOD / 5 + 0.03 * np.arange(5) + 0.004 * np.sin(turn)
    x = np.stack([forward, 0.03 + 0.003 * np.cos(turn)], axis=2)
    for k, begin, end in unseen:
        x[(t > begin) & (t < end), k] = np.nan
    return Motion(Trajectory(tuple(f"m{k + 1}" for k in range(5)), t, x), PERIOD, PERIOD, CYCLES, LENGTH)


def test_a_cycle_without_a_picture_has_no_range() -> None:
    whole = five_markers()
    kept = (whole.trajectory.times < 1.95 * PERIOD) | (whole.trajectory.times > 3.05 * PERIOD)
    some = Trajectory(whole.trajectory.names, whole.trajectory.times[kept], whole.trajectory.positions[kept])
    ranges = replace(whole, trajectory=some).vertical_ranges()
    known = np.isfinite(ranges).all(axis=1)
    assert known.tolist() == [True, False, *[True] * (CYCLES - 2)] and np.isnan(ranges[1]).all()
    np.testing.assert_allclose(ranges[known], whole.vertical_ranges()[known], atol=1e-4)


END = 1e3
LOST_IN_THE_FIRST_CYCLE = [(k, 1.4 * PERIOD, END) for k in range(3)]
FOUND_IN_THE_LAST_CYCLE = [(k, 0.0, 5.3 * PERIOD) for k in range(2)]


@pytest.mark.parametrize(
    "unseen", [[], LOST_IN_THE_FIRST_CYCLE, LOST_IN_THE_FIRST_CYCLE[:1], FOUND_IN_THE_LAST_CYCLE]
)
def test_a_marker_that_is_lost_or_found_late_does_not_stand_still(
    unseen: list[tuple[int, float, float]],
) -> None:
    """The walk is that of the markers seen at both ends of each cycle, in closed form +1.00."""
    motion = five_markers(*unseen)
    np.testing.assert_allclose(motion.displacements(), 1.0, atol=1e-9)
    walk = CycleMean.of(motion.displacements())
    assert walk.high - walk.low < 1e-6 and motion.known_cycles == CYCLES
    cycles, moved = motion.advance()
    at_ends = np.isclose(cycles, np.round(cycles), atol=1e-6)
    np.testing.assert_allclose(moved[at_ends], np.arange(CYCLES + 1) / 5, atol=1e-9)
    hidden = [k for k, *_ in unseen]
    ranges = motion.vertical_ranges()
    assert np.isfinite(ranges[:, [k for k in range(5) if k not in hidden]]).all()
    assert np.isnan(ranges[1:4, hidden]).all() and np.isfinite(ranges).sum() == 5 * (5 - len(hidden))


def test_a_cycle_without_a_marker_at_both_ends_is_not_known() -> None:
    """All are hidden around the end of the second cycle: two of five cycles, which are not guessed."""
    hidden = [(k, 2.8 * PERIOD, 3.2 * PERIOD) for k in range(5)]
    motion = five_markers(*hidden)
    np.testing.assert_allclose(motion.displacements(), [1, np.nan, np.nan, 1, 1], atol=1e-9)
    assert motion.known_cycles == 3 and motion.displacement() == pytest.approx(1.0)
    folded = motion.by_phase()
    np.testing.assert_array_equal(np.isnan(folded).any(axis=(1, 2, 3)), [False, True, True, False, False])
    seen = np.abs(np.arange(CYCLES * PHASE_SAMPLES) + 0.5 - 2 * PHASE_SAMPLES) > 0.1 * PHASE_SAMPLES
    np.testing.assert_array_equal(np.isfinite(folded[..., 0, 0]).ravel(), seen)
    np.testing.assert_allclose(mean_cycle(folded), mean_cycle(five_markers().by_phase()), atol=1e-9)
    (agreement, *_) = agreements(five_markers().by_phase(), folded)
    assert agreement["horizontal"].correlation == pytest.approx(1.0)
    never = five_markers(*[(0, (c + 0.2) * PERIOD, (c + 0.8) * PERIOD) for c in range(1, 6)])
    (lost, seen_one, *_) = agreements(five_markers().by_phase(), never.by_phase())
    assert np.isnan(lost["vertical"].correlation) and seen_one["vertical"].correlation > 0.999


def test_comparison_takes_the_camera_as_the_measure() -> None:
    report = compare_motions(
        walker(phase=0.3, scale=0.1, speed=0.05), walker(lift=0.0033), walker(noise=1e-5)
    )
    assert report.displacement["tracked"] == pytest.approx(0.25, abs=0.01)
    for mass in report.agreement["simulated"]:
        for direction in mass.values():
            assert direction.correlation > 0.999, "its lag is granted"
    assert [r.mean for r in report.ranges["predicted"]] == pytest.approx([0.0066, 0.0132], rel=1e-3)
    assert report.body_length == LENGTH
    assert report.warnings == ("Only 2 masses lie on the rear edge of this design; five are usual.",)


def test_a_prediction_that_equals_the_camera_is_called_a_bug() -> None:
    report = compare_motions(walker(), walker(), walker())
    assert any("bug" in w for w in report.warnings)
    assert not any("bug" in w for w in compare_motions(walker(), walker(lift=0.0031), walker()).warnings)


def test_motions_that_do_not_fit_are_named() -> None:
    a = walker()
    with raises(InputError, "report.cycles-not-covered"):
        Motion(a.trajectory, PERIOD, PERIOD, CYCLES + 1, LENGTH)
    with raises(InputError, "report.cycles-not-covered"):
        Motion(Trajectory(("m1",), np.empty(0), np.empty((0, 1, 2))), 0.0, PERIOD, CYCLES, LENGTH)
    t = a.trajectory
    renamed = Motion(Trajectory(("m1", "m3"), t.times, t.positions), PERIOD, PERIOD, CYCLES, LENGTH)
    with raises(InputError, "report.different-masses", match="predicted"):
        compare_motions(a, renamed, a)
