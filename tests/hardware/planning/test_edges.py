"""When contacts move, in virtual time: what is left is the protocol's. On the wall clock: `make stress`."""

from dataclasses import replace

import numpy as np
import pytest

from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.planning.compiler import describe_precision
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.rigs_and_schedules import SCHEDULE, rig_with
from tests.hardware.virtual.piston_and_observer import Piston

BYTE = 10 / 9600  # [s]
APART = {  # by which two contacts that are told at once close and open after one another [s]
    "lcus": (4 * BYTE, 4 * BYTE),
    "feedback": (8 * BYTE, 8 * BYTE),
    "gd32": (4 * BYTE / 12, 4 * BYTE / 12),
    "modbus": (16 * BYTE, 0.0),
    "mosfet": (0.0, 0.0),
    "numato": (0.0, 0.0),
    "sainsmart": (0.0, 0.0),
}


@pytest.mark.parametrize("kind", installed_kinds())
def test_edges_are_where_the_protocol_lets_them_be(kind):
    """Two contacts at once, their middle on time, at instants that fall anywhere between read-backs."""
    rng = np.random.default_rng(8)
    rig = rig_with(
        supply={"current_limit_a": 1.5},
        limits={"min_off_s": 0.3},
        board={"kind": kind, "retriggerable": True},
    )
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        at, wanted = virtual.clock.now() + 1.0, []
        with bank.armed():
            for _ in range(12):
                length = rng.uniform(0.2, 1.2)
                bank.wait_until(at - rng.uniform(0.3, 0.4))
                bank.heat(at, {2: length, 3: length})
                wanted += [(at, True), (at + length, False)]
                at += length + rng.uniform(0.5, 1.5)
            bank.wait_until(at)
        edges = virtual.emulator.contact_events
    assert len(edges) == 2 * len(wanted)
    for (instant, closed), pair in zip(wanted, zip(edges[::2], edges[1::2], strict=True), strict=True):
        assert [e.closed for e in pair] == [closed, closed]
        assert np.mean([e.t for e in pair]) == pytest.approx(instant, abs=5e-4)
        if kind in APART:
            assert pair[1].t - pair[0].t == pytest.approx(APART[kind][0 if closed else 1], abs=5e-4)


def test_what_closes_as_another_opens():
    """One frame where a mask does both; and more heats at no moment than is allowed."""
    for kind, frames in (("numato", 1), ("lcus", 2)):
        rig = rig_with(board={"kind": kind}, supply={"max_total_current_a": 4}, limits={"min_off_s": 0.3})
        with VirtualRig(rig, Piston()) as virtual:
            bank = PulseController(virtual.board, rig, virtual.clock)
            with bank.armed():
                bank.heat(1.0, {1: 2.0})
                bank.heat(3.0, {2: 1.0})
                bank.wait_until(5.0)
            found = [(e.channel, e.closed, e.t) for e in virtual.emulator.contact_events]
        assert [f[:2] for f in found] == [(1, True), (1, False), (2, True), (2, False)]
        assert found[2][2] - found[1][2] == pytest.approx((frames - 1) * 4 * BYTE, abs=1e-6)
        assert (found[1][2] + found[2][2]) / 2 == pytest.approx(3.0, abs=5e-4)


def test_pulses_too_short_for_their_heat_are_named():
    """5.5 s are long enough for every board; a tenth of that is not where four contacts close one by one."""
    assert describe_precision(SCHEDULE, rig_with()) == ""
    events = tuple(sorted(replace(e, t_s=0.0 if e.on else 0.5) for e in SCHEDULE.events))
    short, modbus = replace(SCHEDULE, events=events), rig_with(board={"kind": "modbus"})
    assert describe_precision(short, rig_with()) == "" == describe_precision(SCHEDULE, modbus)
    assert (
        "is exact to 6 % only; 2 % need pulses of 1.5 s; contacts close up to 25 ms before or after"
        in describe_precision(short, modbus)
    )
