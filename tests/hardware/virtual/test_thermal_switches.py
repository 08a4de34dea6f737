"""The emulated thermal switch on each spring opens at its temperature, and a user is warned of one that
does so in normal operation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from eldir.core.records import FloatArray
from eldir.core.yaml_files import parse_yaml
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir_app.commands import gait as gait_command
from eldir_app.commands.rig import rig as command
from eldir_hardware.emulator.board import ContactEvent
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.plan import predict_cycle
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.player import Player
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import VirtualRig
from eldir_hardware.virtual.springs import HYSTERESIS_K, STEP, ThermalSprings
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import gait, rig_text, rig_with
from tests.hardware.virtual.piston_and_observer import Notes, Piston

SPRING = SpringParameters(current_limit=3.45)
HEATING_K = STEP * SPRING.power(0.0) / (SPRING.mass * SPRING.heat_capacity)
"""By what a spring without losses and latent heat gets hotter in a step [K]."""


def thermal(opens_at_c: float) -> Rig:
    return Rig.from_json(rig_with().model_dump() | {"cutoff": {"kind": "thermal", "opens_at_c": opens_at_c}})


def with_cycle(rig: Rig) -> ActuationSchedule:
    schedule = compile_schedule(gait(), rig, springs=(7, 12))
    return replace(schedule, predicted=replace(schedule.predicted, cycle=predict_cycle(schedule, rig)))


def play(rig: Rig) -> tuple[VirtualRig, FloatArray]:
    """The rig after a schedule, and the lengths of its first motor."""
    notes = Notes()
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        virtual.watch(10.0, notes.frames.append)
        Player(bank, compile_schedule(gait(), rig), rig, virtual.clock, [notes]).play()
    return virtual, np.array([frame.positions[1, 0] for frame in notes.frames])


@pytest.mark.parametrize("interval", [STEP, 0.3, 7.0])
def test_a_spring_on_a_welded_contact_stays_between_opening_and_closing(interval):
    """However many steps it is advanced at once."""
    springs = ThermalSprings([1], [SPRING], 0.0, opens_at_c=50.0)
    springs.on_contact_event(ContactEvent(0.0, 1, True, 1.0))
    temperatures = []
    for t in np.arange(interval, 84.0 + interval / 2, interval):
        springs.advance(t)
        temperatures.append(springs.state.temperature[0])
    assert 50.0 <= springs.max_temperature_c < 50.0 + HEATING_K
    late = np.array(temperatures[round(7.0 / interval) :])
    assert late.min() > 50.0 - HYSTERESIS_K - 0.5 and late.max() <= springs.max_temperature_c
    if interval == STEP:
        assert late.min() < 50.0 - HYSTERESIS_K
        rises, steep = np.diff(late) > 0, np.flatnonzero(np.diff(np.sign(np.diff(late))))
        assert 0 < rises.mean() < 1 and len(steep) > 6, "it opens and closes"
    whole = ThermalSprings([1], [SPRING], 0.0, opens_at_c=50.0)
    whole.on_contact_event(ContactEvent(0.0, 1, True, 1.0))
    whole.advance(84.0)
    assert np.array_equal(whole.state.temperature, springs.state.temperature)


def test_an_open_switch_interrupts_both_springs_of_its_channel_and_no_other():
    weak = SPRING.with_resistance(0.5 * SPRING.resistance)
    springs = ThermalSprings([1, 1, 2], [SPRING, weak, SPRING], 0.0, opens_at_c=50.0)
    for channel in (1, 2):
        springs.on_contact_event(ContactEvent(0.0, channel, True, 1.0))
    while springs.state.temperature[0] < 50.0:
        springs.advance(springs.now + STEP)
    assert springs.current_and_voltage(1, springs.now) == (0.0, SPRING.supply_voltage)
    before = springs.state.temperature
    springs.break_lead(2)
    springs.advance(springs.now + 1.0)
    assert (springs.state.temperature < before).all()
    assert before[1] < 45.0, "the switch of the other spring stays closed"


def test_a_run_passes_the_temperature_of_its_thermal_switches_by_a_step():
    """The user's rig: without the emulated switches its springs reached 67.9 C."""
    free, _ = play(thermal(85.0))
    switched, _ = play(thermal(50.0))
    assert free.springs.max_temperature_c > 60
    assert 50.0 <= switched.springs.max_temperature_c < 50.0 + 2 * HEATING_K


def test_switches_that_never_open_change_no_digit():
    (_, with_switches), (_, with_timers) = play(thermal(85.0)), play(rig_with())
    assert len(with_timers) > 1000 and np.array_equal(with_switches, with_timers)


def test_a_user_is_warned_of_switches_that_open_in_normal_operation(tmp_path: Path):
    """Of a gait, whose nominal peak is 56 C, and of a hold at 38 to 43 C."""
    (warning,) = gait_command._warnings(with_cycle(thermal(50.0)), thermal(50.0))
    assert "nominal springs would reach 56 C, but their thermal switches open at 50 C" in warning
    assert not list(gait_command._warnings(with_cycle(thermal(85.0)), thermal(85.0)))
    assert not list(gait_command._warnings(with_cycle(rig_with()), rig_with()))
    make_design(3, Lattice(3, 6)).save(tmp_path / "design.json")
    for opens_at_c in (40.0, 70.0):
        values = parse_yaml(rig_text().encode(), "the template")
        values |= {"cutoff": {"kind": "thermal", "opens_at_c": opens_at_c}}
        values["limits"]["min_off_s"] = 0.5
        (tmp_path / f"{opens_at_c:g}.yaml").write_text(yaml.safe_dump(values))
        made = CliRunner().invoke(
            command,
            ["hold", str(tmp_path / "design.json"), "--rig", str(tmp_path / f"{opens_at_c:g}.yaml"),
             "--power", "0.3", "--out", str(tmp_path / f"{opens_at_c:g}.json")],
        )  # fmt: skip
        assert made.exit_code == 0, made.output
        warned = "nominal springs would reach 43 C, but their thermal switches open at 40 C" in made.output
        assert warned == (opens_at_c == 40.0), made.output
