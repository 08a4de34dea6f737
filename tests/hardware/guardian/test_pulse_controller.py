"""The pulse controller on a virtual clock: what makes it stop, and what its commands do."""

from itertools import pairwise

import pytest

from eldir.errors import EldirError
from eldir_hardware.guardian.pulse_controller import Host, KeepaliveError, PulseController
from eldir_hardware.relay.errors import SilentBoardError
from eldir_hardware.safety.limits import LimitError
from tests.hardware.guardian.pulse_controllers import FAN, controlled, edges, rig_of, step_until
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

# What makes it stop.


@pytest.mark.parametrize(("silent", "stops"), [(0.55, False), (0.61, True)])
def test_how_long_a_heartbeat_may_be_missing(silent, stops):
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        bank.wait_until(3.0)
        heard = virtual.clock.now()
        step_until(virtual, bank, heard + silent)
        if stops:
            with raises(KeepaliveError, "guardian.heartbeat", match=r"0\.6 s"):
                bank.step()
        else:
            bank.step()


@pytest.mark.parametrize(("late", "stops"), [(0.49, False), (0.52, True)])
def test_how_late_anything_may_be(late, stops):
    """Counted from when it was due. A heartbeat just before does not excuse it."""
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        bank.wait_until(3.0)
        virtual.clock.sleep_until(bank.step() + late)
        bank.keep_alive()
        if stops:
            with raises(EldirError, "guardian.stood-still", match=r"0\.5 s"):
                bank.step()
        else:
            bank.step()


@pytest.mark.parametrize(("late", "stops"), [(0.4, False), (0.52, True)])
def test_how_late_a_contact_may_move(late, stops):
    """It is told with every report; beyond half a second the run ends and the contact stays open."""
    with controlled(rig_of()) as (virtual, bank, seen):
        bank.arm()
        bank.heat(1.0, {1: 2.0})
        bank.wait_until(0.9, seen.append)
        virtual.clock.sleep_until(1.0 - virtual.board.switching_delay({1: True}) + late)
        bank.keep_alive()
        if stops:
            with raises(EldirError, "guardian.stood-still"):
                bank.step()
            assert not any(virtual.emulator.contacts)
        else:
            bank.wait_until(2.0, seen.append)
            assert seen[-1].max_delay == pytest.approx(late, abs=1e-6)
            assert virtual.emulator.contacts[0]


@pytest.mark.parametrize(("slept", "stops"), [(0.25, False), (0.26, True)])
def test_a_computer_that_was_asleep(slept, stops):
    """Counted from when the guardian began, in the system's own counter."""
    counter = [100.0]
    with controlled(rig_of(), lambda: counter[0]) as (_, bank, _):
        bank.arm()
        bank.wait_until(1.0)
        counter[0] += slept
        if stops:
            with raises(EldirError, "guardian.asleep"):
                bank.step()
        else:
            bank.step()


@pytest.mark.parametrize(("gap", "message"), [(0.3, "did not answer"), (0.8, r"was delayed by 0\.[78] s")])
def test_a_program_that_slept_while_it_waited_does_not_blame_the_board(monkeypatch, gap, message):
    """Its time for the answer was over when it woke."""
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 5.0})
        bank.wait_until(2.0)

        def silent() -> None:
            virtual.clock.sleep_until(virtual.clock.now() + gap)
            raise SilentBoardError("the board did not answer")

        monkeypatch.setattr(virtual.board, "_report", silent)
        with pytest.raises(EldirError, match=message):
            bank.wait_until(4.0)


@pytest.mark.parametrize("phase", ["_report", "_command_many"])
@pytest.mark.parametrize(("gap", "stops"), [(0.4, False), (0.6, True)])
def test_how_long_a_step_may_take(monkeypatch, phase, gap, stops):
    """A gap while it waits for the board."""
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 5.0})
        bank.wait_until(2.0)
        original, left = getattr(virtual.board, phase), [gap]

        def slow(*arguments: object) -> object:
            found = original(*arguments)
            virtual.clock.sleep_until(virtual.clock.now() + (left.pop() if left else 0.0))
            return found

        monkeypatch.setattr(virtual.board, phase, slow)
        bank.heat(2.5, {2: 2.0})
        if stops:
            with raises(EldirError, "guardian.stood-still", match=r"0\.6 s"):
                bank.wait_until(4.0)
        else:
            bank.wait_until(4.0)
        assert not left


# Commands.


@pytest.mark.parametrize("how", ["never armed", "disarmed", "stopped"])
def test_nothing_heats_unless_armed(how):
    with controlled(rig_of()) as (virtual, bank, _):
        assert not bank.armed_once
        if how != "never armed":
            bank.arm()
            assert bank.armed_once
        if how == "disarmed":
            bank.disarm()
        if how == "stopped":
            bank.stop("a key")
        with pytest.raises(EldirError, match="reset" if how == "stopped" else "not armed"):
            bank.heat(virtual.clock.now() + 1.0, {1: 1.0})
        written = virtual.board.bytes_written
        assert bank.step() == float("inf")
        bank.disarm()
        assert virtual.board.bytes_written == written, "a board that is off is left alone"


def test_a_board_that_another_user_stopped_closes_nothing_more():
    """The stop is looked for before each closing."""
    stopped, asked = [], []

    def may_close() -> None:
        asked.append(virtual.clock.now())
        if stopped:
            raise EldirError("it is stopped")

    with controlled(rig_of()) as (virtual, _, _):
        bank = PulseController(virtual.board, rig_of(), virtual.clock, host=Host(before_closing=may_close))
        bank.arm()
        bank.heat(1.0, {1: 1.0})
        bank.wait_until(3.0)
        assert len(asked) == 1, "nothing but a closing asks"
        bank.heat(12.0, {1: 1.0})
        stopped.append(True)
        with pytest.raises(EldirError, match="it is stopped"):
            bank.wait_until(13.0)
        assert len(edges(virtual, 1)) == 2, "the second pulse has not begun"


def test_a_second_stop_does_nothing():
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 5.0})
        bank.wait_until(2.0)
        bank.stop("a key")
        assert not any(virtual.emulator.contacts)
        written = virtual.board.bytes_written
        bank.stop("another key")
        assert virtual.board.bytes_written == written
        with raises(EldirError, "guardian.stopped", match="a key"):
            bank.arm()


def test_arming_opens_what_was_closed_and_tells():
    with controlled(rig_of(**FAN)) as (virtual, bank, seen):
        for channel in (2, 4):
            virtual.emulator.set_coil(channel, True)
        bank.arm()
        assert seen[-1].closed == virtual.emulator.contacts == (False,) * 4 + (True,)
        order = [(e.channel, e.closed) for e in virtual.emulator.contact_events]
        assert order == [(2, True), (4, True), (2, False), (4, False), (5, True)]
        assert seen[-1].max_delay == 0.0 and seen[-1].peak == pytest.approx(22.0)


def test_a_cut_opens_what_heats_and_forgets_what_was_announced():
    """The fan goes on, and heating may go on after a rest, counted from the cut."""
    with controlled(rig_of(**FAN)) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 5.0, 2: 4.0})
        bank.heat(3.0, {3: 1.0})
        bank.wait_until(2.0)
        assert virtual.emulator.contacts == (True, True, False, False, True)
        bank.abort_pulses()
        bank.wait_until(2.1)
        assert virtual.emulator.contacts == (False, False, False, False, True)
        bank.wait_until(5.0)
        assert edges(virtual, 3) == []
        written = virtual.board.bytes_written
        bank.abort_pulses()
        assert virtual.board.bytes_written == written, "nothing to cut"
        with raises(LimitError, "limit.no-rest"):
            bank.heat(9.9, {1: 1.0})
        bank.heat(10.1, {1: 1.0})
        bank.wait_until(10.5)
        assert virtual.emulator.contacts[0]


def test_the_end_opens_everything_and_tells():
    with controlled(rig_of(**FAN)) as (virtual, bank, seen):
        bank.arm()
        bank.heat(1.0, {1: 5.0})
        bank.heat(4.0, {2: 1.0})
        bank.wait_until(2.0, seen.append)
        bank.disarm()
        assert seen[-1].closed == virtual.emulator.contacts == (False,) * 5
        assert seen[-1].t == pytest.approx(virtual.clock.now())
        bank.arm()
        bank.wait_until(6.0, seen.append)
        assert edges(virtual, 2) == [], "announced before the end, and forgotten"
        with raises(LimitError, "limit.no-rest"):
            bank.heat(9.0, {1: 1.0})


def test_pulses_announced_in_any_order_come_on_time():
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        for at, lengths in ((6.0, {2: 2.0}), (1.0, {1: 2.0}), (3.5, {3: 2.0, 4: 1.0})):
            bank.heat(at, lengths)
        bank.wait_until(9.0)
        for channel, times in ((1, (1.0, 3.0)), (2, (6.0, 8.0)), (3, (3.5, 5.5)), (4, (3.5, 4.5))):
            assert [t for t, _ in edges(virtual, channel)] == pytest.approx(times, abs=0.0025)
        assert bank._max_delay < 1e-6


@pytest.mark.parametrize(("apart", "seen"), [(0.0005, 0.0), (0.05, 0.05)])
def test_edges_that_nearly_coincide_go_out_as_one(apart, seen):
    """On a board that opens several by one frame."""
    with controlled(rig_of("numato")) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 2.0, 2: 2.0 + apart})
        bank.heat(5.0, {3: 2.0})
        bank.heat(5.0 + apart, {4: 2.0})
        bank.wait_until(8.0)
        ends = [edges(virtual, c)[1][0] for c in (1, 2)]
        begins = [edges(virtual, c)[0][0] for c in (3, 4)]
        assert ends[1] - ends[0] == pytest.approx(seen, abs=1e-6)
        assert begins[1] - begins[0] == pytest.approx(seen, abs=1e-6)


def test_rest_returns_when_its_time_has_come():
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        for t in (1.0, 1.01, 4.0):
            bank.wait_until(t)
            assert t <= virtual.clock.now() < t + 0.06


def test_what_heats_already_counts_when_more_is_announced():
    """With what is announced, and with what was switched: the rest of a channel, and the supply's budget."""
    with controlled(rig_with(supply={"current_limit_a": 1.5, "max_total_current_a": 3.5})) as (_, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 4.0, 2: 4.0})
        with raises(LimitError, "limit.no-rest"):
            bank.heat(7.0, {1: 1.0})
        bank.wait_until(2.0)
        with raises(LimitError, "limit.supply"):
            bank.heat(4.0, {3: 1.0})
        bank.heat(5.1, {3: 1.0})


def test_the_controller_is_awake_from_when_it_is_armed():
    """A gap before does not matter; one right after the arming does."""
    with controlled(rig_of()) as (virtual, bank, _):
        virtual.clock.sleep_until(2.0)
        bank.arm()
        bank.step()
    with controlled(rig_of()) as (virtual, bank, _):
        bank.arm()
        virtual.clock.sleep_until(virtual.clock.now() + 0.55)
        bank.keep_alive()
        with raises(EldirError, "guardian.stood-still", match=r"0\.[56] s"):
            bank.step()


def test_a_read_back_is_put_off_for_less_than_half_a_second():
    """Switchings follow each other faster than the board can be read back."""
    with controlled(rig_of()) as (_, bank, seen):
        bank.arm()
        for number, channel in enumerate((1, 2, 3, 4)):
            bank.heat(1.0 + 0.14 * number, {channel: 2.0 + 0.3 * number})
        bank.wait_until(6.0, seen.append)
        times = [report.t for report in seen if 0.8 < report.t < 2.0]
        assert max(b - a for a, b in pairwise(times)) < 0.5


def test_reports_go_to_whom_rests():
    with controlled(rig_of()) as (_, bank, _):
        bank.arm()
        first: list = []
        bank.wait_until(2.0, first.append)
        count = len(first)
        second: list = []
        bank.wait_until(4.0, second.append)
        assert len(first) == count > 1 and len(second) > 1
