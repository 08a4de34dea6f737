"""Timing of springs, predicted cycles, and what a schedule says about its walk."""

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import HeatModel
from eldir.built.samples import SampledWalks
from eldir.lattice import Lattice
from eldir_hardware.planning import plan as planning
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import (
    describe_walk,
    draw_heat,
    find_timing,
    predict_cycle,
)
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.schedule import PredictedWalk, SchedulePrediction
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import gait, rig_with
from tests.raised import raises

RIG = rig_with()


@pytest.mark.parametrize(("current", "longest"), [(3.45, 6.0), (3.3, 8.0)])
def test_the_own_timing_uses_the_stroke_that_the_worst_corner_leaves(current, longest):
    """Nominal springs come within 3 K of Af, where a twentieth of the stroke is left, and below Mf again."""
    rig = rig_with(
        supply={"current_limit_a": current},
        limits={"max_on_s": longest},
        cutoff={"max_on_s": longest + 0.2},
    )
    springs = rig.spring_parameters()
    period, duty = find_timing(springs, rig, 2)
    t = np.arange(round(4 * period / 0.05)) * 0.05
    history = HeatModel([springs]).run((t % period < duty * period)[:, None], 0.05)
    last, fraction = (x[t >= 3 * period, 0] for x in (history.temperature, history.martensite))
    assert last.max() > springs.austenite_finish - 3 and last.min() < springs.martensite_finish
    assert np.ptp(fraction) > 0.9
    assert 10 < period < 40


def test_springs_that_cool_for_minutes_are_refused_at_once():
    """Thick wire in still air: the search would simulate hours of walking."""
    rig = rig_with(
        fan=None,
        springs={"wire_diameter_mm": 3.0, "coil_diameter_mm": 12.0, "resistance_ohm": 0.1139},
        supply={"current_limit_a": 9.0, "max_total_current_a": 40},
        limits={"max_on_s": 60.0, "duty": 1.0},
        cutoff={"max_on_s": 60.2},
    )
    with raises(LimitError, "limit.slow-springs", match="at most 120 s; found [0-9]+ s .*fan"):
        planning.plan(make_design(3, Lattice(3, 6)), rig)


def test_the_current_budget_lengthens_the_period():
    """Four springs of 4 A: all at once with 16 A, one after another with 4."""
    springs = RIG.spring_parameters()
    free, _ = find_timing(springs, RIG, 2)
    bound, duty = find_timing(springs, rig_with(supply={"max_total_current_a": 4}), 2)
    assert bound >= free and bound >= 4 * duty * bound * 0.999


def test_a_predicted_cycle_is_what_the_schedule_does():
    schedule = compile_schedule(gait(), RIG)
    cycle = predict_cycle(schedule, RIG)
    assert cycle.channels == (1, 2, 3, 4) and len(cycle.t_s) == 40
    temperature, length = np.array(cycle.temperature_c), np.array(cycle.length_mm)
    assert temperature.shape == length.shape == (4, 40)
    assert np.allclose(temperature[0], np.roll(temperature[2], -20), atol=0.3), "half a period later"
    assert 54 < temperature.max() < schedule.predicted.peak_c - 20, "of a nominal spring"
    assert length.min() < 36 and length.max() > 67, "most of the stroke"
    walk = {"mean": 0.5, "spread": 0.1, "probability_forward": 1.0, "samples": 16, "fell": 0}
    more = {"cycle": cycle.to_json(), "method": "search", "displacement": {"search": walk}}
    schedule = replace(schedule, predicted=SchedulePrediction.from_json(more))
    assert draw_heat(schedule).startswith(b"\x89PNG")


def test_how_many_fall_is_said():
    """In the file, the picture's title and the printed line: the mean is only of builds that stand."""
    walks = SampledWalks(np.array([0.6, 1.0, -0.2, -np.inf]))
    walk = planning._predicted_walk(gait(), walks)
    assert (walk.samples, walk.fell, walk.mean) == (4, 1, pytest.approx(1.4 / 3, abs=1e-6))
    assert describe_walk(walk) == (
        "+0.47 body lengths per five cycles, -2.57 to +3.50 for 95 % of robots that stand",
        "of 4 sampled robots 1 fall over or fold, 50% go forward",
    )
    fallen = ("falls over, folds until parts touch, or buckles a coil", "all of 4 sampled robots")
    older = PredictedWalk.from_json({"mean": None, "builds": 4})
    assert describe_walk(PredictedWalk(samples=4)) == describe_walk(older) == fallen
