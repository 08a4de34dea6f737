"""Both springs of a motor in series on one channel: the same current in both, the limits of one spring."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from eldir.core.yaml_files import parse_yaml
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES, Connection, is_in_series, wiring
from eldir_hardware.emulator.board import ContactEvent
from eldir_hardware.guardian.measured_heat import HeatBounds
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.compiler import compile_schedule, extract_gait
from eldir_hardware.planning.model_export import free_lengths
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, worst_springs
from eldir_hardware.rig.template import real_rig, virtual_rig
from eldir_hardware.run.drive import drive_rig
from eldir_hardware.safety.compatibility import compare_wiring, packet_wiring, with_digests
from eldir_hardware.safety.limits import check_schedule
from eldir_hardware.safety.margins import rigs_with_narrower_tolerances
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import RIG, SCHEDULE, gait, rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

PAIRS = [{"channel": 1 + motor, "spring": motor, "face": "both"} for motor in range(2)]


def in_series(**changes: object) -> Rig:
    return rig_with(channels=PAIRS, **changes)


def refused(**changes: object) -> str:
    with pytest.raises(InputError) as error:
        in_series(**changes)
    return str(error.value)


def test_a_new_rig_file_and_a_packet_number_the_channels_alike():
    for text in (virtual_rig(in_series=True), real_rig("lcus", "/dev/ttyUSB0", in_series=True)):
        values = parse_yaml(text.encode(), "rig")
        assert values["channels"] == PAIRS and values["board"]["channels"] == 2
        assert Rig.from_json(values).channels == wiring(2, in_series=True)
    assert wiring(1, in_series=True) == wiring(3, in_series=True)[:1] == (Connection(1, 0, "both"),)
    assert is_in_series(wiring(2, in_series=True)) and not is_in_series(wiring(2))


def test_what_cannot_be_wired_so_is_refused():
    mixed = [*PAIRS[:1], *({"channel": 2 + i, "spring": 1, "face": face} for i, face in enumerate(FACES))]
    for channels, found in (
        (mixed, "some heat both springs of a motor in series, others one spring"),
        ([*PAIRS, {"channel": 3, "spring": 0, "face": "front"}], "two channels heat the same spring"),
        ([{"channel": 1, "spring": 0, "face": "middle"}], "'front', 'back' or 'both'"),
    ):
        with pytest.raises(InputError, match=found):
            rig_with(channels=channels, board={"channels": 4})
    assert "need supply.outputs: each" in refused(supply={"outputs": "shared"})
    with raises(InputError, "rig.no-channel"):
        rig_with(channels=[{"channel": 1, "spring": 0, "face": "front"}]).connections_of(0)


def test_the_supply_must_hold_its_current_in_both_springs_at_their_highest_resistance():
    """By the numbers: 3.45 A through twice the larger resistance of both phases, 5 % more, and the leads."""
    springs = RIG.spring_parameters()
    highest = 1.05 * max(springs.resistance_at(0.0), springs.resistance_at(1.0))
    least = 3.45 * (2 * highest + RIG.supply.lead_resistance_ohm)
    assert 7 < least < RIG.supply.voltage_v
    message = refused(supply={"voltage_v": round(least - 0.01, 3)})
    assert f"expected at least {least:.3g} V" in message
    in_series(supply={"voltage_v": round(least + 0.01, 3)})
    in_series(supply={"current_limit_a": None, "voltage_v": 5})  # does not arm


def test_a_schedule_switches_one_channel_a_motor_and_has_the_limits_of_one_spring():
    rig = in_series()
    schedule = compile_schedule(gait(), rig, springs=(7, 12))
    assert {e.channel: (e.spring, e.face) for e in schedule.events} == {1: (0, "both"), 2: (1, "both")}
    times = {(e.t_s, e.spring, e.on) for e in schedule.events}
    assert times == {(e.t_s, e.spring, e.on) for e in SCHEDULE.events}
    assert len(schedule.events) == len(SCHEDULE.events) / 2
    assert worst_springs(rig) == worst_springs(RIG)
    assert schedule.predicted.peak_c == SCHEDULE.predicted.peak_c
    assert schedule.predicted.stuck_c == SCHEDULE.predicted.stuck_c
    assert np.allclose(extract_gait(schedule).duty, gait().duty)
    for made, other in ((schedule, RIG), (SCHEDULE, rig)):
        with raises(LimitError, "limit.other-wiring"):
            check_schedule(made, other)
    assert compare_wiring(rig, packet_wiring(None, 2, rig)) == ""
    assert "channel 1 heats spring 0 front in the packet, spring 0 front and back in series on the rig" in (
        compare_wiring(rig, packet_wiring(None, 2, RIG))
    )
    lengths = free_lengths(schedule, SpringParameters(), 2)
    np.testing.assert_array_equal(lengths, free_lengths(SCHEDULE, SpringParameters(), 2))


def test_both_springs_have_one_current_and_the_channel_the_sum_of_their_voltages():
    """Springs of unlike resistance; the front one cold, by Ohm's law."""
    rig = in_series()
    with VirtualRig(rig, Piston()) as virtual:
        springs, clock = virtual.springs, virtual.clock
        front, back = (replace(springs.parameters[0]).with_resistance(ohm) for ohm in (0.9, 1.1))
        springs.parameters[:2] = [front, back]
        t = clock.now()
        springs.on_contact_event(ContactEvent(t, 1, True))
        current, voltage = springs.current_and_voltage(1, t)
        assert current == front.current_limit and voltage == pytest.approx(current * (0.9 + 1.1))
        assert springs.current_and_voltage(2, t) == (0.0, 0.0)
        before = springs.state.temperature.copy()
        virtual.frame(t + 1.0)
        rise = springs.state.temperature - before
        assert rise[0] > 5 and np.all(rise[2:] == 0)
        assert rise[1] / rise[0] == pytest.approx(1.1 / 0.9, rel=0.02), "heat by I2 R, before the losses"
        low = replace(front, supply_voltage=4.0), replace(back, supply_voltage=4.0)
        springs.parameters[:2] = low
        weak, _ = springs.current_and_voltage(1, virtual.clock.now() + 1.0)
        assert weak == pytest.approx(4.0 / (0.9 + 1.1 + front.lead_resistance), rel=0.01)
        springs.parameters[:2] = [front, back]
        springs.break_lead(1)
        assert springs.current_and_voltage(1, t + 1.0) == (0.0, pytest.approx(front.supply_voltage))
        warm = springs.state.temperature[:2].copy()
        virtual.frame(t + 2.0)
        assert np.all(springs.state.temperature[:2] < warm), "one broken lead stops both springs"


def test_a_sensor_expects_two_springs():
    sensor = {"kind": "ina226"}
    one = HeatBounds(rig_with(sensor=sensor), rig_with(sensor=sensor).sensor).bounds(3.45).resistances
    two = HeatBounds(in_series(sensor=sensor), in_series(sensor=sensor).sensor).bounds(3.45).resistances
    assert two == pytest.approx([2 * ohm for ohm in one], rel=0.01)


def test_a_run_is_driven_and_measured(tmp_path):
    values = yaml.safe_load(virtual_rig(in_series=True)) | {"sensor": {"kind": "ina226"}}
    del values["camera"]
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(values))
    rig = Rig.load(path)
    heated = gait(duty=(0.2, 0.2), period=30.0)
    schedule = replace(compile_schedule(heated, rig, (0, 1), cycles=1), settle_s=1.0, conditioning_cycles=0)
    drive_rig(with_digests(schedule, rig), rig, path, tmp_path / "log.mcap")
    log = read_log(tmp_path / "log.mcap")
    assert log.currents.shape[1] == log.temperatures.shape[1] == 2
    on = log.currents[:, 0] > 1
    assert log.currents[on, 0] == pytest.approx(3.6, rel=0.06)
    assert log.voltages[on, 0] == pytest.approx(2 * 3.6 * 0.987, rel=0.12)


def test_no_current_is_advised_that_the_voltage_does_not_drive_through_both() -> None:
    """A rig file with any advised current is accepted; one spring alone would allow more."""
    for volts, advised in ((8.0, 3.75), (11.0, 3.9)):
        rig = in_series(supply={"voltage_v": volts})
        schedule = compile_schedule(gait(duty=(0.1, 0.1)), rig)
        found = [other.supply.current_limit_a for other in rigs_with_narrower_tolerances(schedule, rig)]
        assert max(found) == advised
        for current in found:
            in_series(supply={"voltage_v": volts, "current_limit_a": current})
    assert "too low for 3.8 A" in refused(supply={"voltage_v": 8.0, "current_limit_a": 3.8})
