"""Layer 0 of docs/safety.md alone: what opens a circuit whose contact is welded shut."""

import numpy as np
import pytest

from eldir.built.heat import HeatModel
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import power_shares, worst_springs
from eldir_hardware.safety import limits
from eldir_hardware.safety.limits import LimitError
from eldir_hardware.safety.worst_heat import stuck_temperature
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import SCHEDULE, gait, measured, rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

TIMED = {"kind": "modbus", "retriggerable": True}


def held_on(rig: Rig, seconds: float, count: int = 1) -> float:
    """True temperature of the worst springs, `count` on one supply, with nothing to open their contacts."""
    worst = worst_springs(rig)
    part = power_shares(rig, worst, worst=True)[count] if rig.supply.outputs == "shared" else 1.0
    on = np.full((round(seconds / 0.05), 1), part)
    return float(HeatModel([worst]).run(on, 0.05).temperature.max())


def test_a_current_that_is_safe_for_ever_and_one_that_is_not():
    """The closed form against the heat model, in the worst corner of still air whose losses were measured."""
    safe = rig_with(
        supply={"current_limit_a": 1.7}, springs=measured(convection_still=50), cutoff=None, fan=None
    )
    steady = stuck_temperature(safe, worst_springs(safe), None)
    assert steady == pytest.approx(held_on(safe, 900), abs=0.05) and steady < 90
    for current in (1.8, 4.0):
        hot = rig_with(
            supply={"current_limit_a": current}, springs=measured(convection_still=50), cutoff=None, fan=None
        )
        assert held_on(hot, 900) > 90
        with raises(LimitError, "limit.stuck-contact"):
            limits.check_rig(hot)


def test_a_fan_that_may_fail_does_not_count():
    windy = rig_with(supply={"current_limit_a": 1.5}, cutoff=None, fan={"interlocked": False})
    with raises(LimitError, "limit.stuck-contact", match="in still air"):
        limits.check_rig(windy)
    assert held_on(windy.model_copy(update={"fan": None}), 900) > 90, "what it guards from"


def test_a_shared_supply_counts_as_if_one_spring_had_it_alone():
    """Four springs share 4 A: each gets one. When three open, the welded one gets all."""
    shared = {"current_limit_a": 4.0, "outputs": "shared"}
    rig = rig_with(supply=shared, springs=measured(convection_still=50), cutoff=None, fan=None)
    assert held_on(rig, 900, count=4) < 90 < held_on(rig, 900, count=1)
    with raises(LimitError, "limit.stuck-contact"):
        limits.check_rig(rig)


@pytest.mark.parametrize(
    ("cutoff", "accepted"),
    [
        ({"kind": "timer", "max_on_s": 6.3}, True),
        ({"kind": "timer", "max_on_s": 7.5}, False),
        ({"kind": "thermal", "opens_at_c": 85.0}, True),
        ({"kind": "thermal", "opens_at_c": 95.0}, False),
        ({"kind": "contactor", "channel": 5}, False),
    ],
)
def test_a_cutoff_counts_only_if_it_acts_in_time_and_outlives_the_host(cutoff, accepted):
    rig = rig_with(board={"channels": 5}).model_copy(update={"cutoff": None})
    rig = Rig.from_json(rig.model_dump() | {"cutoff": cutoff})
    if accepted:
        assert limits.check_schedule(SCHEDULE, rig).stuck_c < 90
    else:
        with pytest.raises(LimitError, match=r"too late|stay closed if this computer fails"):
            limits.check_schedule(SCHEDULE, rig)


def test_a_contactor_that_the_board_itself_opens():
    """It counts on a board that times and restarts pulses, and closes only while something heats."""
    changes = {"board": TIMED | {"channels": 5}, "cutoff": {"kind": "contactor", "channel": 5}}
    values = rig_with(board=changes["board"]).model_dump() | {"cutoff": changes["cutoff"]}
    rig = Rig.from_json(values)
    limits.check_rig(rig)
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        with bank.armed():
            bank.heat(1.0, {1: 2.0})
            bank.heat(20.0, {1: 2.0})
            bank.wait_until(21.0)
            bank.abort_pulses()
            bank.wait_until(22.0)
        by_channel = {c: [e.t for e in virtual.emulator.contact_events if e.channel == c] for c in (1, 5)}
    for i in (0, 2):
        (on, off), (master_on, master_off) = by_channel[1][i : i + 2], by_channel[5][i : i + 2]
        assert master_on < on < off <= master_off < off + 0.2


def test_a_contactor_does_not_help_where_other_springs_keep_it_closed():
    """Behind a welded contact a spring heats as long as any other: twice as long where two follow another."""
    entries = {"board": TIMED | {"channels": 5}, "cutoff": {"kind": "contactor", "channel": 5}}
    rig = Rig.from_json(rig_with(board=entries["board"]).model_dump() | {"cutoff": entries["cutoff"]})
    assert compile_schedule(gait(phase=(0.0, 0.0)), rig).predicted.stuck_c < 90
    with raises(LimitError, "limit.stuck-contact", match="contactor"):
        compile_schedule(gait(phase=(0.0, 0.275)), rig)
    long = np.arange(round(5 * 20.0 / 0.05)) * 0.05 % 20.0 < 11.0
    assert HeatModel([worst_springs(rig)]).run(long[:, None], 0.05).temperature.max() > 90


def test_the_contacts_rating():
    with raises(LimitError, "limit.contact-rating"):
        limits.check_rig(rig_with(board={"contact_rating_a": 3.6}))
