"""What every board promises besides its bytes: pulses, settling, ports, sizes; on a virtual clock."""

import pytest

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.errors import ContactError, GarbledReplyError, NotProvenOffError
from eldir_hardware.relay.registration import get_board, installed_kinds
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.testing import close_contacts, pass_time, powered

KINDS = installed_kinds()


@pytest.mark.parametrize("kind", KINDS)
def test_a_board_that_was_just_opened(kind):
    """Its report is valid at once, it has commanded nothing, and nothing was written."""
    with powered(kind) as p:
        assert p.board.report_valid_at == p.clock.now() and p.board.bytes_written == 0
        close_contacts(p.emulated, [2])
        assert p.board.verify() == (False, True, False, False)


@pytest.mark.parametrize("kind", KINDS)
def test_a_report_is_valid_within_a_tenth_of_a_second(kind):
    """A contact that did not switch is seen that soon; the gate of a MOSFET follows at once."""
    driver = get_driver(kind)
    assert (0.05 if driver.contact_time else 0.0) <= driver.settling <= 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_pulse_on_any_board(kind):
    """Boards without a timer leave it closed; what opens, and what has no length, is no pulse."""
    with powered(kind) as p:
        p.board.all_off()
        p.board.send({1: False, 2: True, 3: True, 4: True}, {1: 0.3, 2: 0.3, 4: 0.25})
        assert p.board.verify() == (False, True, True, True)
        pass_time(p, 1.0)
        timed = p.board.times_pulses
        assert p.emulated.contacts == (False, not timed, True, not timed)
        if timed:
            lengths = {}
            for e in p.emulated.contact_events:
                lengths[e.channel] = lengths.get(e.channel, 0.0) + (-e.t if e.closed else e.t)
            tick = 1e-9 if kind == "modbus" else 1e-3
            assert lengths[2] == pytest.approx(0.3, abs=tick)
            step = {"modbus": 0.3}.get(kind, 0.25)
            assert lengths[4] == pytest.approx(step, abs=tick), "Modbus boards: in steps of 0.1 s, upwards"


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("channel", [1, 2, 4])
def test_all_off_proves_every_channel(kind, channel):
    with powered(kind) as p:
        p.board.send({channel: True})
        pass_time(p, 1.0)
        p.emulated.faults.deaf.add(channel)
        with pytest.raises(NotProvenOffError, match=f"channel {channel} did not switch"):
            p.board.all_off()


@pytest.mark.parametrize("kind", KINDS)
def test_what_closes_by_itself_after_all_off_is_seen(kind):
    with powered(kind) as p:
        p.board.all_off()
        close_contacts(p.emulated, [1])
        with pytest.raises(ContactError, match="channel 1 did not switch; expected open; found closed"):
            p.board.verify()


@pytest.mark.parametrize("kind", KINDS)
def test_closing_frees_the_port(kind):
    with powered(kind) as p:
        p.board.close()
        get_driver(kind)(p.emulated.port, 4, VirtualClock()).close()


@pytest.mark.parametrize("kind", KINDS)
def test_how_far_apart_contacts_close_that_open_as_one(kind):
    with powered(kind) as p:
        p.board.all_off()
        p.board.send({1: True, 2: True})
        p.clock.sleep_until(1.0)
        p.board.send({1: False, 2: False})
        p.clock.sleep_until(2.0)
        apart = [
            abs(a.t - b.t)
            for on in (True, False)
            for a, b in [[e for e in p.emulated.contact_events if e.closed is on]]
        ]
        assert apart[0] - apart[1] == pytest.approx(p.board.closing_interval, abs=1e-9)


def test_the_largest_board_of_each_kind():
    """By their pages; channel 15 of GD32 means every relay."""
    largest = {"lcus": 8, "gd32": 14, "feedback": 16, "modbus": 16, "numato": 16, "sainsmart": 16}
    assert {kind: get_board(kind).max_channels for kind in largest} == largest


@pytest.mark.parametrize(("late", "asked"), [(0.05, 2), (0.3, 1)])
def test_a_garbled_report_is_asked_for_again_unless_its_end_was_waited_for(monkeypatch, late, asked):
    """Waiting twice would keep the other contacts closed for longer."""
    with powered("lcus") as p:
        times: list[float] = []

        def garbled() -> tuple[bool, ...]:
            times.append(p.clock.now())
            p.clock.sleep_until(p.clock.now() + p.board.report_time + late)
            raise GarbledReplyError("the report cannot be read")

        monkeypatch.setattr(p.board, "_report", garbled)
        with pytest.raises(GarbledReplyError):
            p.board.read_states()
        assert len(times) == asked
