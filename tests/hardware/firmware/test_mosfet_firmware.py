"""The MOSFET board's firmware: no host, whatever it sends, keeps a channel on beyond the board's limits."""

import binascii
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hypothesis import given, settings

from eldir_hardware.firmware import limits
from eldir_hardware.firmware.channel_limits import Modulation, elapsed_ms
from eldir_hardware.firmware.protocol import MAX_REQUEST, crc16
from tests.hardware.firmware.micropython import micropython
from tests.hardware.firmware.mosfet_host import (
    ACTIONS,
    CHANNELS,
    DUTY,
    FIRST_TICK,
    HEARTBEAT_MS,
    LONGEST_MS,
    MOST_STEP_MS,
    STEADY,
    WRAP,
    Board,
    frame,
    play,
    setting,
)
from tests.paths import ROOT

FIRMWARE = ROOT / "hardware" / "eldir_hardware" / "firmware"


def heating(power: int = 100, channel: int = 1, ms: int = 0) -> Board:
    """A board that is cold, whose host has begun and switches one channel on."""
    board = Board()
    board.wait(60_000)
    board.begin(1)
    assert board.say(frame(2, setting([(channel, power, ms)])))[6:7] == b"K"
    return board


def keep_on(board: Board, ms: int, sequence: int = 100, every: int = 100) -> int:
    """Beat until something goes off; for how long it was on [ms]."""
    begun = board.now_ms
    while board.limits.on_mask() and board.now_ms - begun < ms:
        sequence += 1
        board.say(frame(sequence, "ASK"))
        board.wait(every, 1)
    return (
        next((m.begin_ms for m in board.moments if m.begin_ms >= begun and not any(m.power)), board.now_ms)
        - begun
    )


# What each limit does.


def test_full_power_lasts_its_longest_time_from_cold() -> None:
    board = heating()
    assert keep_on(board, 10_000) == LONGEST_MS
    assert board.limits.trip_reason == "B" and board.limits.off_reason[0] == "B"


def test_a_hold_at_the_duty_has_no_end_and_one_above_it_has() -> None:
    assert keep_on(heating(DUTY), 30_000) == 30_000
    most = LONGEST_MS * (100 - DUTY)
    assert keep_on(heating(DUTY + 10), 30_000) == most // 10


def test_after_a_pulse_the_budget_comes_back_by_the_duty() -> None:
    board = heating()
    keep_on(board, 10_000)
    board.wait(300, 1)
    board.begin(5)
    board.say(frame(6, setting([(1, 100, 0)])))
    # 300 ms at a duty of 40 % are 120 ms of power; while it is spent, more comes back.
    assert keep_on(board, 10_000, 1000) == 300 * DUTY // (100 - DUTY)


def test_switching_off_and_on_in_between_gains_nothing() -> None:
    board, on = heating(), 0
    for n in range(200):
        before = board.now_ms
        board.say(frame(1000 + 3 * n, setting([(1, 100, 0)])))
        board.wait(50, 1)
        board.say(frame(1001 + 3 * n, setting([(1, 0, 0)])))
        on += sum(m.end_ms - m.begin_ms for m in board.moments if m.begin_ms >= before and m.power[0])
        board.wait(1)
        if board.limits.trip_reason != "-":
            break
    assert LONGEST_MS <= on <= LONGEST_MS * 1.05


def test_a_time_to_live_ends_by_itself_and_trips_nothing() -> None:
    board = heating(ms=250)
    board.wait(249, 1)
    assert board.limits.on_mask() == 1
    board.wait(1, 1)
    assert (
        board.limits.on_mask() == 0 and board.limits.trip_reason == "-" and board.limits.off_reason[0] == "T"
    )


def test_a_second_pulse_restarts_the_time() -> None:
    board = heating(ms=250)
    board.wait(200, 1)
    board.say(frame(3, setting([(1, 100, 250)])))
    board.wait(249, 1)
    assert board.limits.on_mask() == 1
    board.wait(1, 1)
    assert board.limits.on_mask() == 0


def test_silence_switches_everything_off_until_the_host_begins_again() -> None:
    board = heating(channel=3)  # no budget, but a heartbeat
    assert keep_on(board, 30_000) == 30_000
    board.wait(HEARTBEAT_MS - 100, 1)  # the last beat was 100 ms ago
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "S"
    assert board.say(frame(900, setting([(1, 100, 500)])))[6:7] == b"T"
    board.begin(901)
    assert board.say(frame(902, setting([(1, 100, 500)])))[6:7] == b"K"


def test_after_a_reset_nothing_heats_until_the_host_begins_and_the_budget_is_back() -> None:
    board = heating()
    board.reset()
    assert board.limits.on_mask() == 0
    assert b" P " in board.say(frame(3, "ASK"))
    assert board.say(frame(4, setting([(1, 100, 500)])))[6:7] == b"T"
    board.begin(5)
    assert board.say(frame(6, setting([(1, 100, 500)])))[6:7] == b"B", "the springs may be hot"
    assert board.say(frame(7, setting([(3, 100, 500)])))[6:7] == b"K", "a fan is not"
    board.wait(300)
    assert board.say(frame(8, setting([(1, 100, 500)])))[6:7] == b"K"


def test_a_clock_that_goes_back_switches_off() -> None:
    board = heating()
    board.limits.step((board.tick - 5) % WRAP)
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "S"


def test_a_host_that_begins_again_switches_off_what_another_one_left_on() -> None:
    board = heating()
    board.begin(50)
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "-"


def test_the_limits_themselves_switch_nothing_on_before_a_host_begins() -> None:
    board = Board()
    board.wait(60_000)
    board.limits.switch(0, 100, 500)
    assert board.limits.on_mask() == 0


def test_a_command_that_comes_after_a_gap_is_too_late() -> None:
    """Nobody stepped meanwhile, as when the program was held up: the gap counts before the sign of life."""
    board = heating(channel=3)
    board.now_ms += HEARTBEAT_MS
    assert b" S " in board.say(frame(3, "ASK"))
    assert board.limits.on_mask() == 0


def test_when_something_goes_off_by_itself_is_known_ahead() -> None:
    """The emulated board sleeps until then."""
    assert heating(channel=3).limits.next_event_ms() == HEARTBEAT_MS
    assert heating(ms=250).limits.next_event_ms() == 250
    board = heating()
    keep_on(board, LONGEST_MS - 300)
    board.say(frame(3000, "ASK"))
    left = board.limits.next_event_ms()
    board.wait(left - 1, 1)
    assert board.limits.on_mask() == 1
    board.wait(1, 1)
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "B"


# What the protocol refuses.


def test_an_old_command_is_refused_and_is_no_heartbeat() -> None:
    board = heating(ms=9999)
    for _ in range(5):
        board.wait(100)
        answer = board.say(frame(2, setting([(2, 100, 9999)])))
        assert not answer or answer[6:7] in b"OT"
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "S"


def test_a_recorded_start_starts_nothing() -> None:
    board = heating(ms=9999)
    recorded = [line for _, line in board.lines if line not in (b"", b"!")]
    board.reset()
    board.wait(60_000)
    for line in recorded:
        board.say(line)
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "P"


def test_a_recorded_start_starts_nothing_without_a_reset_either() -> None:
    board = heating(ms=9999)
    recorded = [line for _, line in board.lines if line not in (b"", b"!")]
    board.wait(60_000)
    assert board.limits.trip_reason == "S"
    for line in recorded:
        board.say(line)
    assert board.limits.on_mask() == 0 and board.limits.trip_reason == "S"


def test_off_is_obeyed_even_if_it_is_old() -> None:
    board = heating()
    assert board.say(frame(1, "OFF"))[6:7] == b"K"
    assert board.limits.on_mask() == 0


def test_a_cut_request_does_not_spoil_the_next_one() -> None:
    whole = setting([(1, 0, 0)])
    for cut in range(len(frame(3, whole))):
        board = heating()
        noise = frame(3, whole)[:cut]
        assert board.say((noise + frame(4, "OFF"))[-MAX_REQUEST:])[6:7] == b"K", noise
        assert board.limits.on_mask() == 0


@pytest.mark.parametrize(
    "words",
    [
        "SET 01=101/00500",
        "SET 00=100/00500",
        "SET 04=100/00500",
        "SET 01=100/0050",
        "SET 01=1e2/00500",
        "SET",
        "ON",
    ],
)
def test_a_wrong_value_changes_nothing(words: str) -> None:
    board = heating(power=30)
    assert board.say(frame(3, words))[6:7] == b"V"
    assert board.say(frame(4, f"SET 02=100/00500,{words[4:]}"))[6:7] == b"V"
    assert board.limits.power == [30, 0, 0]


def test_the_checksum_is_that_of_the_standard_library() -> None:
    assert crc16(b"123456789") == binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    assert elapsed_ms(5, WRAP - 5) == 10


def test_the_board_as_it_is_shipped_holds_its_own_promises() -> None:
    assert limits.HEARTBEAT_MS + limits.WATCHDOG_MS // 2 <= 525 and limits.HEARTBEAT_MS <= 450
    assert limits.WATCHDOG_MS < 500 and 0 < limits.DUTY_PERCENT <= 50 and limits.MAX_ON_MS <= 6300
    assert len(set(limits.PINS)) == len(limits.PINS) <= 16 and limits.SERVICE_PIN not in limits.PINS


# Whatever the host sends.


@given(ACTIONS, FIRST_TICK)
@settings(max_examples=100)
def test_no_channel_is_ever_on_beyond_its_limits(actions: list, first_tick: int) -> None:
    board = Board(first_tick)
    board.wait(12_000)
    play(board, actions)
    board.wait(HEARTBEAT_MS + MOST_STEP_MS)
    assert board.limits.on_mask() == 0
    for channel in range(CHANNELS):
        if channel + 1 not in STEADY:
            worst = most = 0
            for moment in board.moments:
                worst = max(0, worst + (moment.power[channel] - DUTY) * (moment.end_ms - moment.begin_ms))
                most = max(most, worst)
            assert most <= LONGEST_MS * (100 - DUTY) + (100 - DUTY) * MOST_STEP_MS


@given(ACTIONS, FIRST_TICK)
@settings(max_examples=80)
def test_nothing_is_on_that_no_new_command_keeps_on(actions: list, first_tick: int) -> None:
    """By what came: every line counts once, as only a new one is a sign of life."""
    board = Board(first_tick)
    board.wait(12_000)
    seen: set[bytes] = set()
    alive: list[int] = []
    say = board.say

    def heard(line: bytes) -> bytes:
        if line not in seen:
            seen.add(line)
            alive.append(board.now_ms)
        return say(line)

    board.say = heard  # type: ignore[method-assign]
    play(board, actions)
    board.wait(HEARTBEAT_MS + MOST_STEP_MS)
    for moment in board.moments:
        if any(moment.power):
            last = max(t for t in alive if t <= moment.begin_ms)
            assert moment.end_ms - last <= HEARTBEAT_MS + MOST_STEP_MS


# Pulse-width modulation.


@pytest.mark.parametrize("power", [1, 7, 30, 50, 99])
@pytest.mark.parametrize("late", [1, 3, 17])
def test_the_mean_power_is_right_though_the_program_is_late(power: int, late: int) -> None:
    modulation, high, tick = Modulation(2, 100, WRAP - 10_000), 0, WRAP - 10_000
    edges, level = 0, 0
    for n in range(0, 60_000, late):
        found = modulation.update([power, 0], (tick + n) % WRAP)
        edges += found != level
        level = found
        high += late * (found & 1)
        assert not found & 2
    assert high / 60_000 == pytest.approx(power / 100, abs=0.003)
    assert edges <= 2 * 600 + 2, "two in a period of 0.1 s"


def test_full_power_and_none_do_not_flicker() -> None:
    modulation = Modulation(2, 100, 0)
    assert {modulation.update([100, 0], t) for t in range(0, 3000, 7)} == {1}


def test_a_gate_rises_at_once_and_a_new_power_counts_from_the_next_period() -> None:
    modulation = Modulation(1, 100, 0)
    assert modulation.update([0], 50) == 0
    assert [modulation.update([20], 51 + t) for t in (0, 10, 19, 20, 99, 100)] == [1, 1, 1, 0, 0, 1]


def test_a_hold_after_a_rest_begins_with_the_gate_high() -> None:
    modulation = Modulation(1, 100, 0)
    assert [modulation.update([20], t) for t in (0, 30)] == [1, 0]
    assert modulation.update([0], 40) == 0
    assert [modulation.update([20], t) for t in (50, 60, 70, 149, 150)] == [1, 1, 0, 0, 1]


# On the real interpreter.


def traced(command: list[str], trace: Path) -> bytes:
    script = ROOT / "tests" / "hardware" / "firmware" / "firmware_trace.py"
    return subprocess.run(
        [*command, str(script), str(FIRMWARE), str(trace)], capture_output=True, check=True, timeout=120
    ).stdout


@given(ACTIONS, FIRST_TICK)
@settings(max_examples=15)
def test_micropython_gives_the_same_bytes(actions: list, first_tick: int) -> None:
    """One trace of random commands through both interpreters: answers, powers, gates, and what is due."""
    command = micropython()
    board = Board(first_tick)
    token = board.token
    board.wait(12_000)
    play(board, actions)
    text = []
    for tick, line in board.lines:
        if line == b"!":
            text.append(f"{tick} ! {CHANNELS} {LONGEST_MS} {DUTY} {HEARTBEAT_MS} {STEADY[0]} {token}")
            token += 1
        else:
            text.append(f"{tick} x{line.hex()}" if line else f"{tick} -")
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace"
        trace.write_text("\n".join(text) + "\n")
        ours = traced([sys.executable], trace)
        theirs = traced(command, trace)
    assert ours.count(b"\n") == len(text)
    assert theirs == ours


# What the page says.


def test_the_page_shows_a_real_request_and_the_real_limits() -> None:
    page = (ROOT / "docs" / "reference" / "mosfet-board.md").read_text()
    line = re.search(r"`(:0004 SET [^`]*)`", page)[1].encode() + b"\n"
    board = heating()
    assert board.say(line)[6:7] == b"K" and board.limits.remaining_ms[0] == 500
    for name in ("MAX_ON_MS", "DUTY_PERCENT", "HEARTBEAT_MS", "WATCHDOG_MS", "PERIOD_MS"):
        assert f"| `{name}` | {getattr(limits, name)} |" in page
