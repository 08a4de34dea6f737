"""Timing of springs, foreseen cycles, and gaits that are searched and imitated."""

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.ensembles import Ensemble, ensemble
from eldir.built.gait import CYCLES, Gait, free_lengths
from eldir.built.heat import HeatModel
from eldir.built.robot import BuiltParameters, build
from eldir.built.screening import displacements
from eldir.lattice import Lattice
from hardware.planning import plan as planning
from hardware.planning.compiler import compile_schedule
from hardware.planning.heat_preview import foresee, picture, told
from hardware.planning.timing import own_timing
from hardware.schedule_prediction import PredictedWalk, SchedulePrediction
from tests.eldir.test_design import make_design
from tests.hardware.test_schedule import gait, rig_with

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
    assert temperature.max() == pytest.approx(schedule.predicted.peak_c, abs=6)
    assert length.min() < 36 and length.max() > 74, "the whole stroke"
    walk = {"mean": 0.5, "spread": 0.1, "probability_forward": 1.0, "samples": 16, "fell": 0}
    more = {"cycle": cycle, "method": "search", "displacement": {"search": walk}}
    schedule = replace(schedule, predicted=SchedulePrediction.from_json(more))
    assert picture(schedule).startswith(b"\x89PNG")


def test_the_search_takes_what_walks_farthest_and_is_allowed(monkeypatch):
    """Judged by a stand-in: a second motor that heats late walks farther, unless it runs over the end."""
    design = make_design(3, Lattice(3, 6))

    def judge(robots, tables, cycles, springs):
        later = [np.argmax(t.temperatures[:, 1] > 30) - np.argmax(t.temperatures[:, 0] > 30) for t in tables]
        return np.array(later) / len(tables[0].lengths)

    def judge_alone(morphology, gait, *_, springs, **__):
        return Ensemble(judge(None, [free_lengths(gait, springs)], None, None))

    monkeypatch.setattr(planning, "displacements", judge)
    monkeypatch.setattr(planning, "ensemble", judge_alone)
    found = planning.searched_gait(design, RIG)
    assert isinstance(found, Gait) and found.phase[1] == pytest.approx(5 / 8)
    assert planning._allowed(found, RIG)
    weak = rig_with(supply={"budget_a": 8}, limits={"longest_on_s": 5.2})
    slower = planning.searched_gait(design, weak)
    assert planning._allowed(slower, weak), "6 s of heating are not allowed there"
    assert slower.duty[0] * slower.period <= 5.2 + 1e-6


def test_the_search_rejects_what_falls_in_other_builds(monkeypatch):
    """A real body: heated shortly the nominal robot goes farthest, and three of eight builds fall over."""
    design, rig = make_design(44, Lattice(3, 6)), rig_with(supply={"current_limit_a": 3.8})
    usual = Gait(20.0, np.array([0.0, 7 / 8]), np.array([0.3, 0.3]))
    tried = []

    def watched(morphology, gait, *arguments, **more):
        tried.append((gait, ensemble(morphology, gait, *arguments, **more)))
        return tried[-1][1]

    monkeypatch.setattr(planning, "candidate_gaits", lambda motors: [usual])
    monkeypatch.setattr(planning, "ensemble", watched)
    found = planning.searched_gait(design, rig)
    springs = rig.spring_parameters()
    robot, free = build(design.morphology, BuiltParameters()), (springs.cold_length, springs.hot_length)
    nominal = [displacements([robot], [free_lengths(g, springs)], CYCLES, free)[0] for g, _ in tried]
    fastest, builds = tried[int(np.argmax(nominal))]
    assert builds.fallen > 0.3 and found is not fastest
    chosen = next(walks for gait, walks in tried if gait is found)
    assert chosen.fallen < builds.fallen and chosen.expected > 1.2 * builds.expected


def test_how_many_fall_is_told(monkeypatch):
    """In the file, the picture's title and the printed line: the mean is only of builds that stand."""
    design = make_design(44, Lattice(3, 6))
    walks = Ensemble(np.array([0.6, 1.0, -0.2, -np.inf]))
    monkeypatch.setattr(planning, "ensemble", lambda *_, **__: walks)
    walk = planning._told(gait(), planning._walks(design, gait(), RIG, 0, 4, None))
    assert (walk["builds"], walk["fell"], walk["mean"]) == (4, 1, pytest.approx(1.4 / 3, abs=1e-6))
    assert told(PredictedWalk.from_json(walk)) == (
        "+0.47 +- 0.61 body lengths per five cycles where it stands",
        "of 4 builds 1 fall over or fold, 50% go forward",
    )
    assert told(PredictedWalk(samples=4)) == ("falls over, or folds until parts touch", "all of 4 builds")
