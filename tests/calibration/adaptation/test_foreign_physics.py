"""The physics that the benchmark of foreign rigs adds to a virtual rig is the one it names."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.foreign_physics import (
    AT_REST,
    BACK_COOLING,
    COIL_PLAY,
    DRIFT,
    DRIFT_TIME,
    PHYSICS,
    SLIDING,
    DriftingResistance,
    LooseCoils,
    StribeckFriction,
    UnevenCooling,
)
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_hardware.run import drive
from eldir_hardware.virtual import bodies
from eldir_hardware.virtual.mujoco_body import MujocoMotion, sample_multibody
from eldir_hardware.virtual.rig import VirtualRig
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston

pytest.importorskip("mujoco")  # installed with the extra `test`
BODY = make_design(3, Lattice(3, 6)).morphology
FREE = SpringParameters.cold_length, SpringParameters.hot_length


def follow(motion: MujocoMotion, time: float) -> None:
    """Stand with cold coils for some time [s]."""
    motion.follow(np.full((round(time / 0.05) + 1, BODY.motors), FREE[0]), 0.05)


def test_a_coil_with_play_yields_without_force_and_then_as_any_other():
    tight, loose = (kind(sample_multibody(BODY, 4), FREE) for kind in (MujocoMotion, LooseCoils))
    for change in (-2e-3, -0.4e-3, 0.4e-3, 2e-3):
        wanted = loose.coil_lengths + change
        stiffness = np.full(BODY.motors, 50.0)
        taken_up = np.sign(change) * max(0.0, abs(change) - COIL_PLAY / 2)
        loose._command(wanted, stiffness)
        tight._command(tight.coil_lengths + taken_up, stiffness)
        np.testing.assert_allclose(loose.data.ctrl, tight.data.ctrl, atol=1e-12)


def test_a_foot_holds_better_at_rest():
    motion = StribeckFriction(sample_multibody(BODY, 4), FREE)
    nominal = MujocoMotion(sample_multibody(BODY, 4), FREE)._friction
    follow(motion, 1.0)
    motion.data.qvel[:] = 0.0
    for speed, factor in ((0.0, AT_REST), (0.1, SLIDING), (-0.1, SLIDING)):
        motion.data.qvel.reshape(len(nominal), -1)[:, 0] = speed
        motion._command(motion.coil_lengths, np.full(BODY.motors, 50.0))
        np.testing.assert_allclose(motion.model.geom_friction[motion._feet, 0], factor * nominal, rtol=1e-6)


def test_resistance_grows_from_power_on_whatever_the_rate_of_pictures():
    grown = []
    for instants in ([DRIFT_TIME], np.linspace(0.5, DRIFT_TIME, 40)):
        with DriftingResistance(rig_with(), Piston()) as rig:
            before = np.array([s.resistance for s in rig.springs.parameters])
            start = rig.clock.now()
            for t in instants:
                rig.frame(start + t)
            grown.append(np.array([s.resistance for s in rig.springs.parameters]) / before - 1)
    np.testing.assert_allclose(grown[0], grown[1], rtol=1e-9)
    assert (grown[0] >= DRIFT[0]).all() and (grown[0] <= DRIFT[1]).all() and np.ptp(grown[0]) > 0.01


@pytest.mark.parametrize("spread", [0.0, 0.2])
def test_the_back_face_is_cooled_less_and_each_spring_otherwise(monkeypatch, spread):
    monkeypatch.setattr("benchmarks.foreign_physics.COOLING_SPREAD", spread)
    rig = rig_with()
    with VirtualRig(rig, Piston()) as even, UnevenCooling(rig, Piston()) as uneven:
        ratio = np.array(
            [
                b.convection_fan / a.convection_fan
                for a, b in zip(even.springs.parameters, uneven.springs.parameters, strict=True)
            ]
        )
    faces = np.array([face for entry in rig.channels for face in entry.faces])
    own = ratio / np.where(faces == "back", BACK_COOLING, 1.0)
    assert np.ptp(own) == pytest.approx(0.0, abs=1e-12) if spread == 0.0 else np.ptp(own) > 0.1


def test_a_rig_has_it_only_while_it_is_asked_for():
    for physics in PHYSICS.values():
        with physics.active():
            assert bodies.virtual_body is physics.body and drive.VirtualRig is physics.rig
        assert drive.VirtualRig is VirtualRig and bodies.virtual_body.__module__ == bodies.__name__
