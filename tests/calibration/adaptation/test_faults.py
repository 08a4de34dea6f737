"""Faults that a film shows, and films that do not show them. A belief alone states none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from eldir.built.heat import HeatModel
from eldir.controller import Controller
from eldir.design import Design
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir.scene import Scene
from eldir.trajectory import Trajectory
from eldir_calibration.adaptation.faults import explained_share, find_faults
from eldir_calibration.adaptation.heat import believe_heat, find_safe_current, keeps_limit, spring_strokes
from eldir_calibration.comparison.meters import MeterReadings
from eldir_calibration.dynamics.belief import Belief
from eldir_calibration.dynamics.recording import INTERVAL, Recording, predict_markers
from eldir_calibration.identification.identification import RobotFilms
from tests.calibration.dynamics.hidden_rigs import (
    LATTICE,
    NOMINAL,
    blank_film,
    seen_by_camera,
    walker,
    walker_genotype,
)

SPRINGS = NOMINAL.springs
NAMES = ("current", "spring 1 current")
"""The second one is the difference between the motors: the first has more, the other one less."""
BOTH_WORK, SECOND_IDLE, BOTH_COLD, BOTH_HOT = (0.0, 0.0), (-0.8, 4.0), (-1.3, 0.0), (0.8, 0.0)
LIMIT = 90.0


@cache
def film(*heated: int, air_c: float = SPRINGS.ambient) -> Recording:
    """Two cycles of the walker, seen by a camera, in which only the springs of these motors get warm."""
    robot = replace(NOMINAL, springs=replace(SPRINGS, ambient=air_c))
    blank = blank_film(walker(), 2)
    shares = blank.contact_shares * np.isin(np.arange(2), heated)
    moved = predict_markers(walker(), [replace(blank, contact_shares=shares)], [robot])[0][0]
    return seen_by_camera(blank, moved, 1)


def films(
    recording: Recording, readings: MeterReadings | None = None, room_c: float | None = None
) -> RobotFilms:
    controller = Controller.random(len(walker().morphology.positions), 2, np.random.default_rng(1))
    design = Design(LATTICE, walker_genotype(), controller, Scene.preset("paper"))
    return RobotFilms(walker(), [recording], NOMINAL, (), design, [], {}, readings, (room_c,))


def believed(z: Sequence[float], misfit: float = 0.5) -> Belief:
    """Members that are nearly alike."""
    rng = np.random.default_rng(2)
    return Belief(NOMINAL, walker(), NAMES, np.array(z) + 0.01 * rng.standard_normal((8, 2)), misfit)


def kinds(recording: Recording, belief: Belief, readings: MeterReadings | None = None) -> list[str]:
    return [fault.kind for fault in find_faults(1, films(recording, readings), belief, LIMIT)]


def moved(recording: Recording, positions: np.ndarray) -> Recording:
    tracked = recording.tracked
    return replace(recording, tracked=Trajectory(tracked.names, tracked.times, positions))


@pytest.mark.filterwarnings("error")
def test_the_shape_is_that_of_the_markers_that_were_seen() -> None:
    """In the first cycle all are seen, in the second each is hidden for a third of it. Markers that are
    hidden in both cycles explain nothing."""
    whole = film(0)
    x, t = whole.tracked.positions.copy(), whole.tracked.times - whole.start
    for k in range(x.shape[1]):
        x[(t > whole.period * (1.1 + 0.1 * k)) & (t < whole.period * (1.45 + 0.1 * k)), k] = np.nan
    alone = replace(whole, cycles=1)
    shares = [explained_share(walker(), r, SPRINGS, [0]) for r in (moved(whole, x), alone)]
    assert shares[0] == shares[1] > 0.96
    x[(t > 0.3 * whole.period) & (t < 0.65 * whole.period)] = np.nan
    assert explained_share(walker(), moved(whole, x), SPRINGS, [0]) == 0.0


def test_a_motor_that_does_nothing_is_named() -> None:
    (fault,) = find_faults(3, films(film(0)), believed(SECOND_IDLE), LIMIT)
    assert (fault.run, fault.kind) == (3, "motor") and fault.text.startswith("motor 1 does nothing")
    assert explained_share(walker(), film(0), SPRINGS, [0]) > 0.97
    assert explained_share(walker(), film(0, 1), SPRINGS, [0]) < 0.95


def test_the_other_motors_are_heated_in_the_air_of_the_film() -> None:
    """In other air they explain too little of the shape, and the idle motor would not be named."""
    seen = film(0, air_c=5.0)
    cold = replace(believed(SECOND_IDLE), nominal=replace(NOMINAL, springs=replace(SPRINGS, ambient=5.0)))
    assert explained_share(walker(), seen, SPRINGS, [0]) < 0.96
    assert [fault.kind for fault in find_faults(1, films(seen, room_c=5.0), cold, LIMIT)] == ["motor"]


@pytest.mark.parametrize("belief", [believed(SECOND_IDLE), believed(BOTH_WORK), believed(BOTH_COLD, 1.5)])
def test_a_film_in_which_both_motors_work_shows_no_fault(belief: Belief) -> None:
    """Whatever the belief says, such as one that explains the film by a motor that does nothing."""
    assert kinds(film(0, 1), belief) == []


def test_springs_that_use_little_of_their_stroke_are_too_cold() -> None:
    belief = believed(BOTH_COLD)
    used, strokes = spring_strokes(belief, film(0, 1), SPRINGS.current_limit)
    possible = SPRINGS.hot_length - SPRINGS.cold_length
    assert used.shape == (8, 2) and 0.0 < used.max() < 0.5
    np.testing.assert_allclose(strokes, used * possible)
    assert kinds(film(0, 1), belief) == ["cold"]
    full, _ = spring_strokes(believed(BOTH_WORK), film(0, 1), SPRINGS.current_limit)
    np.testing.assert_allclose(full, 1.0, atol=0.02)


def test_a_robot_that_does_not_move_is_cold_or_held() -> None:
    """Also where the belief leaves open how far its springs move; not where it does not explain the film."""
    still = moved(
        film(0, 1), np.tile(film(0, 1).tracked.positions[:1], (len(film(0, 1).tracked.times), 1, 1))
    )
    for belief in (believed(BOTH_COLD), believed(BOTH_WORK)):
        (fault,) = find_faults(2, films(still), belief, LIMIT)
        assert (fault.run, fault.kind) == (2, "cold") and fault.text.startswith("the robot hardly moves")
    assert kinds(still, believed(BOTH_COLD, 1.5)) == []


def test_springs_above_the_limit_come_first() -> None:
    """Before everything else: with less current the robot must be filmed again anyway."""
    belief, seen = believed(BOTH_HOT), films(film(0, 1))
    peak = steady_peak(PARAMETERS["current"].at(SPRINGS, BOTH_HOT[0]))
    heat = believe_heat(belief, seen)
    used, _ = spring_strokes(belief, film(0, 1), SPRINGS.current_limit)
    assert heat.peak_c == pytest.approx(peak, abs=0.5)
    assert heat.stroke_used == pytest.approx(used.mean(), abs=1e-3)
    low, high = heat.peak_interval
    assert high - low == pytest.approx(2 * 1.96 * heat.peak_deviation_c)
    (fault,) = find_faults(2, seen, belief, peak - 1.0)
    assert (fault.run, fault.kind) == (2, "hot") and f"the film tells {peak:.0f} C" in fault.text
    assert fault.text.startswith("the springs may get hotter than") and low < peak - 1.0
    (sure,) = find_faults(2, seen, belief, low - 1.0)
    assert sure.text.startswith("the springs get hotter than")
    safe = find_safe_current(belief, seen, peak - 1.0, SPRINGS.current_limit)
    assert safe is not None and find_safe_current(belief, seen, peak - 1.0, 9.0, above_a=safe) is None
    assert f"lower the current limit to {safe:.2f} A" in fault.remedy and safe < SPRINGS.current_limit
    assert fault.lower_current_a == safe
    assert [keeps_limit(belief, seen, peak - 1.0, a) for a in (safe, safe + 0.05)] == [True, False]
    measured = SPRINGS.current_limit  # what the supply then gives
    at_file = steady_peak(replace(SPRINGS, current_limit=1.02 * measured))
    assert keeps_limit(belief, seen, at_file + 9.0, measured, 0.02), "1.64 x 5 K: the error of the model"
    assert not keeps_limit(belief, seen, at_file + 7.0, measured, 0.02)
    assert not find_faults(2, seen, belief, peak + 1.0)
    assert not find_faults(2, seen, replace(belief, misfit=1.5), peak - 1.0), "it explains nothing"


def test_springs_are_heated_in_the_air_that_was_measured() -> None:
    """The belief's air; the film's rig file has another one."""
    seen, cool = films(film(0, 1)), believed(BOTH_WORK)
    warm = replace(cool, nominal=replace(NOMINAL, springs=replace(SPRINGS, ambient=SPRINGS.ambient + 6.0)))
    assert believe_heat(warm, seen).peak_c > believe_heat(cool, seen).peak_c + 4.0


def steady_peak(springs: SpringParameters) -> float:
    """Highest temperature in the film, by the heat model alone [C]."""
    return float(HeatModel([springs] * 2).run(film(0, 1).contact_shares, INTERVAL).temperature.max())


def test_a_foot_that_stays_in_its_place_is_stuck_if_the_springs_move() -> None:
    positions = film(0, 1).tracked.positions.copy()
    heights = walker().morphology.positions[walker().marker_masses, 1]
    foot = int(heights.argmin())
    positions[..., 0] -= positions[:, foot : foot + 1, 0]
    positions[..., foot, 0] += 1e-4 * np.random.default_rng(3).standard_normal(len(positions))
    for belief in (believed(BOTH_WORK), believed(BOTH_COLD)):  # the latter, because the springs are held
        assert kinds(moved(film(0, 1), positions), belief) == ["stuck"]
    still = positions[:1] + 1e-4 * np.random.default_rng(4).standard_normal(positions.shape)
    assert kinds(moved(film(0, 1), still), believed(BOTH_WORK)) == ["cold"], "no foot can slip"


@pytest.mark.parametrize(
    ("share", "found"), [(0.1, []), (0.4, []), (0.6, ["stuck"])], ids=["a glimpse", "less than half", "more"]
)
def test_of_a_foot_that_was_hardly_seen_nothing_is_told(share: float, found: list[str]) -> None:
    """A foot that was covered for most of a cycle may have moved meanwhile."""
    positions, times = film(0, 1).tracked.positions.copy(), film(0, 1).tracked.times
    foot = int(walker().morphology.positions[walker().marker_masses, 1].argmin())
    positions[..., 0] -= positions[:, foot : foot + 1, 0]
    whole = film(0, 1)
    positions[times > whole.start + (1 + share) * whole.period, foot] = np.nan
    assert kinds(moved(whole, positions), believed(BOTH_WORK)) == found


def test_a_fall_is_told_with_its_time() -> None:
    positions, times = film(0, 1).tracked.positions.copy(), film(0, 1).tracked.times
    c, s = np.cos(1.2), np.sin(1.2)
    positions[times > 40.0] @= np.array([[c, s], [-s, c]])
    (fault,) = find_faults(1, films(moved(film(0, 1), positions)), believed(BOTH_WORK), LIMIT)
    assert fault.kind == "fall" and fault.text == "the robot falls at 40 s"


@pytest.mark.parametrize(("ratio", "found"), [(0.85, ["supply"]), (0.96, [])])
def test_a_supply_that_gives_too_little_is_measured(ratio: float, found: list[str]) -> None:
    current = ratio * float(RobotParameters().springs.current(0.0))
    readings = MeterReadings(current, 4.0, 0.01, 0.01, 5)
    assert kinds(film(0, 1), believed(BOTH_WORK), readings) == found


@pytest.mark.parametrize(("tolerance", "found"), [(0.02, ["supply"]), (0.05, []), (0.1, [])])
def test_a_supply_within_its_tolerance_is_not_weak(tolerance: float, found: list[str]) -> None:
    current = 0.945 * float(RobotParameters().springs.current(0.0))
    seen = films(film(0, 1), MeterReadings(current, 4.0, 0.01, 0.01, 5))
    faults = find_faults(1, seen, believed(BOTH_WORK), LIMIT, tolerance)
    assert [fault.kind for fault in faults] == found
