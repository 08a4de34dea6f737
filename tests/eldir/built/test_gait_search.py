"""Gaits are searched within a rig's limits, for the nominal robot and for one that was filmed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built import gait_search, samples
from eldir.built.gait import Gait, free_lengths
from eldir.built.gait_search import find_gait, search_gait, search_robust_gait
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, SampledWalks, sample_walks, simulate_most_probable
from eldir.built.screening import candidate_gaits
from eldir.built.walking import walk
from eldir.design import Design
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir_hardware.planning.plan import heating_limits
from tests.calibration.dynamics.hidden_rigs import SOFT
from tests.eldir.built.filmed_scenes import film, scene_of
from tests.eldir.built.robots_alike import NO_ERRORS
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

LIMITS = heating_limits(rig_with())


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(10, Lattice(3, 6))


def test_the_search_takes_what_walks_farthest_and_is_allowed(monkeypatch):
    """Judged by a stand-in: a second motor that heats late walks farther, unless it runs over the end."""
    design = make_design(3, Lattice(3, 6))

    def judge(gaits, springs):
        tables = [free_lengths(gait, springs) for gait in gaits]
        later = [np.argmax(t.temperatures[:, 1] > 30) - np.argmax(t.temperatures[:, 0] > 30) for t in tables]
        return np.array(later) / len(tables[0].lengths)

    monkeypatch.setattr(
        gait_search,
        "simulate_most_probable",
        lambda robots, gaits, **quick: judge(gaits, robots.robot.springs),
    )
    monkeypatch.setattr(
        gait_search,
        "sample_walks",
        lambda robots, gaits, *_, **quick: [
            SampledWalks(np.array([x])) for x in [judge([g], robots.robot.springs)[0] for g in gaits]
        ],
    )
    found = search_gait(design, LIMITS)
    assert isinstance(found, Gait) and found.phase[1] == pytest.approx(9 / 12)
    assert LIMITS.allowed(found)
    weak = heating_limits(rig_with(supply={"max_total_current_a": 8}, limits={"max_on_s": 5.2}))
    slower = search_gait(design, weak)
    assert weak.allowed(slower), "6 s of heating are not allowed there"
    assert slower.duty[0] * slower.period <= 5.2 + 1e-6
    shown = [found]
    for _ in range(2):
        other = find_gait(design, LIMITS, other_than=shown, samples=2)
        assert LIMITS.allowed(other.gait) and not any(other.gait.is_near(gait) for gait in shown)
        shown.append(other.gait)


def test_gaits_are_near_by_what_a_film_shows():
    """Phases count relative to the first motor and around the period."""
    one = Gait(30.0, np.array([0.0, 0.95]), np.array([0.2, 0.2]))
    later = replace(one, phase=np.array([0.5, 0.45]))
    assert one.is_near(one) and one.is_near(later)
    assert one.is_near(replace(one, phase=np.array([0.0, 0.04])))
    assert not one.is_near(replace(one, phase=np.array([0.0, 0.06])))
    for period, heating, near in (
        (32.0, 6.0, True),
        (34.0, 6.0, False),
        (30.0, 5.2, False),
        (30.0, 6.5, True),
    ):
        other = Gait(period, one.phase, np.full(2, heating / period))
        assert one.is_near(other) == other.is_near(one) == near, (period, heating)


def test_where_the_rig_allows_no_other_gait_it_is_said(design: Design):
    one = candidate_gaits(design.morphology.motors)[0]
    alone = replace(LIMITS, allowed=one.is_near)
    with raises(InputError, "gait.no-other"):
        find_gait(design, alone, other_than=[one], samples=2)


def test_the_search_rejects_what_falls_in_other_builds(monkeypatch):
    """A real body: heated shortly the nominal robot goes farthest, and three of eight builds fall over, if
    they have pins."""
    monkeypatch.setattr(BuiltParameters, "with_hubs", lambda pinned: pinned)
    monkeypatch.setattr(gait_search, "_CYCLES", 2)
    design = make_design(44, Lattice(3, 6))
    known = {
        "current": 0.01,
        "ambient_max_c": 22,
        "convection_tolerance": 0.02,
    }  # so that the rig allows 6 s in 20
    limits = heating_limits(
        rig_with(supply={"current_limit_a": 3.8}, springs={"resistance_tolerance": 0.01}, tolerances=known)
    )
    limits = replace(limits, tolerances=NO_ERRORS)
    usual = Gait(20.0, np.array([0.0, 7 / 8]), np.array([0.3, 0.3]))
    tried = []

    def watched(robots, gaits, *arguments, **quick):
        found = sample_walks(robots, gaits, *arguments, **quick)
        tried.extend(zip(gaits, found, strict=True))
        return found

    monkeypatch.setattr(gait_search, "candidate_gaits", lambda motors: [usual])
    monkeypatch.setattr(gait_search, "sample_walks", watched)
    found = search_gait(design, limits)
    robot = build(design.morphology)
    nominal = walk([robot] * len(tried), [gait for gait, _ in tried], limits.springs, cycles=2)
    fastest, of_fastest = tried[int(np.argmax(nominal))]
    assert of_fastest.fallen > 0.3 and found is not fastest
    chosen = next(walks for gait, walks in tried if gait is found)
    assert chosen.fallen < of_fastest.fallen and chosen.expected > 1.2 * of_fastest.expected


def test_what_falls_in_the_filmed_robots_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """A body whose hot springs are longer than drawn: what carries the nominal one farthest topples it."""
    monkeypatch.setattr(samples, "CYCLES", 1)
    monkeypatch.setattr(gait_search, "_SAMPLES", 3)
    design, phases = make_design(10, Lattice(3, 6)), candidate_gaits(2)[::2]
    monkeypatch.setattr(gait_search, "candidate_gaits", lambda motors: phases)
    scene = scene_of(design, robot=SOFT.at(["hot_length"], [2.0]), spread=0.3)
    tried: list[tuple[Gait, SampledWalks]] = []

    def watched(
        robots: IdentifiedRobots, gaits: list[Gait], *arguments: int, coarse: bool
    ) -> list[SampledWalks]:
        found = sample_walks(robots, gaits, *arguments, coarse=coarse)
        tried.extend(zip(gaits, found, strict=True))
        return found

    monkeypatch.setattr(gait_search, "sample_walks", watched)
    found = search_robust_gait(IdentifiedRobots.of(design, scene), LIMITS)
    nominal = simulate_most_probable(IdentifiedRobots.of(design, scene_of(design)), phases)
    fastest = phases[int(nominal.argmax())]
    assert nominal.max() > 0.05
    assert next(walks for gait, walks in tried if gait is fastest).fallen > 0.5
    assert found is not fastest
    chosen = next(walks for gait, walks in tried if gait is found)
    assert chosen.fallen == 0 and chosen.expected > 0
    assert len({g.period for g, _ in tried}) == 3 and len({round(g.duty[0], 3) for g, _ in tried}) > 2


def test_neither_the_robot_itself_nor_those_around_it_may_fall(
    design: Design, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by stand-ins: of four phases one walks far in the robot itself and one in those around it."""
    phases = candidate_gaits(2)[:4]
    drawn, itself = [0.1, 2.0, 0.4, 0.5], [2.0, -np.inf, 0.5, 0.3]
    monkeypatch.setattr(gait_search, "candidate_gaits", lambda motors: phases)
    monkeypatch.setattr(gait_search, "_retime", lambda *_: [])
    monkeypatch.setattr(
        gait_search, "sample_walks", lambda *_, coarse: [SampledWalks(np.array([x])) for x in drawn]
    )
    monkeypatch.setattr(gait_search, "simulate_most_probable", lambda *_, coarse: np.array(itself))
    robots = IdentifiedRobots.of(design, scene_of(design))
    assert search_robust_gait(robots, LIMITS) is phases[2]
    assert search_robust_gait(robots, LIMITS, [film(0.4, phases[2])]) is phases[3]


def test_walks_are_predicted_gait_by_gait_and_each_is_announced() -> None:
    """In slow springs each takes a minute or more; the numbers are those of all gaits together."""
    design, gaits, told = make_design(3, Lattice(3, 6)), candidate_gaits(2)[:2], []
    robots = gait_search.nominal_robots(design, LIMITS)
    quick = {"cycles": 1, "coarse": True}
    found = gait_search.sample_walks_in_turn(robots, gaits, 2, 1, told.append, "predicting", **quick)
    together = sample_walks(robots, gaits, 2, 1, **quick)
    assert [f.displacement.tobytes() for f in found] == [w.displacement.tobytes() for w in together]
    assert told == [f"predicting: gait {i} of 2, {gaits[0].period:g} s a cycle" for i in (1, 2)]
