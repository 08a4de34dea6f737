"""When the pulse controller switches, repeats pulses and looks, by the emulated board and by its reports."""

from itertools import pairwise

import pytest

from eldir.errors import EldirError
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import BoardEntry
from tests.hardware.guardian.pulse_controllers import FAN, controlled, edges, rig_of
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

CONTACTOR = {"kind": "contactor", "channel": 5}


@pytest.mark.parametrize("kind", installed_kinds())
def test_contacts_move_at_their_instant(kind):
    """Wire and contact are allowed for, on any board: the middle of edges that go out together."""
    with controlled(rig_of(kind)) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 2.0, 3: 2.0})
        bank.heat(6.0, {2: 1.5})
        bank.wait_until(9.0)
        both = [[edges(virtual, c)[i][0] for c in (1, 3)] for i in (0, 1)]
        assert [sum(t) / 2 for t in both] == pytest.approx([1.0, 3.0], abs=1e-6)
        assert [t for t, _ in edges(virtual, 2)] == pytest.approx([6.0, 7.5], abs=1e-6)


# Boards that time their pulses.


def flashes(virtual) -> list[tuple[float, int, int]]:
    """Times, channels and lengths of the pulses that the board was told from now on [s], [0.1 s]."""
    found: list[tuple[float, int, int]] = []
    obey = virtual.emulator.obey

    def heard(request: bytes) -> bytes:
        if request[1] == 5 and request[2] == 2:
            found.append(
                (virtual.emulator._wire_free_at, request[3] + 1, int.from_bytes(request[4:6], "big"))
            )
        return obey(request)

    virtual.emulator.obey = heard
    return found


@pytest.mark.parametrize("seconds", [0.1, 0.3, 0.5, 0.55, 0.62, 0.7, 1.0, 2.0, 5.04])
def test_a_pulse_is_repeated_before_it_ends(seconds):
    """Never for more than half a second, a fifth of a second before its end at the latest, and no longer
    than the pulse and one step of the timer."""
    with controlled(rig_of("modbus")) as (virtual, bank, _):
        told = flashes(virtual)
        bank.arm()
        bank.heat(1.0, {1: seconds})
        bank.wait_until(8.0)
        (closed, _), (opened, _) = edges(virtual, 1)
        assert closed == pytest.approx(1.0, abs=1e-6)
        assert opened == pytest.approx(1.0 + seconds, abs=0.002)
        for (t, _, tenths), (after, _, _) in pairwise(told):
            assert tenths == 5 and 0.2 <= after - t <= 0.3
        last, _, tenths = told[-1]
        assert 1.0 + seconds - 0.021 < last + tenths / 10 < 1.0 + seconds + 0.1
        assert len(told) == 1 or seconds > 0.45
        assert len(told) <= 1 + max(0.0, seconds - 0.25) / 0.2


def test_a_pulse_is_not_repeated_across_an_edge():
    """One that is due as another channel opens is sent right behind it."""
    with controlled(rig_of("modbus")) as (virtual, bank, _):
        told = flashes(virtual)
        bank.arm()
        bank.heat(1.0, {1: 3.0})
        bank.heat(1.2, {2: 1.1})
        bank.wait_until(6.0)
        assert [t for t, _ in edges(virtual, 1)] == pytest.approx([1.0, 4.0], abs=0.01)
        assert [t for t, _ in edges(virtual, 2)] == pytest.approx([1.2, 2.3], abs=1e-6)
        assert bank._max_delay == pytest.approx(16 * 10 / 9600), "the frame of a repetition and its echo"
        own = [t for t, channel, _ in told if channel == 1]
        assert all(b - a < 0.4 for a, b in pairwise(own))


def test_a_board_that_ignores_a_second_pulse_gets_one_of_full_length():
    rig = rig_of("modbus")
    board = BoardEntry.from_json(rig.board.model_dump() | {"retriggerable": False})
    with controlled(rig.model_copy(update={"board": board})) as (virtual, bank, _):
        virtual.emulator.retriggerable = False
        told = flashes(virtual)
        bank.arm()
        bank.heat(1.0, {1: 2.34})
        bank.wait_until(6.0)
        assert [tenths for _, _, tenths in told] == [24]
        assert [t for t, _ in edges(virtual, 1)] == pytest.approx([1.0, 3.34], abs=0.002)


# A contactor in series with the whole supply.


def contactor_rig() -> Rig:
    return rig_of("modbus", CONTACTOR)


@pytest.mark.parametrize(
    "pulses",
    [
        {1.0: {1: 2.0}},
        {1.0: {1: 2.0, 2: 1.0}},
        {1.0: {1: 1.0, 2: 3.0}},
        {1.0: {1: 2.0}, 2.0: {2: 3.0}},
        {1.0: {1: 4.0}, 2.0: {2: 1.0}},
        {1.0: {1: 2.0}, 3.0: {2: 2.0}},
        {1.0: {1: 2.0}, 3.0: {2: 2.0, 3: 1.0}, 5.0: {4: 0.3}},
        {1.0: {1: 1.0}, 9.0: {2: 1.0}},
    ],
)
def test_a_contactor_is_closed_exactly_while_something_heats(pulses):
    """It closes first and opens last, each time within the frames of one switching, and not in between."""
    with controlled(contactor_rig()) as (virtual, bank, _):
        bank.arm()
        for at, lengths in pulses.items():
            bank.heat(at, lengths)
        bank.wait_until(14.0)
        order = [(e.channel, e.closed) for e in sorted(virtual.emulator.contact_events)]
        spans = sorted((at, at + s) for at, lengths in pulses.items() for s in lengths.values())
        heated: list[list[float]] = []
        for begin, end in spans:
            if heated and begin <= heated[-1][1] + 1e-9:
                heated[-1][1] = max(heated[-1][1], end)
            else:
                heated.append([begin, end])
        master = [t for t, _ in edges(virtual, 5)]
        assert master == pytest.approx([t for span in heated for t in span], abs=0.05)
        assert order[0] == (5, True) and order[-1] == (5, False)
        closed: set[int] = set()
        for channel, on in order:
            closed = closed | {channel} if on else closed - {channel}
            assert not closed or 5 in closed, "a spring's contact never breaks or makes the current alone"


def test_a_cut_opens_the_contactor_last():
    with controlled(contactor_rig()) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {1: 4.0, 2: 4.0})
        bank.wait_until(2.0)
        bank.abort_pulses()
        bank.wait_until(2.3)
        opened = [e.channel for e in sorted(virtual.emulator.contact_events) if not e.closed]
        assert sorted(opened) == [1, 2, 5] and not any(virtual.emulator.contacts)
        bank.heat(11.0, {1: 1.0})
        bank.wait_until(13.0)
        assert [t for t, _ in edges(virtual, 5)][2:] == pytest.approx([11.0, 12.0], abs=0.05)


# Read-backs.


@pytest.mark.parametrize("kind", installed_kinds())
def test_how_often_the_board_is_asked(kind):
    """Twice a second while all is open, or twice within the board's patience; ten times while something
    heats, and never across an edge."""
    rig = rig_of(kind)
    with controlled(rig) as (virtual, bank, seen):
        bank.arm()
        bank.wait_until(3.0, seen.append)
        took = virtual.board.report_time
        rest = {"mosfet": 0.2}.get(kind, 0.5)
        idle = [b.t - a.t for a, b in pairwise(seen) if b.t < 2.9]
        assert idle == pytest.approx([rest + took] * len(idle), abs=0.01)
        seen.clear()
        bank.heat(4.0, {1: 3.0})
        bank.wait_until(9.0, seen.append)
        heated = [r for r in seen if 4.0 < r.t < 7.0]
        gaps = [b.t - a.t for a, b in pairwise(heated)]
        assert max(gaps) <= 0.1 + took + 0.03 and len(heated) >= 0.8 * 3.0 / (0.1 + took)
        assert 3.99 + virtual.board.settling <= heated[0].t <= 4.0 + virtual.board.settling + 2 * took + 0.03
        assert all(r.closed[0] for r in heated)
        after = [r.t for r in seen if r.t > 7.0]
        assert after[0] <= 7.0 + virtual.board.settling + 2 * took + 0.03, (
            "that it has opened is seen at once"
        )
        assert after[1] - after[0] >= rest, "and then there is time again"
        for t in (4.0, 7.0):  # no report overlaps with the frames of a switching
            framed = t - virtual.board.contact_time - 0.001
            assert not any(r.t - took < framed < r.t for r in seen)
        assert bank._max_delay < 0.017


def test_edges_close_together_do_not_keep_the_controller_blind():
    """Four channels in turn: a report comes between them at least every half second."""
    rig = rig_with(supply={"max_total_current_a": 16}, limits={"min_off_s": 0.3, "duty": 1.0})
    with controlled(rig) as (_, bank, seen):
        bank.arm()
        for k in range(20):
            bank.heat(1.0 + 0.3 * k, {1 + k % 4: 0.15})
        bank.wait_until(8.0, seen.append)
        assert max(b.t - a.t for a, b in pairwise(seen)) < 0.6
        assert bank._max_delay < 0.05


def test_switchings_that_leave_no_time_for_a_read_back_end_the_run():
    rig = rig_with(supply={"max_total_current_a": 16}, limits={"min_off_s": 0.3})
    with controlled(rig) as (virtual, bank, seen):
        bank.arm()
        for k in range(30):
            bank.heat(1.0 + 0.12 * k, {1 + k % 4: 0.06})
        with raises(EldirError, "guardian.contacts-unseen", match=r"1\.5 s"):
            bank.wait_until(8.0, seen.append)
        assert max(b.t - a.t for a, b in pairwise(seen)) < 1.6
        bank.stop("not seen")
        assert not any(virtual.emulator.contacts)


def test_a_fan_is_no_heat():
    """It is closed all the time, counts for no current, and cannot be heated."""
    with controlled(rig_of(**FAN)) as (virtual, bank, seen):
        bank.arm()
        bank.heat(1.0, {1: 2.0, 2: 2.0})
        bank.wait_until(60.0, seen.append)
        assert edges(virtual, 5)[0][1] and len(edges(virtual, 5)) == 1
        assert seen[-1].closed == (False,) * 4 + (True,)


def test_a_contactor_on_the_first_channel():
    """Its number does not decide: it closes first, and opens in the same frame as the last spring."""
    values = rig_of("modbus").model_dump()
    for entry in values["channels"]:
        entry["channel"] += 1
    rig = Rig.from_json(values | {"cutoff": {"kind": "contactor", "channel": 1}})
    with controlled(rig) as (virtual, bank, _):
        bank.arm()
        bank.heat(1.0, {2: 2.0, 3: 2.0})
        bank.wait_until(5.0)
        order = sorted(virtual.emulator.contact_events, key=lambda e: e.t)
        assert [(e.channel, e.closed) for e in order[:3]] == [(1, True), (2, True), (3, True)]
        assert {e.channel for e in order[3:]} == {1, 2, 3} and len({e.t for e in order[3:]}) == 1


@pytest.mark.parametrize("apart", [round(0.02 * k, 2) for k in range(1, 14)])
def test_a_repeated_pulse_gives_way_to_an_edge(apart):
    """Pulses are sent again every quarter of a second; wherever another edge falls, it is on time."""
    with controlled(rig_of("modbus")) as (virtual, bank, _):
        told = flashes(virtual)
        bank.arm()
        bank.heat(1.0, {1: 3.0})
        bank.heat(1.5 + apart, {2: 1.0})
        bank.wait_until(6.0)
        assert edges(virtual, 2)[0][0] == pytest.approx(1.5 + apart, abs=1e-3)
        assert [closed for _, closed in edges(virtual, 1)] == [True, False], "it goes on all the time"
        sent = [t for t, channel, _ in told if channel == 1]
        assert max(b - a for a, b in pairwise(sent)) < 0.45
