"""Relay drivers against emulated boards: literal frames, conformance, faults, noise."""

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from itertools import permutations
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldir.errors import InputError
from eldir_app.commands.rig.new import new
from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.relay import feedback, gd32, lcus, modbus, sainsmart
from eldir_hardware.relay.a0 import a0_frame
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import (
    ContactError,
    GarbledReplyError,
    NotProvenOffError,
    PortError,
    RelayError,
    SilentBoardError,
)
from eldir_hardware.relay.registration import installed_kinds
from eldir_hardware.rig.devices import get_driver, get_emulator
from tests.hardware.relay.relay_answers import ANSWERS, CHANCE, CHECKSUM, believed_wrongly
from tests.raised import raises
from tests.side_by_side import side_by_side

KINDS = installed_kinds()


@contextmanager
def connected(kind):
    """An emulated board and the driver on its port, in real time."""
    clock = WallClock()
    emulated = get_emulator(kind)(4, clock)
    board = get_driver(kind)(emulated.start(), 4, clock)
    try:
        yield emulated, board
    finally:
        board.close()
        emulated.close()


@pytest.fixture(params=KINDS)
def bench(request):
    """Those of each kind."""
    with connected(request.param) as both:
        yield both


# Conformance: every driver does this.


def test_every_kind_is_known_everywhere():
    """Each row of the table names a driver and an emulator; those of this package also a sound answer, by the
    manual."""
    option = get_type_hints(new, include_extras=True)["board"].__metadata__[0]
    assert all(f" {kind} " in option.help.replace(";", " ") for kind in KINDS)
    ours = {kind for kind in KINDS if get_driver(kind).__module__.startswith("eldir_hardware.relay.")}
    assert ours <= set(ANSWERS) <= set(KINDS)
    for kind in KINDS:
        assert issubclass(get_driver(kind), RelayBoard) and issubclass(get_emulator(kind), EmulatedBoard)


def test_contacts_follow_commands_and_the_report_agrees(bench):
    emulated, board = bench
    assert board.read_states() == (False,) * 4
    assert board.switch({1: True, 3: True}) == (True, False, True, False)
    assert emulated.contacts == (True, False, True, False)
    assert board.switch({1: False, 4: True}) == (False, False, True, True)
    board.all_off()
    assert emulated.contacts == (False,) * 4
    assert [(e.channel, e.closed) for e in emulated.contact_events[:2]] == [(1, True), (3, True)]


def test_a_command_takes_its_time_on_the_wire(bench):
    emulated, board = bench
    begun = time.monotonic()
    board.send({2: True})
    board.verify()
    edge = emulated.contact_events[0]
    assert board.switching_delay({2: True}) - 1e-3 < edge.t - begun < 0.5
    assert time.monotonic() - begun > board.settling + board.report_time - 1e-3


def test_closing_the_port_leaves_the_contacts(bench):
    emulated, board = bench
    board.switch({2: True})
    board.close()
    assert emulated.contacts == (False, True, False, False)


def test_armed_switches_off_on_every_way_out(bench):
    emulated, board = bench
    with pytest.raises(ZeroDivisionError), board.armed():
        board.switch({1: True})
        raise ZeroDivisionError
    assert emulated.contacts == (False,) * 4


def test_a_channel_that_does_not_follow(bench):
    emulated, board = bench
    emulated.faults.deaf.add(2)
    with pytest.raises(ContactError, match="channel 2 did not switch; expected closed; found open"):
        board.switch({2: True})


def test_a_board_without_answer(bench):
    emulated, board = bench
    emulated.faults.silent = True
    with pytest.raises(SilentBoardError, match="did not answer"):
        board.read_states()


def test_a_garbled_answer(bench):
    emulated, board = bench
    emulated.faults.garbled = True
    with pytest.raises(GarbledReplyError):
        board.read_states()
    emulated.faults.garbled = False
    assert board.read_states() == (False,) * 4, "what is left of the noise does no harm"


@pytest.mark.parametrize("kind", KINDS)
def test_all_contacts_open_whatever_becomes_of_the_answers(kind):
    """By the emulator's own contacts: an answer that is lost, damaged or late must not keep one closed."""

    def check(fault: str, value: object) -> None:
        with connected(kind) as (emulated, board):
            board.switch(dict.fromkeys(range(1, 5), True))
            assert emulated.contacts == (True,) * 4
            setattr(emulated.faults, fault, value)
            begun = time.monotonic()
            with suppress(NotProvenOffError):  # a late answer may still prove it
                board.all_off()
            assert emulated.contacts == (False,) * 4
            assert max(e.t for e in emulated.contact_events if not e.closed) - begun < 0.5

    side_by_side(check, [("silent", True), ("garbled", True), ("late", 0.35), ("late", 0.7)])


def test_unknown_channels_are_refused(bench):
    _, board = bench
    with raises(InputError, "input.wrong-value", "relay channel", match="1 to 4; found 5"):
        board.send({5: True})


def test_one_program_at_a_time(bench, request):
    emulated, board = bench
    with pytest.raises(PortError, match="cannot open"):
        type(board)(emulated.port, 4, WallClock())


@pytest.mark.parametrize("kind", KINDS)
def test_a_port_that_is_not_there(kind):
    with pytest.raises(PortError, match="check the cable"):
        get_driver(kind)("/dev/no-such-port", 4, WallClock())


# LCUS: the frames of its data sheet, and noise.


def test_lcus_frames():
    assert a0_frame(1, 1) == bytes.fromhex("A00101A2")
    assert a0_frame(1, 0) == bytes.fromhex("A00100A1")
    assert a0_frame(8, 1) == bytes.fromhex("A00801A9")


def test_lcus_report():
    report = b"CH1: ON \r\nCH2: OFF\r\n"
    assert lcus.parse_report(report, 2) == (True, False)
    for damaged in (report[:-1], report + b"\n", b"CH2: OFF\r\nCH1: ON \r\n", report.replace(b"ON ", b"0N ")):
        with pytest.raises(GarbledReplyError):
            lcus.parse_report(damaged, 2)


@given(st.binary(max_size=100), st.integers(1, 8))
def test_lcus_parser_believes_only_whole_reports(data, channels):
    try:
        states = lcus.parse_report(data, channels)
    except RelayError:
        return
    words = {True: "ON ", False: "OFF"}
    assert data.decode() == "".join(f"CH{i}: {words[s]}\r\n" for i, s in enumerate(states, 1))


@pytest.mark.parametrize("kind", sorted(ANSWERS))
def test_an_answer_from_the_manual(kind):
    answer = ANSWERS[kind]
    assert answer.parse(answer.sound) == answer.states


@pytest.mark.parametrize("count", [3_000, pytest.param(10_000, marks=pytest.mark.stress)])
@pytest.mark.parametrize("kind", KINDS)
def test_thousands_of_mutated_answers(kind, count):
    """Nothing but the driver's own error, and no state that the board did not report."""
    assert believed_wrongly(kind, count) <= CHANCE.get(kind, CHECKSUM)


# The other dialects: frames from their pages.


def test_feedback_frames():
    assert a0_frame(1, 3) == bytes.fromhex("A00103A4"), "on"
    assert a0_frame(1, 2) == bytes.fromhex("A00102A3"), "off"
    assert a0_frame(2, 5) == bytes.fromhex("A00205A7"), "query"
    for other in ("A00101A3", "A00202A4", "A00201A2", "", "A00201A300"):
        with pytest.raises(GarbledReplyError):
            feedback.parse_state(bytes.fromhex(other), 2)


def test_gd32_frames():
    assert a0_frame(15, 0) == bytes.fromhex("A00F00AF"), "all off"
    assert a0_frame(3, 2) == bytes.fromhex("A00302A5"), "query"
    with pytest.raises(GarbledReplyError):
        gd32.parse_line(b"CH1:ON\r\n", 2)


def test_sainsmart_frames():
    assert sainsmart.ascii_request(15, 0, 0, 0, 16, 2, 0, 0) == b":FE0F00000010020000E1\r\n", "all off"
    assert sainsmart.ascii_request(5, 0, 0, 0xFF, 0) == b":FE050000FF00FE\r\n"
    assert sainsmart.ascii_request(1, 0, 0, 0, 16) == b":FE0100000010F1\r\n"


def test_numato_words():
    """Up to sixteen channels, of which the last is F."""
    emulated = get_emulator("numato")(16, WallClock())
    board = get_driver("numato")(emulated.start(), 16, WallClock())
    board.all_off()
    board.switch({16: True, 9: True})
    assert [i for i, closed in enumerate(emulated.contacts, 1) if closed] == [9, 16]
    assert emulated.obey(b"relay readall\r") == b"relay readall\n\r8100\n\r>"
    assert emulated.obey(b"relay off F\r") == b"relay off F\n\r>"
    board.close()
    emulated.close()


def test_the_byte_that_opens_one_board_asks_another():
    """A wrong dialect never passes for the right one: `off` of dialect B is the query of C."""
    for kind, wrong in permutations(("feedback", "gd32", "lcus"), 2):
        clock = WallClock()
        emulated = get_emulator(kind)(4, clock)
        board = get_driver(wrong)(emulated.start(), 4, clock)
        with pytest.raises(RelayError):
            board.switch({1: True})
        board.close()
        emulated.close()


@pytest.mark.parametrize("kind", ["gd32", "modbus", "numato", "sainsmart"])
def test_edges_that_belong_together_go_out_in_one_frame(kind):
    clock = WallClock()
    emulated = get_emulator(kind)(4, clock)
    board = get_driver(kind)(emulated.start(), 4, clock)
    board.all_off()
    together = dict.fromkeys((1, 2, 3, 4), True)
    board.switch(together)
    before = board.bytes_written
    board.send(dict.fromkeys(together, False))
    assert board.bytes_written - before < 40
    board.verify()
    closing = [e.t for e in emulated.contact_events if not e.closed]
    assert len(closing) == 4 and max(closing) == min(closing)
    board.close()
    emulated.close()


@pytest.mark.parametrize("kind", KINDS)
def test_an_emulated_board_survives_noise(kind):
    rng = np.random.default_rng(5)
    board = get_emulator(kind)(4, WallClock())
    for _ in range(2000):
        data = rng.bytes(int(rng.integers(1, 12)))
        while length := board.request_length(data):
            assert 1 <= length <= len(data)
            board.obey(data[:length])
            data = data[length:]


@pytest.mark.parametrize("kind", KINDS)
def test_emulate_offers_a_board_to_other_programs(kind, tmp_path):
    trace = tmp_path / "edges.jsonl"
    command = [
        sys.executable,
        "-c",
        "from eldir_app.commands.rig import rig; rig()",
        "emulate",
        "--board",
        kind,
        "--trace",
        str(trace),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            port = process.stdout.readline().strip()
            board = get_driver(kind)(port, 4, WallClock())
            before = time.monotonic()
            board.switch({2: True})
            after = time.monotonic()
            board.all_off()
            board.close()
            process.send_signal(signal.SIGTERM)
            assert process.wait(5) == 0
        finally:
            process.kill()
    edges = [json.loads(line) for line in trace.read_text().splitlines()]
    assert [(e["channel"], e["closed"]) for e in edges] == [(2, True), (2, False)]
    assert before < edges[0]["t_s"] < after


# Modbus: frames that were checked against a Modbus library, pulses timed by the board, noise.


def test_modbus_frames():
    for arguments, wanted in (
        ((5, 0, 0xFF00), "01050000FF008C3A"),
        ((5, 0, 0), "010500000000CDCA"),
        ((5, 0xFF, 0xFF00), "010500FFFF00BC0A"),
        ((5, 0xFF, 0), "010500FF0000FDFA"),
        ((1, 0, 8), "0101000000083DCC"),
        ((5, 0x0200, 7), "0105020000078DB0"),
    ):
        assert modbus.rtu_request(*arguments) == bytes.fromhex(wanted)


def test_emulated_modbus_knows_the_same_frames():
    board = get_emulator("modbus")(8, WallClock())
    for request, answer in (
        ("01050000FF008C3A", "01050000FF008C3A"),
        ("0101000000083DCC", "010101019048"),
        ("010500FF0000FDFA", "010500FF0000FDFA"),
        ("01050007FF003DFB", "01050007FF003DFB"),
    ):
        data = bytes.fromhex(request)
        assert board.request_length(data) == 8
        assert board.obey(data) == bytes.fromhex(answer)
    assert board.contacts == (False,) * 7 + (True,)


@given(st.binary(max_size=12), st.integers(1, 16))
def test_modbus_parser_believes_only_whole_answers(data, channels):
    try:
        states = modbus.parse_rtu_coils(data, channels)
    except RelayError:
        return
    assert len(states) == channels and data[:2] == b"\x01\x01"


def test_modbus_pulses_end_by_themselves():
    """The host does nothing after the pulse has begun, as if it had died."""
    clock = WallClock()
    emulated = get_emulator("modbus")(4, clock)
    board = get_driver("modbus")(emulated.start(), 4, clock)
    board.send({2: True}, {2: 0.25})
    assert board.verify() == (False, True, False, False)
    board.close()
    deadline = time.monotonic() + 5
    while len(emulated.contact_events) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    closed, opened = emulated.contact_events
    assert opened.t - closed.t == pytest.approx(0.3, abs=1e-6), "rounded up to 100 ms"
    assert emulated.contacts == (False,) * 4
    emulated.close()


@pytest.mark.parametrize("restarts", [True, False])
def test_a_second_flash_on_the_emulated_board(restarts):
    clock = VirtualClock()
    board = get_emulator("modbus")(1, clock)
    board.retriggerable = restarts
    flash = modbus.rtu_request(5, 0x0200, 10)
    board.obey(flash)
    clock.sleep_until(0.6)
    board._wire_free_at = 0.6
    board.obey(flash)
    clock.sleep_until(3.0)
    assert board.contact_events[-1].t == pytest.approx((1.6 if restarts else 1.0) + 0.01)
