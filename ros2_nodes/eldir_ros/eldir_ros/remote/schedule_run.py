# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""One goal of the action, from its acceptance to its result, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from eldir_msgs.msg import Run

from eldir.errors import EldirError
from eldir_hardware.clock import WallClock
from eldir_hardware.log.messages import PLAYED_TO_END
from eldir_hardware.relay.errors import NotProvenOffError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.run.player import ContactEdge, ContactEdges, Player
from eldir_hardware.run.room import measure_room
from eldir_hardware.safety.compatibility import require_compatible
from eldir_hardware.schedule import ActuationSchedule
from eldir_ros.conversions import runs
from eldir_ros.remote.remote_bank import RemoteBank


@dataclass(frozen=True)
class RunRequest:
    """The request of a goal."""

    schedule: Callable[[], ActuationSchedule]
    """Reads the schedule; raises `InputError` for an invalid one."""
    client: str
    """Name of the client that sends heartbeats; without them nothing heats."""
    lead: float
    """The schedule starts at the earliest this long after the goal [s]."""
    accept_mismatch: str = ""
    """Reason for playing a schedule that was not made for this rig."""
    room_c: Callable[[], float | None] = lambda: None
    """Reads the temperature of the air that a person measured [C]; None: the rig's thermometer measures it,
    if there is one. Raises `InputError` for anything but a number."""


@dataclass(frozen=True)
class RunProgress:
    """State of a run at one report of the board."""

    elapsed: float
    """Seconds since the start of the schedule; negative while the board is arming."""
    phase: int
    """Phase of the run, as in the feedback of RunSchedule.action."""
    cycle: int
    """Number of the cycle in this phase, from 1; 0 in one without cycles."""
    edge: ContactEdge | None
    """The latest edge; None before the first one."""
    closed: tuple[int, ...]
    """Channels that the board reports closed."""
    temperatures: tuple[float, ...]
    """Modelled temperatures of the springs, in the rig file's order [C]."""


@dataclass(frozen=True)
class RunScheduleResult:
    """How a run ended."""

    outcome: int
    """Outcome of the run, as in RunSchedule.action."""
    message: str
    """One line: why it ended."""
    start_ns: int
    """Start of the schedule [ns]; 0 if it was refused."""
    duration: float
    """Duration of the run [s]; 0 if it was refused."""
    peak_temperature: float
    """Highest modelled temperature since the board was armed [C]."""
    max_delay: float
    """Greatest delay of a switching since then [s]."""
    edges: tuple[ContactEdge, ...]
    all_off: bool
    """Whether every contact was open by the board's report; false where the board did not report."""


class RunListener(Protocol):
    """Receives the progress of a run."""

    def on_state(self, state: int, start_ns: int, message: str, room_c: float | None) -> None:
        """The run began or ended; `state` as in Run.msg. `room_c`: the measured air [C]."""

    def on_progress(self, progress: RunProgress) -> None:
        """The board has reported."""

    def on_message(self, text: str) -> None:
        """A line for the log."""


_MAX_MESSAGE = 300  # about a bug of this program [characters]


class ScheduleRun:
    """Plays one schedule on a bank of springs behind messages. Use from one thread."""

    def __init__(self, bank: RemoteBank, listener: RunListener, now_ns: Callable[[], int]):
        """`now_ns` is the time of day of every stamp [ns]."""
        self._bank, self._listener, self._now_ns = bank, listener, now_ns
        self._edges = ContactEdges()
        self._schedule: ActuationSchedule | None = None
        self._room_c: float | None = None

    def play(self, request: RunRequest, rig: Rig | None, stopped: str = "") -> RunScheduleResult:
        """Play a schedule. Never raises: the result says what went wrong, and everything is off.

        `rig` is None if the sequencer is not active; `stopped`: why an emergency stop is latched. Both refuse
        the run.
        """
        start_ns, start_t, failed = 0, 0.0, False
        clock = WallClock()
        try:
            if not request.client:
                raise EldirError(
                    "the goal names no client",
                    expected="the name with which the client sends heartbeats on run_schedule/alive",
                    remedy="use: ros2 run eldir_ros run_schedule",
                )
            if rig is None:
                raise EldirError("the sequencer is not active", remedy="activate it")
            if stopped:
                raise EldirError(f"the emergency stop is latched: {stopped}", remedy="reset it")
            self._schedule = schedule = request.schedule()
            player = Player(self._bank, schedule, rig, clock, [self])
            if accepted := require_compatible(schedule, rig, None, request.accept_mismatch):
                self._listener.on_message(f"the schedule was {accepted}")
            room = measure_room(rig, request.room_c())
            self._room_c = room.room_c
            if room.text:
                self._listener.on_message(f"warning: {room.text}" if room.is_doubtful else room.text)
            duration = schedule.duration

            def on_ready(start: float) -> None:
                nonlocal start_ns, start_t
                start_t = start
                start_ns = self._now_ns() + round(1e9 * (start - clock.now()))
                self._listener.on_state(Run.RUNNING, start_ns, "", room.room_c)
                self._listener.on_message(f"{duration:.1f} s")

            player.play(clock.now() + request.lead, on_ready)
            outcome, message = runs.FINISHED, PLAYED_TO_END
        except EldirError as error:
            outcome = getattr(error, "outcome", runs.STOPPED)
            message, failed = str(error), isinstance(error, NotProvenOffError)
        except Exception as error:  # the bank has switched everything off by now
            outcome, message = runs.STOPPED, f"{type(error).__name__}: {error}"[:_MAX_MESSAGE]
        if outcome == runs.STOPPED and not start_ns:
            outcome = runs.REFUSED
        if start_ns:
            state = Run.FINISHED if outcome == runs.FINISHED else Run.ENDED
            self._listener.on_state(state, start_ns, message, self._room_c)
        self._listener.on_message(message)
        all_off = not failed and (self._bank.proof is not None or self._bank.reports_all_open())
        last = self._bank.last
        return RunScheduleResult(
            outcome,
            message,
            start_ns,
            clock.now() - start_t if start_ns else 0.0,
            0.0 if last is None else last.peak_temperature,
            0.0 if last is None else last.max_delay,
            tuple(self._edges.found),
            all_off,
        )

    # As an observer of the player.

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self._edges.update(t, states)

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        assert self._schedule is not None  # it is being played
        edge = self._edges.found[-1] if self._edges.found else None
        closed = tuple(i for i, is_closed in enumerate(self._edges.closed, start=1) if is_closed)
        phase = runs.phase_of(self._schedule, t)
        self._listener.on_progress(RunProgress(t, *phase, edge, closed, tuple(temperatures)))

    def on_currents(self, t: float, currents: tuple[float, ...], voltages: tuple[float, ...]) -> None:
        """Nothing: who watches the run finds them on the topics currents and voltages."""

    def on_event(self, t: float, text: str) -> None:
        self._listener.on_message(f"at {t:.1f} s: {text}")
