"""Plays a schedule on heated springs: on time, with pause and resume, and everything off at the end."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple, Protocol

from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import LEAD, HeaterBank, Report
from eldir_hardware.log.messages import PLAYED_TO_END
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.stop_signals import StoppedError, StopSignals
from eldir_hardware.schedule import ActuationSchedule

_logger = logging.getLogger(__name__)

READY = LEAD + 0.2
"""Time from arming to the start, in which the first pulses are announced [s]."""
_REACTION_TIME = 0.1  # reaction time to a key [s]


class Observer(Protocol):
    """Receives what happens on the rig, such as the recorder of a log."""

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        """The board's report of all channels at `t` [s since the start]."""

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        """Modelled temperature of each channel in the rig file's order [C]."""

    def on_currents(self, t: float, currents: tuple[float, ...], voltages: tuple[float, ...]) -> None:
        """Measured current [A] and voltage [V] of each channel in the rig file's order; NaN where none is
        measured. Not called without a current sensor."""

    def on_event(self, t: float, text: str) -> None:
        """An event, such as a pause."""


@dataclass(frozen=True)
class RunResult:
    """Result of a run."""

    peak_c: float
    """Highest modelled temperature [C]."""
    max_delay_s: float
    """Longest delay of a switching [s]."""
    duration_s: float
    """Duration of the run [s]."""
    ended: str = PLAYED_TO_END
    """How it ended, in words."""
    impossible_motion: str = ""
    """What the robot of a virtual rig did that a printed one cannot do; empty where nothing was seen."""


class _PausedError(Exception):
    """Leaves a cycle to pause."""


class _FinishedError(Exception):
    """Leaves a schedule before its end."""


class Player:
    """Plays one schedule on one bank. `play` plays to the end, or raises with everything off.

    `pause`, `resume`, `step`, `finish`, `finish_cycle` and `stop` may be called from any thread. A pause
    opens every contact at once. The interrupted cycle is played again from its beginning, not before the next
    one would have begun: the springs then have had no more heat and no less rest than in the schedule.
    """

    def __init__(
        self,
        bank: HeaterBank,
        schedule: ActuationSchedule,
        rig: Rig,
        clock: Clock,
        observers: Sequence[Observer] = (),
    ):
        self.prediction = limits.check_schedule(schedule, rig)
        self._bank = bank
        self._schedule = schedule
        self._rig = rig
        self._clock = clock
        self._observers = observers
        self._start = 0.0
        self._last: Report | None = None
        self._running = threading.Event()
        self._running.set()
        self._pause_after_cycle = self._finish_now = self._finish_after_cycle = False
        self._cycles_played = 0
        self._stop_reason: str | None = None

    def play(
        self,
        earliest: float = 0.0,
        on_start: Callable[[float], None] = lambda start: None,
        on_rest: Callable[[float], None] = lambda seconds: None,
    ) -> RunResult:
        """Heat as scheduled, as soon as everything is armed, but not before `earliest` on the clock.

        Springs that are still warm rest first; `on_rest` is called with the time for that [s].

        `on_start` is called with the start of the schedule [s on the clock], which is set after arming: a
        slow board or a busy computer delays the run and does not stop it. Ctrl-C, SIGTERM and a closed
        terminal end it with everything off. Observers' times count from the start.
        """
        stop = StopSignals()
        with stop.handled(), self._bank.armed(), stop.raising():
            self._start = self._clock.now()
            with suppress(_FinishedError):
                self._rest_springs(on_rest)
                self._start = max(earliest, self._clock.now() + READY)
                on_start(self._start)
                self._play_cycles()
        end = self._clock.now() - self._start
        if self._last is None:
            return RunResult(self._rig.springs.ambient_c, 0.0, end, self._ended)
        return RunResult(round(self._last.peak, 2), self._last.max_delay, end, self._ended)

    def _rest_springs(self, on_rest: Callable[[float], None]) -> None:
        """Wait until the springs have rested and cooled from the previous run."""
        until = self._bank.ready_at - READY
        if (seconds := until - self._clock.now()) > 0:
            on_rest(seconds + READY)
        while self._clock.now() < until:
            if self._stop_reason is not None:
                raise StoppedError(self._stop_reason)
            if self._finish_now:
                raise _FinishedError
            self._bank.wait_until(min(until, self._clock.now() + _REACTION_TIME))

    @property
    def _cycles(self) -> int:
        return self._schedule.conditioning_cycles + self._schedule.cycles

    @property
    def _ended(self) -> str:
        if self._cycles_played == self._cycles:
            return PLAYED_TO_END
        return f"finished after {self._cycles_played} of {self._cycles} cycles"

    def _play_cycles(self) -> None:
        begin = self._start + self._schedule.settle_s
        while self._cycles_played < self._cycles and not (self._finish_after_cycle and self._cycles_played):
            try:
                self._play_cycle(begin)
                self._cycles_played += 1
                begin += self._schedule.period_s
                if self._pause_after_cycle:
                    self._pause_after_cycle = False
                    self._wait_until(begin)
                    self.pause()
            except _PausedError:
                begin = self._wait_for_resume(begin)
        with suppress(_PausedError):  # nothing is left to pause
            self._wait_until(begin)

    def pause(self) -> None:
        """Open every contact and wait."""
        self._running.clear()

    def resume(self) -> None:
        """Play the interrupted cycle again and go on."""
        self._running.set()

    def step(self) -> None:
        """Play one cycle, then pause."""
        self._pause_after_cycle = True
        self._running.set()

    def finish(self) -> None:
        """End at once, as at the end of the schedule, without a latched stop."""
        self._finish_now = True

    def finish_cycle(self) -> None:
        """End after the present cycle; at once if paused."""
        self._finish_after_cycle = True

    def stop(self, reason: str) -> None:
        """Emergency stop: `play` raises `StoppedError`, and nothing heats again before a reset."""
        self._stop_reason = reason

    @property
    def paused(self) -> bool:
        """Whether the player is paused, or is about to pause."""
        return not self._running.is_set()

    def _play_cycle(self, begin: float) -> None:
        """Announce the pulses of a cycle, until the next cycle must be announced."""
        pulses = sorted(self._schedule.pulses(), key=lambda p: p.start)
        for start, simultaneous in groupby(pulses, key=lambda p: p.start):
            self._wait_until(begin + start - LEAD)
            self._bank.heat(begin + start, {p.channel: p.length for p in simultaneous})
        self._wait_until(begin + self._schedule.period_s - LEAD)

    def _wait_until(self, t: float) -> None:
        while self.paused or self._clock.now() < t:  # while paused, nothing more is announced
            if self.paused:
                raise _PausedError
            self._wait_step(t)

    def _wait_step(self, t: float) -> None:
        if self._stop_reason is not None:
            raise StoppedError(self._stop_reason)
        if self._finish_now:
            raise _FinishedError
        self._bank.wait_until(min(t, self._clock.now() + _REACTION_TIME), self._on_report)

    def _wait_for_resume(self, begin: float) -> float:
        """Keep everything off until resumed; return when the cycle begins again [s on the clock].

        `begin`: when the interrupted cycle began, or was to begin.
        """
        self._bank.abort_pulses()
        cycle = self._cycles_played + 1
        self._notify(f"paused in cycle {cycle}")
        may_have_heated = self._clock.now() > begin - LEAD
        earliest = begin + self._schedule.period_s if may_have_heated else begin
        while self.paused:
            if self._finish_after_cycle:
                raise _FinishedError
            self._wait_step(self._clock.now() + _REACTION_TIME)
        begin = max(self._clock.now() + 2 * LEAD, earliest)
        self._notify(f"resumed: cycle {cycle} begins again at {begin - self._start:.1f} s")
        return begin

    def _on_report(self, report: Report) -> None:
        self._last = report
        t = report.t - self._start
        for observer in self._observers:
            observer.on_relays(t, report.closed)
            observer.on_temperatures(t, report.temperatures)
            if report.currents:
                observer.on_currents(t, report.currents, report.voltages)

    def _notify(self, text: str) -> None:
        _logger.info("%s", text)
        for observer in self._observers:
            observer.on_event(self._clock.now() - self._start, text)


class ContactEdge(NamedTuple):
    """A contact that closed or opened."""

    t: float
    """Seconds since the start of the schedule, of the report that first showed it."""
    channel: int
    """Number of the relay channel, from 1."""
    closed: bool


class ContactEdges:
    """Collects the contacts' openings and closings from the reports of a run."""

    def __init__(self) -> None:
        self.found: list[ContactEdge] = []
        self.closed: tuple[bool, ...] = ()
        """The latest report; empty before the first one."""

    def update(self, t: float, closed: tuple[bool, ...]) -> None:
        """Add a report of all contacts at `t` [s]; all are open before the first one."""
        before = self.closed or (False,) * len(closed)
        for channel, (was, now) in enumerate(zip(before, closed, strict=True), start=1):
            if was != now:
                self.found.append(ContactEdge(t, channel, now))
        self.closed = tuple(closed)
