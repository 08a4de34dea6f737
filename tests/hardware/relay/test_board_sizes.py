"""What boards tell of their size, how long their frames are, and the answers that come late."""

import re

import pytest

from eldir_hardware.clock import VirtualClock
from eldir_hardware.relay.a0 import a0_frame
from eldir_hardware.relay.errors import GarbledReplyError, NotProvenOffError, RelayError, SilentBoardError
from eldir_hardware.relay.feedback import FeedbackBoard
from eldir_hardware.relay.lcus import LcusBoard, parse_report
from eldir_hardware.relay.numato import NumatoBoard, parse_answer
from eldir_hardware.relay.registration import get_board
from eldir_hardware.relay.sainsmart import parse_ascii_coils
from eldir_hardware.safety.off_frames import RecordingLine, off_bursts, off_frames
from eldir_hardware.testing import close_contacts, powered, wired
from tests.hardware.emulated_rigs import emulated, run

MOST = {"feedback": 16, "gd32": 14, "lcus": 8, "modbus": 16, "mosfet": 16, "numato": 16, "sainsmart": 16}
ALL = {
    "feedback": [a0_frame(c, 2) for c in range(1, 17)],
    "gd32": [bytes.fromhex("A00F00AF")],
    "lcus": [a0_frame(c, 0) for c in range(1, 9)],
    "modbus": [bytes.fromhex("010500FF0000FDFA")],
    "sainsmart": [b":FE0F00000010020000E1\r\n"],
}


@pytest.mark.parametrize("kind", MOST)
def test_relays_of_the_largest_board(kind):
    assert get_board(kind).max_channels == MOST[kind]


@pytest.mark.parametrize("kind", ALL)
def test_every_frame_that_opens_everything_goes_out_once(kind):
    for channels in (None, 1, MOST[kind]):
        assert off_frames(kind, channels) == b"".join(ALL[kind])
    assert off_bursts([(kind, None)]) == [(b"".join(ALL[kind]), get_board(kind).driver.baud)]
    assert off_bursts([(kind, 1), (kind, 2)]) == [(2 * b"".join(ALL[kind]), get_board(kind).driver.baud)] * 2


def test_the_mask_of_a_modules_own_width_comes_first():
    small, wide = "relay writeall 00\r", "relay writeall 0000\r"
    for channels, first in ((4, small), (8, small), (9, wide), (16, wide), (None, wide)):
        frames = re.findall(r"[^\r]+\r", off_frames("numato", channels).decode())
        assert frames[0] == first and sorted(frames) == sorted([small, wide, "relay writeall 0\r"])


def test_a_recorded_line_answers_nothing_and_needs_no_port():
    line = RecordingLine(9600)
    line.write(b"ab")
    assert line._exchange(b"cd", 3, lambda: b"never asked") == b""
    with pytest.raises(SilentBoardError, match="the relay board at nowhere did not answer"):
        line.query(b"e", 1)
    assert line.frames == [b"ab", b"cd", b"e"] and line.bytes_written == 5
    assert line.wire_time(96) == pytest.approx(0.1)
    line.close()


def test_a_driver_that_fails_without_a_board_still_tells_its_frames(monkeypatch):
    driver = get_board("lcus").driver
    command = driver._command_all_off

    def fails(self) -> None:
        command(self)
        raise RelayError("nobody is there")

    monkeypatch.setattr(driver, "_command_all_off", fails)
    assert off_frames("lcus") == b"".join(ALL["lcus"])


# Numato.


@pytest.mark.parametrize("answers", [1, 5, 8])
def test_echoes_that_come_late_do_not_spoil_a_report(answers):
    """As those of the frames that `eldir rig off` sends while the guardian asks."""
    emulated, board, _ = wired("numato", 4, 8)
    late = [b"relay writeall 00\n\r>", b"relay on 1\n\r>", b"relay off A\r\n\r>"]
    deliver = emulated.deliver

    def first_others(answer: bytes) -> None:
        emulated.deliver = deliver
        for k in range(answers):
            deliver(late[k % 3])
        deliver(answer)

    emulated.deliver = first_others
    assert board.read_states(attempts=1) == (False,) * 4


def test_whatever_else_comes_first_is_no_report():
    for other in (b"relay readall\n\r0\x00\n\r>", b"relay writeall 0g\n\r>", b"?relay on 1\n\r>", b"\n\r>"):
        emulated, board, _ = wired("numato", 4, 8)
        deliver = emulated.deliver

        def first_other(answer: bytes, other=other, emulated=emulated, deliver=deliver) -> None:
            emulated.deliver = deliver
            deliver(other)
            deliver(answer)

        emulated.deliver = first_other
        with pytest.raises(GarbledReplyError):
            board.read_states(attempts=1)


def test_the_value_of_another_command_is_no_echo():
    """`relay on 1` is confirmed by its own echo alone."""
    emulated, board, _ = wired("numato", 4, 8)
    board.send({2: True})
    assert emulated.contacts[1]
    emulated.obey = lambda request: b"relay readall\n\r00\n\r>"
    with pytest.raises(GarbledReplyError, match="expected its echo"):
        board.send({2: False})


@pytest.mark.parametrize(
    ("answer", "least", "value"),
    [
        (b"c\n\r>", 0, ""),
        (b"c\r\n\r>", 0, ""),
        (b"c\n\r0f\n\r>", 2, "0f"),
        (b"c\r\n\r0f\n\r>", 2, "0f"),
        (b"c\n\r0123456789abcdef\n\r>", 2, "0123456789abcdef"),
        (b"c\n\r0123456789abcdef0\n\r>", 2, None),
        (b"c\n\rf\n\r>", 2, None),
        (b"c\n\r>", 1, None),
        (b"c\n\r0f\n\r>", 0, None),
        (b"?c\n\r>", 0, None),
        (b"\n\r>", 0, None),
    ],
)
def test_answers_by_the_letter(answer, least, value):
    if value is None:
        with pytest.raises(GarbledReplyError):
            parse_answer(answer, "c", least)
    else:
        assert parse_answer(answer, "c", least) == value
        if not least:
            assert parse_answer(answer, "c") == value


def test_a_module_of_five_relays_may_have_two_digits():
    for channels, digits, sound in ((4, 1, True), (5, 1, False), (5, 2, True), (9, 2, False)):
        emulated, board, _ = wired("numato", channels, channels)
        emulated.digits = digits
        if sound:
            assert board.read_states() == (False,) * channels
        else:
            with pytest.raises(GarbledReplyError):
                board.read_states(attempts=1)


@pytest.mark.parametrize("changes", [{1: True}, {1: False}, {1: True, 2: False}])
def test_the_driver_knows_the_length_of_words_and_echoes(changes):
    with powered("numato") as p:
        echoes: list[bytes] = []
        answer = p.emulated.send_answer
        p.emulated.send_answer = lambda data: (echoes.append(data), answer(data))[1]
        frames = p.board._frames(changes)
        p.board.send(changes)
        assert frames == [(len(r), len(e)) for r, e in zip(p.requests, echoes, strict=True)]


def test_a_glance_is_one_report():
    for kind, one in (("lcus", [b"\xff"]), ("numato", [b"relay readall\r"])):
        with powered(kind, 4, 8) as p:
            assert p.board.reports_all_open() is True and p.requests == one
            assert p.board._report_once() == (False,) * 8
            p.emulated.set_coil(7, True)
            p.clock.sleep_until(1.0)
            assert p.board.reports_all_open() is False, "also beyond the rig file's four"
            p.answer_faults.append("silent")
            assert p.board.reports_all_open() is False


def test_a_glance_of_a_board_whose_report_has_one_size():
    for kind in ("feedback", "modbus", "sainsmart"):
        with powered(kind) as p:
            assert p.board.reports_all_open() is True
            p.emulated.set_coil(2, True)
            p.clock.sleep_until(p.clock.now() + 1.0)
            assert p.board.reports_all_open() is False


# LCUS.


def test_reports_of_two_lengths_are_none():
    """One was cut short, and must not hide relays."""
    emulated, board, _ = wired("lcus", 4, 8)
    whole, deliver = [], emulated.deliver

    def cut(answer: bytes) -> None:
        whole.append(answer)
        deliver(answer[:40] if len(whole) == 1 else answer)

    emulated.deliver = cut
    with pytest.raises(GarbledReplyError, match="reports differ in length; expected 4 channels; found 8"):
        board.read_states(attempts=1)
    assert board.read_states() == (False,) * 4 and len(whole) == 4
    assert board.report_time == pytest.approx(81 * 10 / 9600), "now that it is known"


def test_a_report_is_read_to_its_end():
    sound = b"".join(b"CH%d: %s\r\n" % (c, b"ON " if c == 3 else b"OFF") for c in range(1, 9))
    assert parse_report(sound, 4) == tuple(c == 3 for c in range(1, 9))
    for wrong in (sound[:-1], sound + b"C", sound[:35], sound[10:], b""):
        with pytest.raises(GarbledReplyError):
            parse_report(wrong, 4)


def test_the_time_of_a_report_before_the_size_is_known():
    assert LcusBoard(RecordingLine(9600), 4, VirtualClock()).report_time == pytest.approx(41 * 10 / 9600)
    numato = NumatoBoard(RecordingLine(9600), 4, VirtualClock())
    assert numato.report_time == pytest.approx((2 * 13 + 2 + 8) * 10 / 9600)


# Feedback.


@pytest.mark.parametrize(("relays", "answers"), [(0, 16), (4, 4), (16, 16)])
def test_frames_leave_room_for_the_answers_that_may_come(relays, answers):
    board = FeedbackBoard(RecordingLine(9600), 4, VirtualClock())
    board._relays = relays
    board._command_all_off()
    assert board._clock.now() == pytest.approx((16 + answers) * 4 * 10 / 9600)


def test_relays_beyond_the_rig_file_answer_in_order_or_prove_nothing():
    emulated, board, _ = wired("feedback", 4, 8)
    board.all_off()
    assert board._relays == 8
    emulated, board, _ = wired("feedback", 4, 8)
    obey = emulated.obey
    emulated.obey = lambda request: b"" if request == a0_frame(6, 5) else obey(request)
    with pytest.raises(RelayError):
        board._report_all()
    emulated, board, _ = wired("feedback", 4, 8)
    once = iter([b"junk"])
    obey = emulated.obey
    emulated.obey = lambda request: next(once, obey(request)) if request == a0_frame(6, 5) else obey(request)
    with pytest.raises(GarbledReplyError, match="found 6a 75 6e 6b"):
        board._report_all()


# Modbus and SainSmart.


@pytest.mark.parametrize(("seconds", "steps"), [(0.1, 1), (0.3, 3), (0.1 + 0.2, 3), (0.31, 4), (0.5, 5)])
def test_a_pulse_lasts_as_few_steps_as_it_needs(seconds, steps):
    with powered("modbus") as p:
        p.board._pulse(2, seconds)
        assert p.requests[-1][:6] == bytes((1, 5, 2, 1, 0, steps))


def test_one_channel_that_opens_gets_its_own_frame():
    with powered("modbus") as p:
        p.board.all_off()
        p.board.send({1: False})
        assert p.requests[-1][:6] == bytes((1, 5, 0, 0, 0, 0))
        p.board.send({1: False, 2: False})
        assert p.requests[-1][:6] == bytes((1, 5, 0, 0xFF, 0, 0)), "together they are the last"


@pytest.mark.parametrize(("relays", "length"), [(8, 6), (16, 7), (32, 9)])
def test_the_time_of_a_modbus_report(relays, length):
    with powered("modbus", 4, relays) as p:
        assert p.board.report_time == pytest.approx((8 + 6) * 10 / 9600), "before it is known"
        p.board.read_states()
        assert p.board.report_time == pytest.approx((8 + length) * 10 / 9600)


@pytest.mark.parametrize("wrong", [b"?", b"G", b"a", b" "])
def test_digits_that_are_none(wrong):
    answer = b":FE01020000FF\r\n"
    assert parse_ascii_coils(answer, 16) == (False,) * 16
    for place in range(1, len(answer) - 2):
        with pytest.raises(GarbledReplyError):
            parse_ascii_coils(answer[:place] + wrong + answer[place + 1 :], 16)


def test_a_mask_that_is_not_confirmed():
    with powered("sainsmart") as p:
        p.board.all_off()
        p.emulated.obey = lambda request: b":FE0F0000000FE4\r\n"  # fifteen coils
        with pytest.raises(GarbledReplyError):
            p.board.send({1: True, 2: True, 3: True, 4: True})


# Larger than any board of the kind.

BEYOND = {"feedback": (16, 17), "gd32": (14, 16), "lcus": (8, 16), "modbus": (32, 40)}
"""Relays of the largest board, and of one that is larger."""


@pytest.mark.parametrize("kind", BEYOND)
@pytest.mark.parametrize("used", [4, "most"])
def test_a_board_of_more_relays_than_its_kind_has_is_refused(kind, used):
    most, relays = BEYOND[kind]
    with powered(kind, min(most, 16) if used == "most" else used, relays) as p:
        close_contacts(p.emulated, [relays])
        with pytest.raises(
            NotProvenOffError, match=f"more relays than its kind; expected at most {most}; found"
        ):
            p.board.all_off()


@pytest.mark.parametrize("kind", BEYOND)
def test_the_largest_board_of_a_kind_is_none_of_them(kind):
    most, _ = BEYOND[kind]
    with powered(kind, 4, most) as p:
        close_contacts(p.emulated, [1, most])
        p.board.all_off()
        assert not any(p.emulated.contacts)


@pytest.mark.parametrize("relays", [16, 24, 32])
def test_modbus_boards_tell_every_eight_coils(relays):
    """24: a question for twice sixteen coils is refused."""
    with powered("modbus", 4, relays) as p:
        close_contacts(p.emulated, [relays])
        p.emulated.faults.deaf.add(relays)
        with pytest.raises(NotProvenOffError, match=f"contact {relays} is closed"):
            p.board.all_off()


def test_off_does_not_take_the_first_lines_of_a_report_for_all():
    """Without a known number of channels: neither 8 nor fewer relays answer completely."""
    with emulated("lcus", 16) as board:
        close_contacts(board, [9])
        done = run("off", "--port", board.port, "--board", "lcus")
        assert done.exit_code == 1 and "more relays than its kind" in done.output
        assert board.contacts[8], "no frame of this kind opens it: the words must say so"
