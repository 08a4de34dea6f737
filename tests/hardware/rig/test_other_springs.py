"""A rig file with other springs than the kit's: everything that predicts or moves a robot takes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built.robot import build
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_app.application import application
from eldir_calibration.adaptation.films import nominal_robot
from eldir_calibration.transfer.compared_walks import load_walking_design
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError
from eldir_hardware.rig.template import real_rig
from eldir_hardware.virtual.biplane_body import sample_biplane
from eldir_hardware.virtual.bodies import EngineBody, far_robot
from eldir_hardware.virtual.mujoco_body import sample_multibody
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

SOFT = {"wire_diameter_mm": 0.7, "coil_diameter_mm": 7.5, "turns": 24.0, "resistance_ohm": 1.18}
BODY = make_design(3, Lattice(3, 6)).morphology
PER_COIL = (0.7 / 0.75) ** 4 * (6.5 / 7.5) ** 3 * 26.7 / 24.0
"""Stiffness of these coils over the kit's: d^4 / (D^3 n)."""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_with(springs=SOFT, supply={"current_limit_a": 3.0})


def test_stiffness_and_mass_are_those_of_the_coil(rig: Rig) -> None:
    robot = rig.nominal_robot()
    for modulus, stiffness in ((9e9, robot.printed.cold_stiffness), (23e9, robot.printed.hot_stiffness)):
        assert stiffness == pytest.approx(modulus * 0.7e-3**4 / (8 * 7.5e-3**3 * 24), rel=0.02)
    wires = [
        6450 * np.pi / 4 * d**2 * np.pi * coil * n
        for d, coil, n in ((0.7e-3, 7.5e-3, 24), (0.75e-3, 6.5e-3, 26.7))
    ]
    lighter = BuiltParameters().active_spring - robot.printed.active_spring
    assert lighter == pytest.approx(wires[1] - wires[0], rel=0.02)


def test_the_kits_springs_change_no_digit() -> None:
    assert rig_with().nominal_robot().printed == BuiltParameters()
    assert RobotParameters.nominal(SpringParameters(), BuiltParameters().with_hubs()) == RobotParameters(
        BuiltParameters().with_hubs()
    )


def test_all_that_predicts_takes_them(rig: Rig, tmp_path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_bytes(rig.source)
    for printed in (
        rig.nominal_robot().printed,
        nominal_robot(rig).printed,
        make_workshop(file).printed,
        RobotParameters.nominal(heating_limits(rig).springs).printed,
    ):
        assert printed.hot_stiffness / 124.0 == pytest.approx(PER_COIL)


def test_virtual_robots_have_them(rig: Rig) -> None:
    springs, kit, seed = rig.spring_parameters(), SpringParameters(), 5
    for sample in (sample_multibody, lambda *a, **k: sample_biplane(*a, **k).plane):
        own, usual = (sample(BODY, seed, springs=s) for s in (springs, kit))
        for coil, other in zip(own.coils, usual.coils, strict=True):
            np.testing.assert_allclose(coil.stiffness, PER_COIL * np.array(other.stiffness), rtol=1e-12)
    own, usual = (EngineBody(BODY, seed, s)._robot for s in (springs, kit))
    active = BODY.active
    np.testing.assert_allclose(own.stiffness[active], PER_COIL * usual.stiffness[active], rtol=1e-12)
    np.testing.assert_array_equal(own.stiffness[~active], usual.stiffness[~active])
    far, near_kit = (far_robot(r) for r in (rig, rig_with()))
    assert far.printed.hot_stiffness / near_kit.printed.hot_stiffness == pytest.approx(PER_COIL)


def test_a_wider_coil_buckles_later() -> None:
    wide = replace(SpringParameters(), coil_diameter=9e-3)
    robot = build(BODY, RobotParameters.nominal(wide))
    assert robot.coil == wide and build(BODY).coil == SpringParameters()
    length = np.array(0.068)
    assert wide.buckling_shortening(length) > 1.5 * SpringParameters().buckling_shortening(length)


@pytest.mark.parametrize("command", ["transfer", "export"])
def test_nothing_is_predicted_for_a_supply_that_was_not_measured(tmp_path: Path, command: str) -> None:
    """A new rig file of a real board: it was simulated with a million amperes."""
    make_design(3, Lattice(3, 6)).save(tmp_path / "design.json")
    (tmp_path / "rig.yaml").write_text(real_rig("lcus", "/dev/ttyUSB0"))
    out = tmp_path / ("robot.xml" if command == "export" else "out")
    given = [command, str(tmp_path / "design.json"), "--rig", str(tmp_path / "rig.yaml"), "--out", str(out)]
    with raises(LimitError, "limit.not-measured", "springs.resistance_ohm"):
        CliRunner().invoke(application(command), given, catch_exceptions=False)
    assert not out.exists()


def test_transfer_looks_for_a_gait_with_the_springs_of_the_rig(tmp_path: Path) -> None:
    """With a fifth of the stiffness this body buckles its coils in every phase."""
    weak = replace(SpringParameters(), wire_diameter=0.5e-3, turns=30.0, current_limit=1.8)
    design = make_design(3, Lattice(3, 6))
    design.save(tmp_path / "design.json")
    with raises(InputError, "design.no-walk"):
        load_walking_design(str(tmp_path / "design.json"), weak, lambda _: None)
