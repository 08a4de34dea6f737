"""The MOSFET board, request by request: the firmware's answers at the edges, what its driver concludes."""

from __future__ import annotations

import re

import pytest

from eldir.errors import InputError
from eldir_hardware.clock import VirtualClock
from eldir_hardware.firmware.channel_limits import POWER_UP, ChannelLimits
from eldir_hardware.firmware.protocol import MAX_REQUEST, RequestHandler, crc16
from eldir_hardware.relay.board import RunRequirements
from eldir_hardware.relay.errors import ContactError, GarbledReplyError
from eldir_hardware.relay.line import SerialLine
from eldir_hardware.relay.mosfet import MosfetBoard
from eldir_hardware.testing import powered
from tests.hardware.firmware.mosfet_host import (
    CHANNELS,
    DUTY,
    HEARTBEAT_MS,
    LONGEST_MS,
    Board,
    frame,
    setting,
)
from tests.raised import raises


def answered(words: str | bytes, board: Board | None = None, sequence: int = 2) -> bytes:
    board = board or begun()
    return board.say(words if isinstance(words, bytes) else frame(sequence, words))


def begun() -> Board:
    board = Board()
    board.wait(60_000)
    board.begin(1)
    return board


def sealed(body: bytes) -> bytes:
    return body.lstrip(b":") + b"*%04X\n" % crc16(body.lstrip(b":"))


def code(answer: bytes) -> str:
    return answer[6:7].decode()


# The firmware.


def test_a_board_begins_with_everything_off_and_full_budgets():
    limits = ChannelLimits(CHANNELS, LONGEST_MS, DUTY, HEARTBEAT_MS, (3,), 0, POWER_UP)
    assert limits.power == limits.remaining_ms == [0] * CHANNELS and limits.on_mask() == 0
    assert limits.off_reason == [POWER_UP] * CHANNELS and limits.trip_reason == POWER_UP
    assert [limits.budget_percent(c) for c in range(CHANNELS)] == [0] * CHANNELS
    assert limits.next_event_ms() == -1


@pytest.mark.parametrize("power", [DUTY - 10, DUTY])
def test_powers_up_to_the_duty_end_by_the_heartbeat_alone(power):
    board = begun()
    board.limits.switch(0, power, 0)
    assert board.limits.next_event_ms() == HEARTBEAT_MS


def test_a_command_that_switches_off_what_is_off_leaves_no_time():
    board = begun()
    board.limits.switch(0, 100, 300)
    board.limits.switch(0, 0, 500)
    assert (board.limits.power[0], board.limits.remaining_ms[0], board.limits.off_reason[0]) == (0, 0, "C")


def test_why_a_channel_went_off():
    board = begun()
    answered(setting([(1, 100, 500), (2, 50, 0)]), board)
    assert answered("WHY 01", board, 3).endswith(b"*%04X\n" % crc16(answered("WHY 01", board, 3)[1:-6]))
    assert re.search(rb" 100 00500 \d{3} P\*", answered("WHY 01", board, 4))
    answered("OFF", board, 5)
    assert re.search(rb" 000 00000 \d{3} C\*", answered("WHY 01", board, 6))
    assert re.search(rb" 000 00000 \d{3} C\*", answered("WHY 02", board, 7))


@pytest.mark.parametrize("words", ["ASK", "LIMITS", "WHY 01", "WHY 03", "OFF"])
def test_requests_that_are_right(words):
    assert code(answered(words)) == "K"


@pytest.mark.parametrize(
    "words",
    [
        "ASK 1", "LIMITS 1", "OFF 1", "WHY", "WHY 01 02", "WHY 00", "WHY 04", "WHY 1", "SET",
        "SET 01=000/00000 02=000/00000", "BEGIN", "", "ask", "~", "HOW 01", "SET 01-000/00000",
    ],
)  # fmt: skip
def test_requests_that_are_wrong_are_answered_so(words):
    assert code(answered(words)) == "V"


@pytest.mark.parametrize(
    "line",
    [
        b"0002 ASK" + sealed(b"0002 ASK")[-6:],  # without its head
        b":" + sealed(b":002 ASK"),
        b":" + sealed(b":00002 ASK"),
        b":" + sealed(b":0002"),
        b":" + sealed(b":000g ASK"),
        b":" + sealed(b":0002 ASK\x7f"),
        b":" + sealed(b":0002 ASK\x1f"),
        b":" + sealed(b":0002 ASK").replace(b"\n", b"\r"),
        b":" + sealed(b":0002 ASK").replace(b"*", b"+"),
        b":*FFFF\n",
        b"\n",
        b"",
    ],
)
def test_lines_that_are_no_request_get_no_answer_and_are_no_heartbeat(line):
    board = begun()
    board.wait(HEARTBEAT_MS // 2)
    assert answered(line, board) == b"" and board.limits._silence_ms >= HEARTBEAT_MS // 2


def test_the_number_of_a_request_is_that_of_its_answer_also_0():
    for sequence in (0, 1, 0xFFFF):
        assert answered("ASK", sequence=sequence)[1:5] == b"%04X" % sequence


def test_the_longest_request_takes_all_channels_of_the_largest_board():
    assert len(frame(1, setting([(c, 100, 99_999) for c in range(1, 17)]))) < MAX_REQUEST


def test_a_setting_is_obeyed_whole_or_not_at_all():
    board = begun()
    answered(setting([(1, 100, 500)]), board)
    for k, wrong in enumerate([(4, 100, 0), (0, 100, 0), (2, 101, 0)], 3):
        assert code(answered(setting([(1, 0, 0), wrong]), board, k)) == "V"
        assert board.limits.power[0] == 100
    board.limits._spent[1] = board.limits._budget
    assert code(answered(setting([(1, 0, 0), (2, 100, 0)]), board, 6)) == "B"
    assert board.limits.power[0] == 100
    assert code(answered(setting([(1, 0, 0), (2, 0, 0)]), board, 7)) == "K"
    assert board.limits.power == [0, 0, 0]


def test_all_digits_of_a_time_count():
    board = begun()
    answered(setting([(1, DUTY, 12_345)]), board)
    assert board.limits.remaining_ms[0] == 12_345


def test_a_board_that_has_tripped_takes_only_zeros():
    board = begun()
    board.limits.trip("S")
    assert code(answered(setting([(1, 100, 0)]), board)) == "T"
    assert code(answered(setting([(1, 0, 0)]), board, 3)) == "K"


def test_every_token_is_used_once():
    board = begun()
    limits = ChannelLimits(CHANNELS, LONGEST_MS, DUTY, HEARTBEAT_MS, (), 0, POWER_UP)
    talk = RequestHandler(limits, 0x12345)
    told = talk.answer(frame(1, "ASK"), 0)[15:19]
    assert told == b"2345", "sixteen bits of it"
    assert code(talk.answer(frame(2, "BEGIN 02345"), 0)) == "X"
    assert code(talk.answer(frame(3, "BEGIN " + told.decode()), 0)) == "K"
    assert code(talk.answer(frame(4, "BEGIN " + told.decode()), 0)) == "X"
    assert board.limits.trip_reason == "-" == limits.trip_reason


# The driver.


class Scripted(SerialLine):
    """A line whose board gives these codes, or what a function makes of a request."""

    def __init__(self, further: str = "", given: str = "K", tripped: str = "-"):
        self.baud, self.bytes_written, self.sent_at, self.asked = 115200, 0, 0.0, []
        self.further, self.given, self.tripped = further, given, tripped
        self.garbled = 0

    def query_until(self, query, end, most, late=None):
        assert end == b"\n"
        self.asked.append(query)
        if self.garbled:
            self.garbled -= 1
            return b"?"
        body = b"%s %s 0000 %s 5EEE%s" % (
            query[1:5], self.given.encode(), self.tripped.encode(),
            self.further.encode() if b"LIMITS" in query or b"WHY" in query else b"",
        )  # fmt: skip
        return b"!" + body + b"*%04X\n" % crc16(body)


def board_on(line: Scripted) -> MosfetBoard:
    return MosfetBoard(line, 4, VirtualClock())


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ("O", "its sequence number is old"),
        ("T", "everything is off until a new run begins"),
        ("B", "a channel has used up its heat budget"),
        ("V", "invalid value or channel"),
        ("X", "the board was reset in the meantime"),
    ],
)
def test_every_refusal_is_told_with_its_reason(given, why):
    with pytest.raises(ContactError, match=f"the MOSFET board refuses ASK: {why};"):
        board_on(Scripted(given=given)).read_states()
    with pytest.raises(ContactError, match=f"{why}, because its program hung"):
        board_on(Scripted(given=given, tripped="W")).read_states()


@pytest.mark.parametrize(
    ("letter", "why"),
    [
        ("P", "its power was interrupted"),
        ("W", "its program hung and was reset by the watchdog"),
        ("S", "it received no command for too long"),
        ("B", "a channel used up its heat budget"),
        ("C", "it was commanded"),
        ("T", "its time had ended"),
        ("?", "unknown"),
    ],
)
def test_what_the_board_says_of_a_channel(letter, why):
    state = board_on(Scripted(f" 050 01500 025 {letter}")).channel_state(2)
    assert state == (0.5, 1.5, 0.25, why)


@pytest.mark.parametrize(("duty", "allowed"), [(0.07, True), (0.0701, False)])
def test_a_duty_of_just_what_the_board_allows_is_no_more(duty, allowed):
    """7 % is 7.000000000000001 in the computer's numbers."""
    line = Scripted(" 1 08 06200 007 00400 0000")
    terms = RunRequirements(6.1, duty, frozenset({1}), frozenset())
    if allowed:
        board_on(line).check_limits(terms)
    else:
        with raises(InputError, "board.other-limits", match=r"this run: duty; expected 0\.07"):
            board_on(line).check_limits(terms)


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        (
            " 2 08 06200 050 00400 0000",
            "another version of the protocol; expected 1; found 2",
        ),
        (" 1 08 06199 050 00400 0000", r"longest pulse; expected 6\.099 s, the"),
        (" 1 08 06200 049 00400 0000", r"this run: duty; expected 0\.49, the"),
        (" 1 03 06200 050 00400 0000", "number of channels; expected 3, the"),
        (" 1 08 06200 050 00399 0000", r"heartbeat; expected 0\.399 s, the"),
    ],
)
def test_a_board_with_a_limit_just_too_tight_is_refused_with_its_name(limits, message):
    terms = RunRequirements(6.1, 0.5, frozenset({1}), frozenset())
    board_on(Scripted(" 1 08 06200 050 00400 0000")).check_limits(terms)
    with raises(InputError, "board.other-limits", match=message):
        board_on(Scripted(limits)).check_limits(terms)


@pytest.mark.parametrize("further", [" 050 01500 025", " 050 01500 025 C", " 050 01500 025 CC"])
def test_an_answer_of_another_length_is_not_believed(further):
    board = board_on(Scripted(further))
    if len(further) == len(" 050 01500 025 C"):
        assert board.channel_state(1).left_s == 1.5
    else:
        with pytest.raises(GarbledReplyError):
            board.channel_state(1)


def test_requests_are_numbered_from_1_to_ffff_and_again():
    line = Scripted()
    board = board_on(line)
    board._sequence = 0xFFFE
    for _ in range(3):
        board.read_states()
    assert [query[:5] for query in line.asked] == [b":FFFF", b":0001", b":0002"]


def test_a_pulse_is_sent_to_the_millisecond_and_up_to_the_digits_of_the_protocol():
    line = Scripted()
    board = board_on(line)

    def sent(seconds: float) -> int:
        board.send({1: True}, {1: seconds})
        return int(line.asked[-1].split(b"/")[1].split(b"*")[0])

    whole = range(1, 10_000)
    assert any(1e3 * (k / 1000) > k for k in whole), "a time that the computer's numbers make longer"
    assert all(sent(k / 1000) == k for k in whole)
    assert sent(0.0004) == 1 and sent(1.0001) == 1001, "never shorter than ordered"
    assert sent(99.999) == sent(100.0) == sent(1e6) == 99_999


def test_a_report_that_cannot_be_read_is_asked_for_once_more():
    for count, calls in ((1, 2), (2, 2)):
        line = Scripted()
        line.garbled = count
        board = board_on(line)
        if count == 1:
            assert not any(board.verify())
        else:
            with pytest.raises(GarbledReplyError):
                board.verify()
        assert len(line.asked) == calls


def test_holds():
    with powered("mosfet") as p:
        p.board.hold({1: 0.5, 2: 0.0, 4: 1.0}, 0.0)
        assert (
            p.requests[-1].split(b" ", 1)[1].split(b"*")[0] == b"SET 01=050/00001,02=000/00001,04=100/00001"
        )
        p.board.hold({1: 0.5, 2: 0.0, 4: 1.0}, 0.3)
        assert p.board.verify() == (True, False, False, True)
        for key, powers in (
            ("relay channel", {0: 0.5}),
            ("relay channel", {5: 0.5}),
            ("power", {1: -0.01}),
            ("power", {1: 1.01}),
        ):
            with raises(InputError, "input.wrong-value", key):
                p.board.hold(powers, 0.3)


@pytest.mark.parametrize(("power", "on"), [(1.0, True), (0.01, True), (0.00497, False), (0.0, False)])
def test_a_held_channel_that_goes_off_by_itself_is_noticed(power, on):
    with powered("mosfet") as p:
        p.board.hold({1: power}, 0.3)
        assert p.board.verify()[0] is on
        p.emulated.reset()
        if on:
            with pytest.raises(
                ContactError, match=r"relay channel 1 did not switch: the board .* its power was interrupted"
            ):
                p.board.verify()
        else:
            assert not any(p.board.verify())


@pytest.mark.parametrize("changes", [{1: True}, {1: False, 4: True}, dict.fromkeys(range(1, 5), True)])
def test_the_driver_knows_the_length_of_its_commands(changes):
    with powered("mosfet") as p:
        p.board.send({1: False})  # begins
        p.board.send(changes)
        ((command, answer),) = p.board._frames(changes)
        assert command == len(p.requests[-1]) and answer == len("!0000 K 0000 - 5EEE*0000\n")
