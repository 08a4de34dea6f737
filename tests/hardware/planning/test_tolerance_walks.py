"""Walks at the ends of a rig's tolerances, and what narrower tolerances allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from eldir.benchmark.built import walkers
from eldir.built import samples
from eldir.built.gait import free_lengths
from eldir.built.robot import build
from eldir.built.samples import NominalRobots
from eldir.built.walking import displacements
from eldir.core.records import FloatArray
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.terrain import Terrain
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.tolerance_walks import (
    describe_narrower,
    describe_tolerances,
    simulate_narrower,
    simulate_tolerances,
)
from eldir_hardware.schedule import NarrowerTolerances, SchedulePrediction, ToleranceWalks
from tests.hardware.rigs_and_schedules import rig_with

RIG = rig_with()


def test_walks_at_the_ends_of_the_tolerances() -> None:
    """Each end with its springs written out; a robot that lost half of its walk is not told as a good one."""
    robot, nominal = walkers()[0], RIG.spring_parameters()
    hubs = BuiltParameters().with_hubs()
    robots = NominalRobots(robot.body, RobotParameters(hubs, nominal))
    found = simulate_tolerances(robots, robot.gait, RIG)

    def walk_with(ends: Sequence[tuple[float, ...]]) -> FloatArray:
        """Walks with these multiples of current and air, air temperatures [C] and current limits [A]."""
        springs = [
            replace(
                nominal,
                current_limit=ampere * current,
                supply_voltage=11.0 * current,
                convection_fan=150.0 * air,
                ambient=ambient,
            )
            for current, air, ambient, ampere in ends
        ]
        tables = [free_lengths(robot.gait, one, 5, hubs=robot.body.motor_hubs) for one in springs]
        built = [build(robot.body, RobotParameters(hubs, one)).coarse() for one in springs]
        return displacements(built, tables, 5, (nominal.cold_length, nominal.hot_length))

    ends = {
        found.nominal: (1, 1, 22, 3.45),
        found.current[0]: (0.95, 1, 22, 3.45),
        found.current[1]: (1.05, 1, 22, 3.45),
        found.convection[0]: (1, 0.9, 22, 3.45),
        found.convection[1]: (1, 1.1, 22, 3.45),
        found.room[0]: (1, 1, 18, 3.45),
        found.room[1]: (1, 1, 30, 3.45),
        found.coldest: (0.95, 1.1, 18, 3.45),
    }
    assert found.coldest < found.nominal / 2
    measured = simulate_narrower(robots, robot.gait, compile_schedule(robot.gait, RIG), RIG)
    assert [(m.current, m.ambient_min_c, m.ambient_max_c) for m in measured] == [
        (0.02, 18, 30),
        (0.05, 19, 25),
        (0.02, 19, 25),
    ]
    assert found.coldest < min(m.coldest for m in measured) and measured[2].coldest > found.nominal / 2
    ends |= {m.coldest: (1 - m.current, 1.1, m.ambient_min_c, m.current_limit_a) for m in measured[::2]}
    assert len(ends) == 10
    assert list(ends) == pytest.approx(walk_with([*ends.values()]), abs=1e-5)


STEP = Terrain(np.array([-1.0, 0.06, 0.12]), np.array([0.0, 0.1, 0.0]), np.array([0.0, -0.006, 0.006]))


@pytest.mark.parametrize("ground", [None, STEP], ids=["table", "step"])
def test_robots_are_coarse_on_a_table_alone(ground: Terrain | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terrain coarse robots walk otherwise."""
    monkeypatch.setattr(samples, "CYCLES", 1)
    robot, parameters = walkers()[0], RobotParameters(springs=RIG.spring_parameters())
    found = simulate_tolerances(NominalRobots(robot.body, parameters, terrain=ground), robot.gait, RIG)
    whole = build(robot.body, parameters)
    table = free_lengths(robot.gait, parameters.springs, 1)
    exact, coarse = (
        float(displacements([one], [table], 1, parameters.free_lengths, terrain=ground)[0])
        for one in (whole, whole.coarse())
    )
    assert abs(exact - coarse) > 2e-5
    assert found.nominal == pytest.approx(coarse if ground is None else exact, abs=1e-6)


def test_the_tolerances_of_a_walk_in_one_line() -> None:
    walks = ToleranceWalks(1.5, (0.9, 1.7), (1.6, 1.2), (1.1, None), 0.4)
    assert describe_tolerances(walks, RIG) == (
        "walk at the ends of the rig file's tolerances: current -5%: +0.90, +5%: +1.70; "
        "cooling -10%: +1.60, +10%: +1.20; air 18 C: +1.10, 30 C: falls; "
        "least current, most cooling and coldest air together: +0.40; with the file's values: +1.50"
    )
    assert ToleranceWalks.from_json(walks.to_json()) == walks


def test_what_measured_values_allow_in_lines() -> None:
    choices = (
        NarrowerTolerances(0.02, 18.0, 30.0, 3.7, 0.72, 1.26),
        NarrowerTolerances(0.02, 19.0, 25.0, 3.9, 0.97, None),
    )
    assert describe_narrower((), RIG) == []
    heading, *lines = describe_narrower(choices, RIG)
    assert "higher current limit" in heading
    assert lines == [
        "  if the current is known to 2%: 3.70 A; coldest corner: +1.26, 72% of the stroke",
        "  if the current is known to 2% and the air has 19 to 25 C: 3.90 A; coldest corner: falls, "
        "97% of the stroke",
    ]
    prediction = SchedulePrediction(narrower=choices)
    assert SchedulePrediction.from_json(prediction.to_json()) == prediction
    assert "narrower" not in SchedulePrediction().to_json()
