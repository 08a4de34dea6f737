"""The MOSFET board with its driver and its emulator, in virtual time."""

import os

import numpy as np
import pytest

from eldir.built.heat import HeatModel
from eldir.errors import EldirError, InputError
from eldir_hardware.firmware import limits
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.relay.errors import ContactError, GarbledReplyError
from eldir_hardware.virtual.rig import VirtualRig
from tests.hardware.firmware.mosfet_host import frame
from tests.hardware.relay.mosfet_bench import RIG, bench, off_at
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.virtual.piston_and_observer import Piston
from tests.raised import raises

# Limits that the board keeps by itself.


def test_a_host_that_falls_silent_has_everything_off_in_half_a_second() -> None:
    """No pulse length was given, as when a program closes a contact and dies."""
    with bench() as (emulated, board, clock):
        board.switch({1: True, 3: True})
        spoken = clock.now()
        clock.sleep_until(spoken + 5)
        assert off_at(emulated) == off_at(emulated, 3) == pytest.approx(spoken + 0.4, abs=0.01)
        with pytest.raises(
            ContactError, match=r"opened every contact because it received no command for too long"
        ):
            board.verify()


def test_a_host_that_does_not_stop_is_stopped() -> None:
    with bench() as (emulated, board, clock):
        begun = clock.now()
        board.send({2: True}, {2: 0.5})
        with pytest.raises(ContactError, match=r"a channel used up its heat budget"):
            for n in range(1000):
                clock.sleep_until(begun + 0.2 * n)
                board.send({2: True}, {2: 0.5})
                board.verify()
        edges = [e.t for e in emulated.contact_events if e.channel == 2]
        assert len(edges) == 2
        assert edges[1] - edges[0] == pytest.approx(limits.MAX_ON_MS / 1e3, abs=0.003)


@pytest.mark.parametrize("fault", ["reset", "hang"])
def test_a_brown_out_and_a_hung_program_are_noticed_and_end_the_run(fault: str) -> None:
    with VirtualRig(RIG, Piston()) as virtual:
        bank = PulseController(virtual.board, RIG, virtual.clock)
        struck = virtual.clock.now() + 2.0
        virtual.clock.call_at(struck, lambda t: getattr(virtual.emulator, fault)())
        with pytest.raises(EldirError) as told, bank.armed():
            bank.heat(virtual.clock.now() + 0.5, {1: 5.0, 2: 5.0})
            bank.wait_until(virtual.clock.now() + 6.0)
        virtual.clock.sleep_until(struck + 0.5)  # the board's own time; nobody talks to it any more
        assert not any(virtual.emulator.contacts)
        last = max(e.t for e in virtual.emulator.contact_events)
        within = 0.01 if fault == "reset" else limits.WATCHDOG_MS / 1e3 + 0.01
        assert last - struck < within
        if fault == "reset":
            assert "its power was interrupted" in str(told.value)
        else:
            assert "did not answer" in str(told.value) and "cut the heating supply" in str(told.value)


def test_after_a_reset_an_old_command_closes_nothing() -> None:
    with bench() as (emulated, board, clock):
        board.switch({1: True})
        emulated.reset()
        with pytest.raises(ContactError, match=r"refuses SET: everything is off.*its power was interrupted"):
            board.send({1: True}, {1: 0.5})
        assert not any(emulated.contacts)
        board.all_off()
        clock.sleep_until(clock.now() + 10)  # its budget begins empty of heat to give
        board.switch({1: True})
        assert emulated.contacts[0]


def test_the_clock_of_the_board_begins_again_while_it_heats() -> None:
    """After 2**30 ms; the emulated one gets there ten seconds after its start."""
    with bench() as (emulated, board, clock):
        clock.sleep_until(9.9)
        board.send({1: True}, {1: 0.25})
        before = emulated.limits._now
        clock.sleep_until(12)
        assert emulated.limits._now < before
        assert [e.closed for e in emulated.contact_events] == [True, False]
        assert emulated.contact_events[1].t - emulated.contact_events[0].t == pytest.approx(0.25, abs=2e-3)


def test_a_failed_mosfet_conducts_whatever_its_gate_does() -> None:
    """The board does not know; a hold becomes full power."""
    with bench() as (emulated, board, _):
        board.hold({1: 0.3}, 0.5)
        assert emulated.contact_events[-1].power == 0.3
        emulated.faults.welded.add(1)
        board.hold({1: 0.3}, 0.3)
        assert emulated.contact_events[-1].power == 1.0
        board.all_off()
        assert emulated.contacts == (True, False, False, False)


def test_a_gate_that_does_not_follow_is_read_back() -> None:
    with bench() as (emulated, board, _):
        board.switch({1: True, 2: True})
        emulated.faults.deaf.add(2)
        with pytest.raises(ContactError, match="channel 2 did not switch; expected open; found closed"):
            board.switch({2: False})


# The line.


def test_an_answer_to_another_question_is_not_believed() -> None:
    with bench() as (emulated, board, _):
        serve = emulated._handler.answer
        emulated._handler.answer = lambda line, now: serve(frame(0x0777, "ASK"), now)
        with pytest.raises(GarbledReplyError, match=r"expected !0002.*found b'!0777"):
            board.read_states()


def test_an_answer_that_comes_after_the_next_question_delays_no_other_one() -> None:
    """As when another program has just left the port: every answer would be one late for ever."""
    with bench() as (emulated, board, _):
        board.switch({2: True})
        late: list[bytes] = []
        drop, answer = board._line._port.reset_input_buffer, emulated.send_answer

        def empty_then_late() -> None:
            drop()
            while late:
                os.write(emulated._board_end, late.pop())

        board._line._port.reset_input_buffer = empty_then_late  # type: ignore[method-assign]
        emulated.send_answer = lambda data: (late.append(data), answer(data))  # type: ignore[method-assign]
        assert board.read_states() == (False, True, False, False), "nothing is late yet"
        assert board.read_states() == (False, True, False, False)
        board.all_off()
        assert not any(emulated.contacts)


def test_a_garbled_command_closes_nothing_and_is_not_answered() -> None:
    with bench() as (emulated, board, _):
        board.all_off()
        board.read_states()
        command = frame(500, "SET 01=100/00500")
        for i in range(len(command)):
            for bit in range(8):
                broken = bytearray(command)
                broken[i] ^= 1 << bit
                assert emulated.obey(bytes(broken)) == b""
        assert emulated.contact_events == []
        assert emulated.obey(command)[6:7] == b"T", "whole it is understood, but no run has begun"


def test_channels_beyond_the_rig_file_are_seen() -> None:
    """`channels: 4` on a board of eight, of which the seventh is on: nothing is proven open."""
    with bench(channels=8) as (emulated, board, _):
        board.switch({7: True})
        board.channels = 4
        with pytest.raises(ContactError, match="contact 7 is closed, but the rig file has 4 channels"):
            board.read_states()
        board.all_off()
        assert not any(emulated.contacts)


# Part of the full power.


def test_a_hold_gives_the_mean_power_and_floods_no_trace() -> None:
    """The virtual springs against the heat model on its own, at 0.3 of the power for 20 s."""
    rig = rig_with(board={"kind": "mosfet"}, cutoff=None, supply={"current_limit_a": 3})
    with VirtualRig(rig, Piston()) as virtual:
        begun = virtual.clock.now()
        for n in range(100):
            virtual.clock.sleep_until(begun + 0.2 * n)
            virtual.board.hold({1: 0.3, 2: 0.6 if n < 10 else 0.2}, 0.5)
        virtual.clock.sleep_until(begun + 20.0)
        virtual.frame(virtual.clock.now())
        temperatures = virtual.springs.state.temperature
        parameters = virtual.springs.parameters[:2]
        edges = virtual.emulator.contact_events
        states = virtual.board.channel_state(1)
    assert [(e.channel, e.power) for e in edges] == [(1, 0.3), (2, 0.6), (2, 0.2)]
    assert states.power == 0.3 and 0 < states.left_s <= 0.5 and states.budget == 1.0
    on = np.full((400, 2), 0.3)
    on[:, 1] = np.where(np.arange(400) < 40, 0.6, 0.2)
    wanted = HeatModel(parameters).run(on, 0.05).temperature[-1]
    assert temperatures[:2] == pytest.approx(wanted, abs=0.2)
    assert temperatures[0] > 30


def test_a_hold_too_strong_for_ever_is_ended() -> None:
    with bench() as (emulated, board, clock):
        begun = clock.now()
        with pytest.raises(ContactError, match="heat budget"):
            for n in range(1000):
                clock.sleep_until(begun + 0.2 * n)
                board.hold({1: 0.6}, 0.5)
        seconds = off_at(emulated) - begun
        assert seconds == pytest.approx(6.2 * (100 - 50) / (60 - 50), abs=0.05)
        with raises(InputError, "input.wrong-value", "power"):
            board.hold({1: 1.2}, 0.5)


def test_the_emulated_board_waits_for_one_instant_at_a_time() -> None:
    """Else timers would pile up in an hour of re-arming."""
    with bench() as (_, board, clock):
        for n in range(200):
            board.hold({1: 0.3}, 0.06 if n % 2 else 0.5)
            clock.sleep_until(clock.now() + 0.05)
        assert len(clock._actions) < 30
