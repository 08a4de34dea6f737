"""Springs that share the current of one output: whatever predicts or moves a robot divides the current.

Where the springs of one motor heat at a time, one on each face, a shared output is two outputs of half the
current.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eldir.built.gait import Gait, free_lengths_batch
from eldir.built.gait_search import identified_robots, nominal_robots
from eldir.built.samples import sample_walks, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir_app.application import application
from eldir_calibration.comparison.predictions import predict_body
from eldir_calibration.comparison.recorded_run import RecordedRun
from eldir_hardware.emulator.board import ContactEvent
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.model_export import free_lengths
from eldir_hardware.planning.plan import heating_limits, predict_cycle
from eldir_hardware.planning.workshop import make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares
from eldir_hardware.virtual.rig import VirtualRig
from tests.calibration.adaptation.short_adaptation import make_walker
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

DESIGN = make_design(3, Lattice(3, 6))
IN_TURN = Gait(30.0, np.array([0.0, 0.5]), np.full(2, 0.2))


@pytest.fixture(scope="module")
def shared() -> Rig:
    return rig_with(supply={"outputs": "shared", "current_limit_a": 3.6})


@pytest.fixture(scope="module")
def halved() -> Rig:
    return rig_with(supply={"outputs": "each", "current_limit_a": 1.8})


def test_gaits_are_predicted_with_the_shared_current(shared: Rig, halved: Rig) -> None:
    every = [heating_limits(rig) for rig in (shared, halved, rig_with(supply={"current_limit_a": 3.6}))]
    design = make_walker()
    short = {"cycles": 1, "coarse": True}
    walks = [simulate_most_probable(nominal_robots(design, of), [IN_TURN], **short)[0] for of in every]
    assert walks[0] == pytest.approx(walks[1], abs=1e-6) and abs(walks[0]) < 0.01 < abs(walks[2]) - 0.1
    scene = PrintedScene.of(shared.nominal_robot(), ("friction",), np.eye(1))
    robots = identified_robots(design, every[0], scene)
    assert abs(sample_walks(robots, [IN_TURN], 2, **short)[0].mean) < 0.01


def test_two_motors_at_once_have_a_quarter_of_the_current(shared: Rig) -> None:
    """The limit divided by four springs, in the two seconds of five in which both motors heat."""
    springs, half = (rig_with(supply={"current_limit_a": a}).spring_parameters() for a in (3.6, 1.8))
    overlapping = Gait(30.0, np.array([0.0, 0.1]), np.full(2, 5 / 30))
    shares = tuple(power_shares(shared, springs).tolist())
    assert shares[2] == pytest.approx(1 / 4) and shares[4] == pytest.approx(1 / 16)
    (table,) = free_lengths_batch([(overlapping, [springs] * 2)], 1, 0, power_shares=shares)
    (alone,) = free_lengths_batch([(overlapping, [half] * 2)], 1, 0)
    start, both = table.first_cycle, table.first_cycle + 60  # the second motor begins after three seconds
    np.testing.assert_allclose(table.temperatures[:both, 0], alone.temperatures[:both, 0], rtol=1e-9)
    rise, before = (t.temperatures[both + 39, 0] - t.temperatures[both, 0] for t in (table, alone))
    assert rise < 0.3 * before
    assert table.temperatures[start:, 0].max() < alone.temperatures[start:, 0].max() - 1.0


def test_a_schedule_is_predicted_and_exported_with_the_shared_current(shared: Rig, halved: Rig) -> None:
    springs = tuple(np.flatnonzero(DESIGN.morphology.active).tolist())
    schedule = compile_schedule(IN_TURN, shared, springs, cycles=1)
    bodies = [predict_body(RecordedRun(DESIGN, schedule, rig)).positions for rig in (shared, halved)]
    np.testing.assert_allclose(*bodies, atol=1e-7)
    parameters = shared.spring_parameters(), halved.spring_parameters()
    exported = free_lengths(schedule, parameters[0], 2, power_shares(shared, parameters[0]))
    np.testing.assert_allclose(exported, free_lengths(schedule, parameters[1], 2), atol=1e-9)
    assert predict_cycle(schedule, shared) == predict_cycle(schedule, halved)


def test_the_virtual_rig_divides_the_current(shared: Rig, halved: Rig) -> None:
    rises, currents = [], []
    for rig in (shared, halved):
        with VirtualRig(rig, Piston()) as virtual:
            t, before = virtual.clock.now(), virtual.springs.state.temperature.copy()
            for channel in (1, 2):
                virtual.springs.on_contact_event(ContactEvent(t, channel, True))
            currents.append(virtual.springs.current_and_voltage(1, t)[0])
            virtual.frame(t + 2.0)
            rises.append(virtual.springs.state.temperature - before)
    np.testing.assert_allclose(*rises, atol=1e-6)
    assert currents[0] == pytest.approx(currents[1]) and rises[0][0] > 1.0


def test_what_does_not_simulate_it_refuses(shared: Rig, tmp_path: Path) -> None:
    rig, design = tmp_path / "rig.yaml", tmp_path / "design.json"
    rig.write_bytes(shared.source)
    DESIGN.save(design)
    with raises(InputError, "rig.shared-output", match="supply.outputs: each"):
        make_workshop(rig)
    pytest.importorskip("mujoco")  # which the command asks for first
    words = ["transfer", str(design), "--rig", str(rig), "--out", str(tmp_path / "out")]
    with raises(InputError, "rig.shared-output"):
        CliRunner().invoke(application("transfer"), words, catch_exceptions=False)
