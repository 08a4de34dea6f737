"""Springs of a rig with a fan cool in still air while nothing is armed."""

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir_hardware.guardian import _process as process
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.safety.spring_memory import SpringHeat, load_springs
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.guardian.pulse_controllers import FAN, controlled, edges, rig_of
from tests.hardware.guardian.recording_controller import PORT
from tests.hardware.rigs_and_schedules import rig_with

PULSE, WAIT, DT = 5.5, 40.0, 0.01
WITHOUT_RELAY = {"fan": {"interlocked": True}}
OPEN = (False,) * 4


def heat_once(virtual: VirtualRig, bank: PulseController) -> None:
    at = virtual.clock.now() + 0.5
    bank.heat(at, {1: PULSE})
    bank.wait_until(at + PULSE + 0.1)


def temperature_after(virtual: VirtualRig, rig: Rig, blown_until: float) -> float:
    """Of the hottest spring on channel 1 now, by the times of its contact and the heat model alone [C]: with
    the fan until `blown_until`, then in still air."""
    (closed, _), (opened, _) = edges(virtual, 1)
    worst = worst_springs(rig)
    heated = HeatModel([worst]).run(np.ones((round((opened - closed) / DT), 1)), DT).final
    blown = HeatModel([worst]).cool(heated, blown_until - opened)
    still = HeatModel([replace(worst, fan=False)]).cool(blown, virtual.clock.now() - blown_until)
    return float(still.temperature[0])


@pytest.mark.parametrize("fan", [FAN, WITHOUT_RELAY], ids=["its relay opens", "it may be switched off"])
@pytest.mark.parametrize("end", ["disarmed", "then stopped"])
def test_springs_cool_in_still_air_until_the_fan_blows_again(fan, end):
    """One guardian, two runs. In the fan's air the spring would be at the air's temperature by then."""
    rig = rig_of(**fan)
    with controlled(rig) as (virtual, bank, _):
        bank.arm()
        heat_once(virtual, bank)
        bank.disarm()
        blown_until = edges(virtual, 5)[-1][0] if rig.fan_channel else virtual.clock.now()
        virtual.clock.sleep_until(virtual.clock.now() + WAIT)
        if end == "then stopped":
            bank.stop("by SIGTERM")
        expected = temperature_after(virtual, rig, blown_until)
        found = bank.export_springs()[1].temperature_c[1]
        assert found == pytest.approx(expected, abs=0.5) and found > 55
        if end == "disarmed":
            bank.arm()
            assert bank.ready_at > virtual.clock.now() + 20.0
            bank.wait_until(bank.ready_at)
            assert bank.export_springs()[1].temperature_c[1] == pytest.approx(32.0, abs=0.3), "by the fan"


def test_what_a_stop_during_a_pulse_heats_is_blown_until_the_fan_stops():
    """The stop opens the fan's relay and the spring's with one command."""
    rig = rig_of(**FAN)
    with controlled(rig) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: PULSE})
        bank.wait_until(4.0)
        bank.stop("by a test")
        virtual.clock.sleep_until(virtual.clock.now() + WAIT)
        expected = temperature_after(virtual, rig, edges(virtual, 5)[-1][0])
        # It counts as heated until the board has proven that it is not.
        assert expected < bank.export_springs()[1].temperature_c[1] < expected + 2.5


def test_the_end_of_a_session_saves_springs_that_have_cooled_in_still_air(wires):
    """Over those that disarming saved: the next program waits for them."""
    rig = rig_of(**FAN)
    values = rig.model_dump() | {"kind": "real", "camera": None}
    real = Rig.from_json(values | {"board": values["board"] | {"port": PORT}})
    with controlled(rig) as (virtual, bank, _):
        bank.arm()
        heat_once(virtual, bank)
        bank.disarm()
        virtual.clock.sleep_until(virtual.clock.now() + WAIT)
        wires[0].send(command="end_session")
        process._Session(wires[1], bank, real, PORT).run()
        expected = temperature_after(virtual, rig, edges(virtual, 5)[-1][0])
    springs = load_springs(PORT)
    assert springs[1].temperature_c[1] == pytest.approx(expected, abs=0.5)
    assert Interlock(rig, 0.0, springs).rest_time(0.0) > 20.0


@pytest.mark.parametrize("fan", [FAN, WITHOUT_RELAY])
def test_warm_springs_of_another_program_cool_in_still_air_until_this_one_arms(fan):
    rig = rig_of(**fan)
    watch = Interlock(rig, 50.0, {1: SpringHeat((60.0, 76.0), (0.0, 0.0), ())})
    hot = SpringState(np.array([76.0]), np.zeros(1))
    worst = worst_springs(rig)
    cooled = HeatModel([replace(worst, fan=False)]).cool(hot, WAIT)
    assert watch.export_springs(50.0 + WAIT)[1].temperature_c[1] == pytest.approx(
        cooled.temperature[0], abs=0.1
    )
    watch.record_fan(True, 50.0 + WAIT)
    blown = HeatModel([worst]).cool(cooled, 10.0)
    watch.record_report((*OPEN, False), 60.0 + WAIT)
    assert watch.export_springs(60.0 + WAIT)[1].temperature_c[1] == pytest.approx(
        blown.temperature[0], abs=0.1
    )


def played(rig: Rig, *, fan_is_recorded: bool) -> tuple[object, ...]:
    """Two runs of one interlock, with a pulse each."""
    watch, seen = Interlock(rig, 0.0), []
    for begin in (1.0, 60.0):
        if fan_is_recorded:
            watch.record_fan(True, begin)
        seen.append(watch.rest_time(begin))
        watch.record_switching({1: True}, begin + 1.0)
        watch.record_report((True, False, False, False), begin + 2.03)
        watch.record_switching({1: False}, begin + 5.0)
        watch.record_report(OPEN, begin + 5.2)
        seen += [watch.temperatures, watch.peak]
        if fan_is_recorded:
            watch.record_fan(False, begin + 7.7)
    return (*seen, watch.export_springs(90.0))


@pytest.mark.parametrize("fan", [None, {"interlocked": False}], ids=["no fan", "one that may fail"])
def test_no_digit_changes_where_limits_count_on_no_fan(fan):
    rig = rig_with(fan=fan, supply={"current_limit_a": 1.5})
    assert played(rig, fan_is_recorded=True) == played(rig, fan_is_recorded=False)


def test_no_digit_of_a_run_that_begins_with_cold_springs_changes():
    """As those of all virtual rigs do: only what follows its end differs."""
    rig = rig_with()
    recorded, before = (played(rig, fan_is_recorded=is_recorded) for is_recorded in (True, False))
    assert recorded[:3] == before[:3]
    assert recorded[3] > before[3] + 5.0, "the second run waits"
