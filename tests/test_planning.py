"""Timing of springs, foreseen cycles, and gaits that are searched and imitated."""

import numpy as np
import pytest

from eldir.gait import Gait
from eldir.lattice import Lattice
from eldir.sma import HeatModel
from hardware import planning
from hardware.compiler import compile_schedule
from hardware.foresight import foresee, picture
from hardware.timing import own_timing

from .test_design import make_design
from .test_schedule import gait, rig_with

RIG = rig_with()


@pytest.mark.parametrize("current", [4.0, 3.5])
def test_the_own_timing_uses_the_whole_stroke(current):
    """A spring that keeps it passes Af and comes back below Mf, cycle after cycle."""
    rig = rig_with(supply={"current_limit_a": current}, limits={"longest_on_s": 6.2})
    springs = rig.spring_parameters()
    period, duty = own_timing(springs, rig, 2)
    t = np.arange(round(4 * period / 0.05)) * 0.05
    history = HeatModel([springs]).run((t % period < duty * period)[:, None], 0.05)
    last = history.temperature[t >= 3 * period, 0]
    assert last.max() > springs.austenite_finish and last.min() < springs.martensite_finish
    assert 10 < period < 30


def test_the_current_budget_lengthens_the_period():
    """Four springs of 4 A: all at once with 16 A, one after another with 4."""
    springs = RIG.spring_parameters()
    free, _ = own_timing(springs, RIG, 2)
    bound, duty = own_timing(springs, rig_with(supply={"budget_a": 4}), 2)
    assert bound >= free and bound >= 4 * duty * bound * 0.999


def test_a_foreseen_cycle_is_what_the_schedule_does():
    schedule = compile_schedule(gait(), RIG)
    cycle = foresee(schedule, RIG)
    assert cycle["channels"] == [1, 2, 3, 4] and len(cycle["t_s"]) == 40
    temperature, length = np.array(cycle["temperature_c"]), np.array(cycle["length_mm"])
    assert temperature.shape == length.shape == (4, 40)
    assert np.allclose(temperature[0], np.roll(temperature[2], -20), atol=0.3), "half a period later"
    assert temperature.max() == pytest.approx(schedule.predicted["peak_c"], abs=6)
    assert length.min() < 36 and length.max() > 74, "the whole stroke"
    walk = {"mean": 0.5, "spread": 0.1, "probability_forward": 1.0}
    schedule.predicted.update(cycle=cycle, method="search", displacement={"search": walk})
    assert picture(schedule).startswith(b"\x89PNG")


def test_the_search_takes_what_walks_farthest_and_is_allowed(monkeypatch):
    """Judged by a stand-in: a second motor that heats late walks farther, unless it runs over the end."""
    design = make_design(3, Lattice(3, 6))

    def judge(robots, tables, cycles, springs):
        later = [np.argmax(t.temperatures[:, 1] > 30) - np.argmax(t.temperatures[:, 0] > 30) for t in tables]
        return np.array(later) / len(tables[0].lengths)

    monkeypatch.setattr(planning, "displacements", judge)
    found = planning.searched_gait(design, RIG)
    assert isinstance(found, Gait) and found.phase[1] == pytest.approx(5 / 8)
    assert planning._allowed(found, RIG)
    weak = rig_with(supply={"budget_a": 8}, limits={"longest_on_s": 5.2})
    slower = planning.searched_gait(design, weak)
    assert planning._allowed(slower, weak), "6 s of heating are not allowed there"
    assert slower.duty[0] * slower.period <= 5.2 + 1e-6
