"""What drivers write, when contacts move by that, and what they make of the answers; on a virtual clock."""

import re
from binascii import crc_hqx
from collections.abc import Iterable
from itertools import product

import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import ContactError, GarbledReplyError, NotProvenOffError, SilentBoardError
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.devices import get_driver
from eldir_hardware.testing import close_contacts, pass_time, powered
from tests.raised import raises

KINDS = installed_kinds()


def a0(operation: int, channels: Iterable[int]) -> list[str]:
    return [f"A0{c:02X}{operation:02X}{0xA0 + c + operation:02X}" for c in channels]


# What the manuals say, for four channels on the largest board of the kind: (close channel 2), (open 3 alone),
# (all off), (the first report, which also tells how many relays there are), (later reports). Of the MOSFET
# board the words, without number and CRC. A board of another package has no row here, and needs none.
BYTES = {
    "lcus": (["A00201A3"], ["A00300A3"], a0(0, range(1, 9)), ["FF"] * 2, ["FF"]),
    "feedback": (
        ["A00203A5"],
        ["A00302A5"],
        a0(2, range(1, 17)),
        a0(5, [*range(1, 18), 1, *range(5, 17)]),
        a0(5, range(1, 17)),
    ),
    "gd32": (
        ["A00201A3"],
        ["A00300A3"],
        ["A00F00AF"],
        a0(2, [*range(1, 15), 16, 1, *range(5, 15)]),
        a0(2, range(1, 15)),
    ),
    "modbus": (
        ["01050001FF00DDFA"],
        ["0105000200006C0A"],
        ["010500FF0000FDFA"],
        [
            "0101000000083DCC",
            "0101000000103DC6",
            "0101000000183C00",
            "0101000000203DD2",
            "0101000000283C14",
            "0101000000203DD2",
        ],
        ["0101000000203DD2"],
    ),
    "mosfet": (["ASK", "BEGIN 5EEE", "SET 02=100/00000"], ["SET 03=000/00000"], ["OFF"], ["ASK"], ["ASK"]),
    "numato": (
        ["relay on 1\r"],
        ["relay off 2\r"],
        ["relay writeall 00\r", "relay writeall 0\r", "relay writeall 0000\r"],
        ["relay readall\r"] * 4,
        ["relay readall\r"] * 2,
    ),
    "sainsmart": (
        [":FE050001FF00FD\r\n"],
        [":FE0500020000FB\r\n"],
        [":FE0F00000010020000E1\r\n"],
        [":FE0100000010F1\r\n"],
        [":FE0100000010F1\r\n"],
    ),
}
KNOWN_OFF = {"numato": ["relay writeall 0000\r"]}
"""All off, where it differs once the board's size is known."""
LARGEST = {"lcus": 8, "feedback": 16, "gd32": 14, "modbus": 32, "mosfet": 16, "numato": 16, "sainsmart": 16}


def raw(kind: str, texts: list[str]) -> list[bytes]:
    if kind == "mosfet":
        bodies = [f"{i:04X} {text}".encode() for i, text in enumerate(texts, 1)]
        return [b":" + body + b"*%04X\n" % crc_hqx(body, 0xFFFF) for body in bodies]
    return [t.encode() if kind in ("numato", "sainsmart") else bytes.fromhex(t) for t in texts]


@pytest.mark.parametrize("kind", BYTES)
def test_the_bytes_of_every_command(kind):
    close, open_, off, first, later = BYTES[kind]
    before = close + open_
    counted = before + off + first
    with powered(kind, relays=LARGEST[kind]) as p:
        p.board.send({2: True})
        p.board.send({3: False})
        p.clock.sleep_until(1.0)
        assert p.requests == raw(kind, before)
        p.board.all_off()
        # What it does not know, it drops bytewise.
        assert b"".join(p.requests) == b"".join(raw(kind, counted))
        p.board.all_off()
        assert b"".join(p.requests) == b"".join(raw(kind, counted + KNOWN_OFF.get(kind, off) + later))
        assert p.board.bytes_written == sum(map(len, p.requests))


@pytest.mark.parametrize("kind", KINDS)
def test_any_change_reaches_those_contacts_and_no_others(kind):
    """From any state, known to the driver or not: frames for several channels leave all others alone."""
    rng = np.random.default_rng(7)
    with powered(kind) as p:
        wanted = dict.fromkeys(range(1, 5), False)
        for number in range(60):
            chosen = rng.choice([1, 2, 3, 4], size=int(rng.integers(1, 5)), replace=False)
            alike = rng.random() < 0.5
            changes = {int(c): bool(number % 3) if alike else bool(rng.random() < 0.5) for c in chosen}
            if number == 30:
                p.board.all_off()
                wanted = dict.fromkeys(wanted, False)
            wanted |= changes
            assert p.board.switch(changes) == tuple(wanted.values()) == p.emulated.contacts


@pytest.mark.parametrize("kind", KINDS)
def test_contacts_move_when_the_driver_says(kind):
    """The middle of the edges is where `delay` puts it, by the emulated board; a report takes so long."""
    sets = [{2: True}, {1: True, 4: True}, {1: False, 2: False}, {3: True, 4: False}, {3: False}]
    sets += [dict.fromkeys(range(1, 5), True), dict.fromkeys(range(1, 5), False)]
    with powered(kind) as p:
        p.board.all_off()
        p.board.send({1: False})  # behind an all-off the MOSFET board is told first that a run begins
        for changes in sets:
            p.emulated.contact_events.clear()
            pass_time(p, 1.0)
            begun, told = p.clock.now(), p.board.switching_delay(changes)
            p.board.send(changes)
            p.clock.sleep_until(begun + 0.3)
            times = sorted(e.t for e in p.emulated.contact_events)
            assert len(times) == len(changes)
            assert (times[0] + times[-1]) / 2 - begun == pytest.approx(told, abs=1e-9)
            begun = p.clock.now()
            p.board.read_states()
            # GD32 answers with a character less where a channel is closed, Numato ends earlier.
            assert p.board.report_time - 0.009 < p.clock.now() - begun <= p.board.report_time + 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_report_is_believed_after_settling_only(kind):
    """Counted from the command's last byte on the wire. A command that is repeated moves nothing: it does not
    put the report off."""
    with powered(kind) as p:
        p.board.read_states()  # some boards are asked for their size once
        begun, before = p.clock.now(), p.board.bytes_written
        p.board.send({1: True})
        on_the_wire = 10 * (p.board.bytes_written - before) / p.board.baud
        sent = max(p.clock.now(), begun + on_the_wire)  # some boards answer a command
        assert p.board.report_valid_at == pytest.approx(sent + p.board.settling)
        p.board.verify()
        assert p.clock.now() == pytest.approx(sent + p.board.settling + p.board.report_time, abs=0.009)
        settled = p.board.report_valid_at
        p.board.send({1: True})
        assert p.board.report_valid_at == settled
        p.board.send({1: True, 2: True})
        assert p.board.report_valid_at > settled


@pytest.mark.parametrize(("kind", "channel"), list(product(KINDS, (0, 5))))
def test_a_channel_that_the_board_lacks_moves_none(kind, channel):
    with powered(kind) as p:
        with raises(InputError, "input.wrong-value", "relay channel", match=f"1 to 4; found {channel}"):
            p.board.send({1: True, channel: True})
        assert p.board.bytes_written == 0


@pytest.mark.parametrize("kind", KINDS)
def test_one_garbled_report_is_asked_again_and_two_are_an_error(kind):
    with powered(kind) as p:
        p.answer_faults.append("garbled")
        assert p.board.read_states() == (False,) * 4
        p.answer_faults.extend(["garbled"] * 2)
        with pytest.raises(GarbledReplyError):
            p.board.read_states()
        assert not p.answer_faults, "not asked a third time"
        p.answer_faults.append("silent")
        with pytest.raises(SilentBoardError):
            p.board.read_states()
        assert not p.answer_faults, "silence is waited out once"


def times_sent(kind: str, frames: list[str], requests: list[bytes]) -> int:
    heard = b"".join(requests)
    if kind == "mosfet":  # each with its own number
        return len(set(re.findall(rb":([0-9A-F]{4}) OFF\*[0-9A-F]{4}\n", heard)))
    return heard.count(b"".join(raw(kind, frames)))


@pytest.mark.parametrize(("kind", "spoilt"), list(product(BYTES, ("silent", "garbled"))))
def test_all_off_is_tried_four_times(kind, spoilt):
    """A report that is lost three times is asked a fourth time, each time behind new commands."""
    frames = BYTES[kind][2]
    known = {"numato": ["relay writeall 00\r"]}.get(kind, frames)
    answers = {"modbus": 1, "mosfet": 1, "numato": len(frames), "sainsmart": 1, "feedback": 4}.get(kind, 0)
    with powered(kind) as p:
        p.board.send({1: True})
        p.clock.sleep_until(1.0)
        p.requests.clear()
        p.answer_faults.extend((["valid"] * answers + [spoilt]) * 3)
        p.board.all_off()
        assert times_sent(kind, frames, p.requests) == 4
        p.requests.clear()
        p.answer_faults.extend((["valid"] * min(answers, 4 if kind == "feedback" else 1) + [spoilt]) * 4)
        with pytest.raises(NotProvenOffError, match="cut the heating supply now"):
            p.board.all_off()
        assert times_sent(kind, known, p.requests) == 4 and not p.answer_faults


@pytest.mark.parametrize("kind", KINDS)
def test_a_contact_that_stays_closed_is_named(kind):
    with powered(kind) as p:
        p.board.switch({3: True})
        p.emulated.faults.deaf.add(3)
        with pytest.raises(ContactError, match="channel 3 did not switch; expected open; found closed"):
            p.board.switch({3: False})
        with pytest.raises(NotProvenOffError, match="channel 3 did not switch"):
            p.board.all_off()


@pytest.mark.parametrize("kind", KINDS)
def test_armed_opens_before_and_after(kind):
    with powered(kind) as p:
        p.board.send({1: True})
        with p.board.armed() as board:
            assert board is p.board and not any(p.emulated.contacts)
            p.board.switch({2: True})
        assert not any(p.emulated.contacts)


@pytest.mark.parametrize(
    ("kind", "channels"),
    [(kind, 1) for kind in BYTES]
    + [
        ("modbus", 8),
        ("modbus", 16),
        ("numato", 8),
        ("numato", 16),
        ("sainsmart", 16),
        ("gd32", 14),
        ("mosfet", 16),
    ]
    + [("lcus", 8), ("feedback", 16)],
)
def test_boards_of_any_size(kind, channels):
    """Each channel alone, all together, and a report of them."""
    with powered(kind, channels) as p:
        p.board.all_off()
        for channel in range(1, channels + 1):
            states = p.board.switch({(channel - 2) % channels + 1: False} | {channel: True})
            assert [i for i, closed in enumerate(states, start=1) if closed] == [channel]
            assert states == p.emulated.contacts
        p.board.switch(dict.fromkeys(range(1, channels + 1), True))
        assert p.emulated.contacts == (True,) * channels
        p.board.all_off()


@pytest.mark.parametrize(
    ("kind", "channels", "seconds"),
    [
        ("lcus", 4, 41 * 10 / 9600),
        ("feedback", 4, 32 * 10 / 9600),
        ("gd32", 4, 56 * 10 / 115200),
        ("modbus", 4, 14 * 10 / 9600),
        ("modbus", 8, 14 * 10 / 9600),
        ("modbus", 9, 15 * 10 / 9600),
        ("mosfet", 4, 40 * 10 / 115200),
        ("numato", 8, 36 * 10 / 9600),
        ("numato", 9, 38 * 10 / 9600),
        ("sainsmart", 4, 32 * 10 / 9600),
    ],
)
def test_how_long_a_report_takes(kind, channels, seconds):
    """Question and longest answer, ten bits a byte."""
    with powered(kind, channels) as p:
        assert p.board.report_time == pytest.approx(seconds, abs=1e-9)


def test_which_boards_time_pulses():
    assert [kind for kind in BYTES if get_driver(kind).times_pulses] == ["modbus", "mosfet"]


@pytest.mark.parametrize(
    ("kind", "frames"),
    [
        ("lcus", [2, 1, 2, 4, 4]),
        ("feedback", [2, 1, 2, 4, 4]),
        ("gd32", [2, 1, 2, 1, 1]),
        ("modbus", [2, 1, 1, 4, 1]),
        ("mosfet", [3, 1, 1, 1, 1]),  # the first two begin a run
        ("numato", [1, 1, 1, 1, 1]),
        ("sainsmart", [1, 1, 1, 1, 1]),
    ],
)
def test_as_few_frames_as_the_board_allows(kind, frames):
    """Two that close, one that opens of two, two that open as the last, all that close, all that open."""
    everything = dict.fromkeys(range(1, 5), True)
    changes = [
        {1: True, 2: True},
        {1: False},
        {2: False, 3: False},
        everything,
        dict.fromkeys(everything, False),
    ]
    with powered(kind) as p:
        p.board.all_off()
        for change, number in zip(changes, frames, strict=True):
            p.requests.clear()
            p.board.send(change)
            p.clock.sleep_until(p.clock.now() + 0.2)
            assert len(p.requests) == number
            single = [r for r in p.requests if b"writeall" in r or b"FE0F" in r]
            assert len(change) > 1 or not single, "a channel alone has its own command"


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_driver_has_not_commanded_stays_as_it_is(kind):
    """Before the first all-off it knows no state: no frame for several channels may touch the others."""
    with powered(kind) as p:
        if kind == "mosfet":
            p.board.send({1: False})  # opens everything, as a run begins
        close_contacts(p.emulated, [3])
        p.board.send({1: True, 2: True})
        p.clock.sleep_until(1.0)
        assert p.emulated.contacts == (True, True, True, False)
        p.board.send({1: False, 2: False, 4: False})
        p.clock.sleep_until(2.0)
        assert p.emulated.contacts[:2] == (False, False)
        assert p.emulated.contacts[2] or kind == "modbus"  # which may open all where none is to stay closed


@pytest.mark.parametrize(("closed", "rounds"), [((1, 3, 4), 1), ((1, 2), 2)])
def test_all_off_commands_every_channel_although_one_command_fails(closed, rounds):
    """A driver that waits for answers: here channel 2 does not answer to the first command."""
    with powered("feedback") as p:
        close_contacts(p.emulated, closed)
        sent: list[int] = []
        command = p.board._command

        def failing(channel: int, closed: bool) -> None:
            sent.append(channel)
            if sent.count(2) == 1 and channel == 2:
                raise SilentBoardError("no answer")
            command(channel, closed)

        p.board._command = failing
        p.board._command_all_off = lambda: RelayBoard._command_all_off(p.board)
        p.board.all_off()
        assert sent == [1, 2, 3, 4] * rounds, "only the read-back counts"
        assert not any(p.emulated.contacts)


@pytest.mark.parametrize(
    ("kind", "wire", "reports"),
    [
        ("lcus", 32, 1),
        ("feedback", 80, 1),  # frames for the four relays that answer leave room for it
        ("gd32", 4, 1),
        ("modbus", 8, 1),
        ("mosfet", 40, 1),
        ("numato", 18, 2),
        ("sainsmart", 23, 1),
    ],
)
def test_how_long_all_off_takes(kind, wire, reports):
    """Its frames, settling, and the reports: nothing is waited for beyond that once the size is known.

    Answers pass by while the contacts settle; a gate settles at once, and the MOSFET board's is waited for.
    """
    with powered(kind) as p:
        p.board.all_off()
        begun = p.clock.now()
        p.board.all_off()
        seconds = wire * 10 / p.board.baud + p.board.settling + reports * p.board.report_time
        assert seconds - 0.005 - 0.009 * (reports - 1) < p.clock.now() - begun <= seconds + 1e-9
