"""Checks of a rig that switch contacts: whether a second pulse restarts the board's timer, and which channel
heats which spring.

They heat through the bank that every run uses, so that the guardian enforces all limits here too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from eldir.built.heat import HeatModel
from eldir.design import Design
from eldir.errors import EldirError
from eldir.morphology import Morphology
from eldir.parameters.wiring import Connection, select_motors
from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import LEAD, HeaterBank, Report
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import LimitError, worst_springs
from eldir_hardware.run.drive import find_design, open_bank
from eldir_hardware.safety import limits
from eldir_hardware.safety.stop_signals import StopSignals, signals_as_errors

_PULSE_S, _SECOND_PULSE_S = 0.8, 0.4
"""Length of a pulse, and when the second one is sent: the contact opens at 0.8 s if that is ignored, at 1.2 s
if the timer restarts."""
_TIMER_TOLERANCE_S = 0.15  # timers count in 0.1 s, and the read-back takes time
MAX_TOUCH_C = 48.0
"""Temperature that no spring within the tolerances exceeds: a surface that may be touched for ten minutes
(ISO 13732-1, table 1)."""
PAUSE_S = 4.0
"""Time between two pulses, to look at the springs and to touch them."""
_OPENING_S = 0.5  # from the end of a pulse to the question about it
_TIMER_STEP_S = 0.1  # resolution of the timers of boards
_MIN_PULSE_S = 0.5  # a shorter pulse could end between two read-backs
_LENGTHWISE = ("rear end", "middle", "front end")
_HEIGHTS = ("low", "half-way up", "high")


def measure_retriggerable(board: RelayBoard, clock: Clock, channel: int) -> bool:
    """Whether a second pulse restarts the board's timer: send two pulses, and measure when the contact opens.

    The heating supply must be disconnected. Raises `EldirError` if the second pulse neither restarts the
    timer nor is ignored.
    """
    if not board.times_pulses:
        raise EldirError(
            "this board does not time pulses", code="doctor.no-timer", remedy="leave board.retriggerable out"
        )
    stop = StopSignals()
    with stop.handled(), board.armed(), stop.raising():
        single = _closed_time(board, clock, channel, None)
        if abs(single - _PULSE_S) > _TIMER_TOLERANCE_S:
            raise EldirError(
                "the board's timer is inaccurate",
                code="doctor.wrong-time",
                expected=f"{_PULSE_S:g} s",
                found=f"{single:.2f} s",
                remedy="do not use this board for pulses",
            )
        double = _closed_time(board, clock, channel, _SECOND_PULSE_S)
    for restarts, expected in ((False, _PULSE_S), (True, _PULSE_S + _SECOND_PULSE_S)):
        if abs(double - expected) < _TIMER_TOLERANCE_S:
            return restarts
    raise EldirError(
        "a second pulse neither restarts the board's timer nor is ignored",
        code="doctor.second-pulse",
        expected=f"{_PULSE_S:g} or {_PULSE_S + _SECOND_PULSE_S:g} s",
        found=f"{double:.2f} s",
        remedy="do not use this board for pulses",
    )


def _closed_time(board: RelayBoard, clock: Clock, channel: int, second_pulse: float | None) -> float:
    """How long the board reports the channel closed [s]. `second_pulse`: when to send another one [s]."""
    start = clock.now()
    board.send({channel: True}, {channel: _PULSE_S})
    closed_at = clock.now()
    while clock.now() - start < _PULSE_S + _SECOND_PULSE_S + 1.0:
        if second_pulse is not None and clock.now() - start >= second_pulse:
            board.send({channel: True}, {channel: _PULSE_S})
            second_pulse = None
        clock.sleep_until(clock.now() + 0.02)
        if not board.read_states()[channel - 1] and clock.now() - closed_at > 0.1:
            return clock.now() - closed_at
    raise EldirError(
        "the board did not open a pulse by itself",
        code="doctor.stays-closed",
        remedy="cut the supply; do not use this board for pulses",
    )


def warming_pulse(rig: Rig) -> float:
    """How long each channel heats [s]: as long as the rig allows, and no spring exceeds `MAX_TOUCH_C` at the
    worst case of the tolerances. Raises `LimitError` where the rig must not heat."""
    limits.check_rig(rig)
    max_length, shortest = limits.max_pulse(rig), round(_MIN_PULSE_S / _TIMER_STEP_S)
    if max_length < _MIN_PULSE_S + _TIMER_STEP_S:
        raise LimitError(
            "the rig allows no pulse in which a spring gets warm enough to feel",
            expected=f"{_MIN_PULSE_S + _TIMER_STEP_S:g} s or more",
            found=f"{max_length:g} s",
            remedy="raise limits.max_on_s and cutoff.max_on_s",
        )
    steps = int(max_length / _TIMER_STEP_S + 1e-6)
    hottest = HeatModel([worst_springs(rig)]).run(np.ones((steps, 1)), _TIMER_STEP_S).temperature[:, 0]
    # A board's own timer may open a step later, as limits.TIMER_STEP says.
    allowed = np.flatnonzero(hottest <= MAX_TOUCH_C)
    length = round((len(allowed) - 1) * _TIMER_STEP_S, 3)
    if length < _MIN_PULSE_S:
        raise LimitError(
            "springs get too hot to touch in the shortest pulse",
            code="limit.warm-hands",
            expected=f"at most {MAX_TOUCH_C:g} C",
            found=f"{hottest[shortest]:.0f} C after {_MIN_PULSE_S:g} s",
            remedy="lower supply.current_limit_a",
        )
    return length


def describe_spring(connection: Connection, body: Morphology | None) -> str:
    """Motor, face and, if the body is known, the place on the robot, in words."""
    text = f"spring {connection.spring} on the {connection.face} face"
    if connection.face == "both":
        text = f"spring {connection.spring} on both faces"
    if body is None:
        return text
    ends = body.springs[np.flatnonzero(body.active)[connection.spring]]
    low, size = body.positions.min(axis=0), np.ptp(body.positions, axis=0)
    third = np.clip(3 * (body.positions[ends].mean(axis=0) - low) / size, 0, 2).astype(int)
    place = f"{_LENGTHWISE[third[0]]}, {_HEIGHTS[third[1]]}"
    return f"{text}, between masses {ends[0]} and {ends[1]} ({place})"


def show_wiring(
    rig: Rig,
    rig_file: Path,
    design: Path | None,
    say: Callable[[str], None],
    is_answered: Callable[[Connection], bool] | None = None,
) -> None:
    """Warm one spring after the other, and say which one must grow warm.

    `design`: file of the robot, instead of the one that the rig file names. Without any, all channels of the
    rig file are heated, and the places of the springs are unknown. `is_answered`: as of `warm_each`.
    """
    path = find_design(rig, rig_file, design)
    body = None if path is None else Design.load(path).morphology
    connections = select_motors(rig.channels, rig.motors if body is None else body.motors)
    length = warming_pulse(rig)
    rest = f"rests for {PAUSE_S:g} s" if is_answered is None else "waits for your answer"
    say(
        f"each channel heats for {length:g} s, to less than {MAX_TOUCH_C:g} C, and {rest}; "
        "Ctrl-C opens all contacts at once"
    )

    def on_closed(connection: Connection) -> None:
        say(f"channel {connection.channel}: {describe_spring(connection, body)} must grow warm")

    def on_rest(seconds: float) -> None:
        say(f"the springs cool down from the last run, for {seconds:.0f} s")

    with signals_as_errors(), open_bank(rig) as opened:
        warm_each(opened.bank, opened.clock, connections, length, on_closed, PAUSE_S, on_rest, is_answered)
    hint = f" If another spring grew warm, correct `channels` in {rig_file} or the wires"
    say(f"all contacts are open.{hint if is_answered is None else ''}")


def warm_each(
    bank: HeaterBank,
    clock: Clock,
    connections: Sequence[Connection],
    length: float,
    on_closed: Callable[[Connection], None],
    pause: float = PAUSE_S,
    on_rest: Callable[[float], None] = lambda seconds: None,
    is_answered: Callable[[Connection], bool] | None = None,
) -> None:
    """Heat one channel after the other for `length` [s], and wait for at least `pause` [s] after each.

    `is_answered` is called again and again when the contact has opened, until it is true. It must not wait:
    the guardian watches as during a pulse. Springs that are still warm cool down first; `on_rest` is called
    with the time for that [s]. `on_closed` is called as soon as a contact is reported closed. Ctrl-C and
    every error open all contacts at once. Raises `EldirError` for a contact that is never reported closed.
    """
    stop = StopSignals()
    with stop.handled(), bank.armed(), stop.raising():
        if (seconds := bank.ready_at - clock.now()) > 0:
            on_rest(seconds)
            bank.wait_until(bank.ready_at)
        next_start = clock.now()  # two channels may heat the same spring, where it is wired twice
        for connection in connections:
            closed: list[Connection] = []

            def on_report(
                report: Report, heated: Connection = connection, closed: list[Connection] = closed
            ) -> None:
                if report.closed[heated.channel - 1] and not closed:
                    closed.append(heated)
                    on_closed(heated)

            start = max(next_start, clock.now() + LEAD + _TIMER_STEP_S)
            bank.heat(start, {connection.channel: length})
            bank.wait_until(start + length + (pause if is_answered is None else _OPENING_S), on_report)
            if not closed:
                raise EldirError(
                    f"channel {connection.channel} was not reported closed",
                    code="doctor.not-closed",
                    expected=f"closed for {length:g} s",
                    remedy="check the board: eldir rig doctor",
                )
            while is_answered is not None and not is_answered(connection):
                bank.wait_until(clock.now() + _TIMER_STEP_S)
            next_start = start + length + pause
