"""Heat that is seen: faults of springs, contacts and of the sensor itself.

They are struck while a guardian's controller heats on an emulated board and an emulated current sensor, in
virtual time; some while a real guardian process does.
`pytest -s` prints the rows for docs/safety.md.
"""

import re
import time
from collections.abc import Callable
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import NamedTuple

import pytest

from eldir.errors import EldirError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.current_sensor import SensorError
from eldir_hardware.guardian.bank import Report
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_heat import CurrentFlowsError, UnexpectedHeatError
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.latch import read_stop
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.emulated_rigs import each_once
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

SENSOR = {"kind": "ina3221"}


class Ended(NamedTuple):
    """How a run ended in which channel 2 was to heat for 1.5 s and the others for 4 s."""

    rig: VirtualRig
    error: EldirError | None
    off_after: float
    """From when the fault could first be seen to the last edge of a contact that can open [s]."""
    latched: bool
    reports: list[Report]

    @property
    def told(self) -> str:
        return str(self.error or "nothing")


def struck(
    strike: Callable[[VirtualRig], object],
    *,
    visible_at: float = 1.0,
    until: float = 4.5,
    kind: str = "lcus",
    **entries: object,
) -> Ended:
    """The fault strikes a second after heating has begun; it can be seen `visible_at` after the beginning.
    The run ends `until` after it."""
    board = {"kind": kind} | ({"retriggerable": True} if kind == "modbus" else {})
    rig = rig_with(virtual={"clock": "wall"}, board=board, **({"sensor": SENSOR} | entries))
    reports: list[Report] = []
    error: EldirError | None = None
    with VirtualRig(rig, Piston()) as virtual:
        port = virtual.emulator.port
        with Guardian(rig, port, virtual.sensor_port) as bank:
            try:
                with bank.armed():
                    start = time.monotonic() + 0.5
                    bank.heat(start, {1: 4.0, 2: 1.5, 3: 4.0, 4: 4.0})
                    bank.wait_until(start + 1.0, reports.append)
                    strike(virtual)
                    bank.wait_until(start + until, reports.append)
            except EldirError as caught:
                error = caught
        latched = read_stop(port) is not None
        time.sleep(0.05)  # the last contact moves
        can_open = set(range(1, 5)) - virtual.emulator.faults.welded
        assert not any(virtual.emulator.contacts[c - 1] for c in can_open)
        last = max(e.t for e in virtual.emulator.contact_events if e.channel in can_open)
    return Ended(virtual, error, last - start - visible_at, latched, reports)


def row(name: str, run: Ended) -> None:
    print(f"\n| {name} | {run.off_after:.2f} s | {run.told} |")


@pytest.mark.parametrize("kind", ["lcus", pytest.param("modbus", marks=pytest.mark.stress)])
def test_a_welded_contact_that_the_board_does_not_know(kind):
    """Its pulse ends, and the current does not: the others open, and the user is told to cut the supply."""
    run = struck(lambda rig: rig.emulator.faults.welded.add(2), visible_at=1.5, kind=kind)
    row(f"welded contact, {kind}", run)
    assert isinstance(run.error, CurrentFlowsError)
    assert re.match("current flows in channel 2 although its contact was opened; found [34]", run.told)
    assert run.told.endswith("cut the heating supply now") and "all contacts are open" not in run.told
    assert run.latched and 0 < run.off_after < 1.0


def test_without_the_sensor_a_welded_contact_is_not_seen():
    run = struck(lambda rig: rig.emulator.faults.welded.add(2), until=2.5, sensor=None)
    assert run.error is None and run.rig.emulator.contacts[1] and not run.latched


FAULTS = {
    "broken lead": (
        lambda rig: rig.springs.break_lead(2),
        UnexpectedHeatError,
        "no current flows in channel 2 although its contact was closed.*or a lead of it, is broken",
    ),
    "spring of 30 % more resistance": (
        lambda rig: rig.springs.scale_resistance(2, 1.3),
        UnexpectedHeatError,
        r"unexpected resistance of the spring of channel 2; expected 0.7[67] to 1.2[01] Ohm; found 1\.[23]",
    ),
    "sensor unplugged": (
        lambda rig: rig.emulated_sensor.unplug(),
        SensorError,
        "sensor.*(was lost|did not answer)",
    ),
    "sensor silent": (
        lambda rig: setattr(rig.emulated_sensor.faults, "silent", True),
        SensorError,
        "the current sensor at .* did not answer",
    ),
    "sensor's answers late (0.7 s)": (
        lambda rig: setattr(rig.emulated_sensor.faults, "late", 0.7),
        SensorError,
        "the current sensor at .* did not answer",
    ),
    "sensor's answers garbled": (
        lambda rig: setattr(rig.emulated_sensor.faults, "garbled", True),
        SensorError,
        "invalid answer of the current sensor|did not answer",
    ),
    "chip of the sensor lost": (
        lambda rig: setattr(rig.emulated_sensor.i2c.chips[0x41].faults, "missing", True),
        SensorError,
        "chip at I2C address 0x41 does not answer",
    ),
    "chip of the sensor stuck": (
        lambda rig: setattr(rig.emulated_sensor.i2c.chips[0x40].faults, "stuck", True),
        SensorError,
        "chip at I2C address 0x40 does not finish its measurements",
    ),
}


def check(name: str, told: str, proof: str, off_after: float) -> None:
    """Everything is off within a second; no supply needs to be cut."""
    _, error, message = FAULTS[name]
    assert re.search(message, told)
    assert "all contacts are open by the board's report" in proof
    assert ("no current flows in channels" in proof) == (error is UnexpectedHeatError), "seen, not believed"
    assert off_after < 1.0


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in ("broken lead", "sensor unplugged") else pytest.mark.stress)
        for name in FAULTS
    ],
)
def test_faults_while_a_guardian_heats(name):
    """In real time, on a machine that is busy."""
    strike, error, _ = FAULTS[name]
    run = struck(strike)
    row(name, run)
    assert isinstance(run.error, error) and run.latched
    why, proof = run.told.split("; all contacts are open", 1)
    check(name, why, "all contacts are open" + proof, run.off_after)


def test_a_stop_for_another_reason_finds_the_welded_contact():
    def stop_welded(rig: VirtualRig) -> None:
        rig.emulator.faults.welded.add(3)
        raise EldirError("the camera fell over")

    rig = rig_with(virtual={"clock": "wall"}, sensor=SENSOR)
    with (
        VirtualRig(rig, Piston()) as virtual,
        Guardian(rig, virtual.emulator.port, virtual.sensor_port) as bank,
    ):
        with pytest.raises(EldirError) as told, bank.armed():
            start = time.monotonic() + 0.5
            bank.heat(start, {1: 3.0, 3: 3.0})
            bank.wait_until(start + 1.0)
            stop_welded(virtual)
        assert read_stop(virtual.emulator.port)
        assert not virtual.emulator.contacts[0]
    assert "current flows in channel 3" in str(told.value) and "the camera fell over" in str(told.value)
    assert "cut the heating supply now" in str(told.value)


# The same controller in virtual time.


@contextmanager
def controller(**entries):
    rig = rig_with(**({"sensor": SENSOR} | entries))
    with VirtualRig(rig, Piston()) as virtual:
        yield virtual, PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)


@pytest.mark.parametrize("name", FAULTS)
def test_faults_while_it_heats(name):
    strike, error, _ = FAULTS[name]
    with controller() as (virtual, bank):
        start = virtual.clock.now() + 0.5
        with pytest.raises(error) as told, bank.armed():
            bank.heat(start, {1: 4.0, 2: 1.5, 3: 4.0, 4: 4.0})
            bank.wait_until(start + 1.0)
            assert virtual.emulator.contacts == (True,) * 4
            strike(virtual)
            bank.wait_until(start + 4.5)
        assert not any(virtual.emulator.contacts)
        check(
            name, str(told.value), bank.proof, max(e.t for e in virtual.emulator.contact_events) - start - 1.0
        )


@pytest.mark.parametrize("chip", ["ina226", "ina3221"])
@pytest.mark.parametrize("kind", installed_kinds())
@pytest.mark.parametrize("others", [True, False])
def test_a_weld_is_seen_soon_on_every_board(kind, chip, others):
    """From the instant at which contact 2 should open to the stop, in virtual time: the protocols' part."""
    board = {"kind": kind, "retriggerable": True}
    with controller(board=board, sensor={"kind": chip}) as (virtual, bank):
        start = virtual.clock.now() + 1.0
        seen: list[float] = []
        with pytest.raises(CurrentFlowsError, match="channel 2"), bank.armed():
            bank.heat(start, {1: 4.0, 2: 1.5, 4: 4.0} if others else {2: 1.5})
            bank.wait_until(start + 1.0)
            virtual.emulator.faults.welded.add(2)
            try:
                bank.wait_until(start + 4.5)
            finally:
                seen.append(virtual.clock.now() - start - 1.5)
        print(f"\n{kind}, {chip}{', others too' if others else ''}: seen after {1e3 * seen[0]:.0f} ms")
        assert seen[0] < 0.3
        assert [c for c, closed in enumerate(virtual.emulator.contacts, start=1) if closed] == [2]


def test_contacts_that_switch_all_the_time_are_measured_all_the_same():
    with controller(
        board={"kind": "sainsmart"}, limits={"min_off_s": 0.1, "duty": 1.0}, supply={"current_limit_a": 1.5}
    ) as (virtual, bank):
        reports: list[Report] = []
        with bank.armed():
            start = virtual.clock.now() + 1.0
            for k in range(28):
                bank.wait_until(start + 0.31 * k - 0.3, reports.append)
                bank.heat(start + 0.31 * k, {1: 0.155})
            bank.wait_until(start + 9.0, reports.append)
    measured = [r.t for r in reports if r.currents and start < r.t < start + 8.8]
    assert 0.6 < max(b - a for a, b in pairwise(measured)) < 0.9, "some are left out, but not for long"


def weld(virtual: VirtualRig, channel: int) -> None:
    """The contact is closed, and the board reports it open."""
    virtual.emulator.set_coil(channel, True)
    virtual.emulator.faults.welded.add(channel)
    virtual.emulator.set_coil(channel, False)
    virtual.clock.sleep_until(virtual.clock.now() + 0.1)


def test_a_contact_welded_before_the_start_is_found_before_it_heats():
    with controller() as (virtual, bank):
        weld(virtual, 4)
        edges = len(virtual.emulator.contact_events)
        with (
            pytest.raises(CurrentFlowsError, match=r"channel 4 although.*cut the heating supply now"),
            bank.armed(),
        ):
            pass
        assert len(virtual.emulator.contact_events) == edges and not bank.armed_once


def test_a_contact_that_welds_in_the_last_pulse_is_found_at_the_end():
    with controller() as (virtual, bank):
        with pytest.raises(CurrentFlowsError, match="channel 1"), bank.armed():
            bank.heat(virtual.clock.now() + 0.5, {1: 2.0})
            bank.wait_until(virtual.clock.now() + 2.0)
            virtual.emulator.faults.welded.add(1)
        assert virtual.springs.max_temperature_c < 90


def test_a_lost_sensor_ends_the_run_by_the_boards_report_alone():
    with controller() as (virtual, bank):
        with raises(SensorError, "sensor", match="0x41 does not answer"), bank.armed():
            bank.heat(virtual.clock.now() + 0.5, {1: 3.0})
            bank.wait_until(virtual.clock.now() + 2.0)
            virtual.emulated_sensor.i2c.chips[0x41].faults.missing = True
            bank.wait_until(virtual.clock.now() + 2.0)
        assert not any(virtual.emulator.contacts)
        assert bank.proof == "all contacts are open by the board's report"


def test_a_contactor_that_opens_ends_the_current_of_a_welded_contact():
    """The stop opens the contactor too: what is proven then is that no current flows."""
    values = rig_with(board={"kind": "modbus", "channels": 5, "retriggerable": True}).model_dump()
    values |= {"cutoff": {"kind": "contactor", "channel": 5}, "sensor": SENSOR}
    rig = Rig.from_json(values)
    with VirtualRig(rig, Piston()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)
        with bank.armed():
            bank.heat(virtual.clock.now() + 0.5, {1: 1.0, 2: 2.0})
            bank.wait_until(virtual.clock.now() + 4.0)
    assert bank.proof == (
        "all contacts are open by the board's report; "
        "no current flows in channels 1, 2 by the sensor (it measured the supply in all of them in this "
        "run); "
        "the sensor shows no current in channels 3, 4, but it has not measured the supply there in this "
        "run, so this proves nothing"
    )


def test_a_rehearsal_with_the_supply_off_plays_to_its_end():
    with controller() as (virtual, bank):
        virtual.springs.has_supply = False
        with bank.armed():
            bank.heat(virtual.clock.now() + 0.5, {1: 2.0, 2: 1.0})
            bank.wait_until(virtual.clock.now() + 3.0)
        virtual.frame(virtual.clock.now())
        room = virtual.springs.parameters[0].ambient
        assert len(virtual.emulator.contact_events) == 4 and virtual.springs.max_temperature_c == room


@pytest.mark.parametrize("kind", installed_kinds())
def test_nothing_is_late_because_it_measures(kind):
    """Edges are where they are without a sensor, to the tenth of a millisecond, on every board."""
    found = []
    for sensor in (None, {"kind": "ina226"}, SENSOR):
        rig = rig_with(
            board={"kind": kind, "retriggerable": True},
            sensor=sensor,
            limits={"min_off_s": 0.3},
            supply={"current_limit_a": 1.5},
        )
        with VirtualRig(rig, Piston()) as virtual:
            bank = PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)
            with bank.armed():
                start = 1.5
                for k in range(6):
                    bank.heat(start + 1.7 * k, {1: 0.4 + 0.07 * k, 3: 0.3 + 0.1 * k})
                    bank.wait_until(start + 1.7 * k + 1.4)
            found.append([(e.channel, e.closed, e.t) for e in virtual.emulator.contact_events])
    for with_sensor in found[1:]:
        assert [e[:2] for e in with_sensor] == [e[:2] for e in found[0]]
        assert [e[2] for e in with_sensor] == pytest.approx([e[2] for e in found[0]], abs=1e-4)


@pytest.mark.parametrize(("seed", "chip"), each_once(range(6), ["ina226", "ina3221"]))
def test_a_sound_rig_is_never_stopped(seed, chip):
    """Chips, shunts and springs anywhere within their tolerances, contacts that switch at any time."""
    with controller(sensor={"kind": chip}, virtual={"seed": seed}) as (virtual, bank):
        assert isinstance(virtual.clock, VirtualClock)
        reports: list[Report] = []
        with bank.armed():
            for k in range(6):
                start = virtual.clock.now() + 0.4
                bank.heat(start, {1: 3.0 + 0.13 * k, 2: 0.4, 3: 1.0 + 0.31 * k})
                bank.wait_until(start + 16.0, reports.append)
                virtual.frame(virtual.clock.now())
    assert {round(c) for r in reports for c in r.currents} <= {0, 1, 2, 3, 4}
    assert max(r.currents[3] for r in reports) < 0.05 and max(r.currents[0] for r in reports) > 3.4


def test_a_rig_with_a_sensor_needs_it_open():
    rig = rig_with(sensor=SENSOR)
    with VirtualRig(rig, Piston()) as virtual, raises(EldirError, "sensor.other-opened"):
        PulseController(virtual.board, rig, virtual.clock)
    with controller() as (virtual, bank):
        virtual.emulated_sensor.faults.silent = True
        with pytest.raises(SensorError, match="did not answer"), bank.armed():
            pass
        assert not virtual.emulator.contact_events
    with suppress(SensorError), controller() as (virtual, bank):
        virtual.emulated_sensor.unplug()
        with pytest.raises(SensorError), bank.armed():
            pass


def test_a_stop_does_not_fail_because_the_sensor_does():
    """Then the board's report is all that there is; the reason of the stop stays."""
    with controller() as (virtual, bank):
        bank.arm()
        virtual.emulated_sensor.faults.silent = True
        bank.stop("a key")
        assert bank.proof == "all contacts are open by the board's report"
        with raises(EldirError, "guardian.stopped", match="a key"):
            bank.arm()
