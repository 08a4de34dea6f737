"""A scene from films on another rig: its robots have the supply and the air of that rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait
from eldir.built.samples import IdentifiedRobots
from eldir.built.scene import PrintedScene
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_calibration.comparison.predictions import predict_body
from eldir_calibration.comparison.recorded_run import MeasuredConditions, RecordedRun
from eldir_hardware.planning import plan as planning
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.rig.configuration import Rig
from tests.calibration.adaptation.short_adaptation import make_walker
from tests.eldir.built.filmed_scenes import film
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

NAMES, Z = ("current", "friction", "hot_length"), np.array([0.4, -0.2, 0.3])
DESIGN = make_walker()
GAIT = Gait(30.0, np.array([0.0, 0.5]), np.full(2, 0.2))


def make_scene(rig: Rig) -> PrintedScene:
    """As `eldir calibrate dynamics` writes it for films of a robot on this rig."""
    robot = rig.nominal_robot().at(NAMES, Z)
    scene = PrintedScene.of(robot, NAMES, 0.01 * np.eye(3), Z)
    return replace(scene, body=DESIGN.body, filmed_gaits=(film(0.5, GAIT),))


@pytest.fixture(scope="module")
def scene() -> PrintedScene:
    return make_scene(rig_with(supply={"current_limit_a": 3.6}))


def test_its_current_is_relative_to_that_of_the_rig(scene: PrintedScene) -> None:
    """exp(0.25 z) times the nominal one: the prior's spread is a quarter."""
    weak = rig_with(supply={"current_limit_a": 2.8, "voltage_v": 9.0}, springs={"ambient_c": 25.0})
    moved = scene.on_rig(weak.spring_parameters())
    assert moved.springs.current_limit == pytest.approx(2.8 * np.exp(0.1))
    assert moved.springs.supply_voltage == pytest.approx(9.0 * np.exp(0.1))
    assert moved.springs.ambient == 25.0 and moved.springs.hot_length == scene.springs.hot_length
    assert moved.filmed_gaits == () and moved.built == scene.built


def test_with_the_rig_of_the_films_it_stays(scene: PrintedScene) -> None:
    own = rig_with(supply={"current_limit_a": 3.6}).spring_parameters()
    assert scene.on_rig(own) is scene
    assert PrintedScene.from_json(scene.to_json()).on_rig(own) == scene
    rounded = replace(scene, z=scene.z * (1 + 4e-7))
    assert rounded.on_rig(own) is rounded, "files have z to six digits"
    warm = scene.on_rig(replace(own, ambient=25.0))
    assert (
        warm.filmed_gaits == scene.filmed_gaits and warm.springs.current_limit == scene.springs.current_limit
    )
    unknown = PrintedScene.of(RobotParameters(), (), np.zeros((0, 0)))
    assert unknown.on_rig(own) is unknown


@pytest.mark.parametrize(
    ("changes", "found"),
    [({"wire_diameter": 0.7e-3}, "wire_diameter"), ({"fan": False}, "fan"), ({"cold_length": 0.03}, "cold")],
)
def test_other_springs_are_refused(scene: PrintedScene, changes: dict[str, float], found: str) -> None:
    own = rig_with(supply={"current_limit_a": 3.6}).spring_parameters()
    with raises(InputError, "scene.other-springs", match=f"another {found}.*identify"):
        scene.on_rig(replace(own, **changes))


def test_a_gait_is_searched_with_the_supply_of_the_rig_file(
    scene: PrintedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    class SearchBeganError(Exception):
        pass

    def find_gait(design: Design, limits: object, *, scene: PrintedScene, **_: object) -> None:
        raise SearchBeganError(IdentifiedRobots.of(design, scene).robot.springs.current_limit)

    monkeypatch.setattr(planning, "find_gait", find_gait)
    for current in (2.8, 3.6):
        with pytest.raises(SearchBeganError) as caught:
            plan(DESIGN, rig_with(supply={"current_limit_a": current}), PlanConfig(scene=scene))
        assert caught.value.args[0] == pytest.approx(current * np.exp(0.1))


def test_a_log_is_predicted_with_its_own_supply_and_air(scene: PrintedScene) -> None:
    """As with the scene that films on that rig, in that air, would give."""
    rig = rig_with(supply={"current_limit_a": 2.8})
    springs = tuple(np.flatnonzero(DESIGN.morphology.active).tolist())
    run = RecordedRun(DESIGN, compile_schedule(GAIT, rig, springs, cycles=1), rig, MeasuredConditions(25.0))
    own = make_scene(rig_with(supply={"current_limit_a": 2.8}, springs={"ambient_c": 25.0}))
    found, expected = (predict_body(run, one).positions for one in (scene, own))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    usual = predict_body(replace(run, measured=MeasuredConditions()), scene).positions
    assert np.abs(found - usual).max() > 1e-4, "the air counts"
    assert isinstance(run.on_rig(scene).springs, SpringParameters)
