"""Plays a schedule on a bank of springs: on time, with pause and resume, and everything off at the end."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from typing import Protocol

from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import LEAD, HeaterBank, Report
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.stop_signals import Stop, StoppedError
from eldir_hardware.schedule import ActuationSchedule

_logger = logging.getLogger(__name__)

READY = LEAD + 0.2
"""Time from being armed to the start: the first pulses can then be announced in time [s]."""
_GLANCE = 0.1  # reaction time to a key [s]


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
class Played:
    """Outcome of a run."""

    peak_c: float
    """Highest modelled temperature [C]."""
    latest_s: float
    """Greatest delay of a switching [s]."""
    duration_s: float
    """Duration of the run [s]."""
    ended: str = "played to the end"
    """How it ended, in words."""


class _PausedError(Exception):
    """Leaves a cycle that is to be paused."""


class _FinishedError(Exception):
    """Leaves a schedule before its end."""


class Player:
    """Plays one schedule on one bank. `play` refuses, plays to the end, or raises with everything off.

    `pause`, `resume`, `step`, `finish`, `finish_cycle` and `stop` may be called from any thread. A pause
    opens every contact at once. The interrupted cycle is played again from its beginning, but not before the
    next one would have begun: the springs then had no more heat and no less rest than in the schedule, for
    which the limits were checked.
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
        self._single = self._finished = self._last_cycle = False
        self._played = 0
        self._stopped: str | None = None

    def play(
        self,
        earliest: float = 0.0,
        ready: Callable[[float], None] = lambda start: None,
        rest: Callable[[float], None] = lambda seconds: None,
    ) -> Played:
        """Heat as scheduled, as soon as everything is armed, but not before `earliest` on the clock.

        Springs that are still warm rest first; `rest` is called with the time for that [s].

        `ready` is called with the start, which is chosen only then, so that a slow board or a busy computer
        delays the run and does not stop it. Ctrl-C, SIGTERM and a closed terminal end it with everything off.
        Observers' times count from the start.
        """
        stop = Stop()
        with stop.caught(), self._bank.armed(), stop.heeded():
            self._start = self._clock.now()
            with suppress(_FinishedError):
                self._let_rest(rest)
                self._start = max(earliest, self._clock.now() + READY)
                ready(self._start)
                self._play_cycles()
        end = self._clock.now() - self._start
        if self._last is None:
            return Played(self._rig.springs.ambient_c, 0.0, end, self._ended)
        return Played(round(self._last.hottest, 2), self._last.latest, end, self._ended)

    def _let_rest(self, rest: Callable[[float], None]) -> None:
        """Wait until the springs have rested and cooled from the run before."""
        until = self._bank.rested_at - READY
        if (seconds := until - self._clock.now()) > 0:
            rest(seconds + READY)
        while self._clock.now() < until:
            if self._stopped is not None:
                raise StoppedError(self._stopped)
            if self._finished:
                raise _FinishedError
            self._bank.wait_until(min(until, self._clock.now() + _GLANCE), lambda report: None)

    @property
    def _cycles(self) -> int:
        return self._schedule.conditioning_cycles + self._schedule.cycles

    @property
    def _ended(self) -> str:
        if self._played == self._cycles:
            return "played to the end"
        return f"finished after {self._played} of {self._cycles} cycles"

    def _play_cycles(self) -> None:
        begin = self._start + self._schedule.settle_s
        while self._played < self._cycles and not (self._last_cycle and self._played):
            try:
                self._play_cycle(begin)
                self._played += 1
                begin += self._schedule.period_s
                if self._single:
                    self._single = False
                    self._rest_until(begin)
                    self.pause()
            except _PausedError:
                begin = self._wait_to_go_on(begin)
        with suppress(_PausedError):  # nothing is left to pause
            self._rest_until(begin)

    def pause(self) -> None:
        """Open every contact and wait."""
        self._running.clear()

    def resume(self) -> None:
        """Play the interrupted cycle again and go on."""
        self._running.set()

    def step(self) -> None:
        """Play one cycle, then pause."""
        self._single = True
        self._running.set()

    def finish(self) -> None:
        """End at once as at the schedule's end, without a latched stop."""
        self._finished = True

    def finish_cycle(self) -> None:
        """End after the cycle that is played; at once where it is paused."""
        self._last_cycle = True

    def stop(self, why: str) -> None:
        """Emergency stop: `play` raises `StoppedError`, and nothing heats again before a reset."""
        self._stopped = why

    @property
    def paused(self) -> bool:
        """Whether the player is paused, or is about to pause."""
        return not self._running.is_set()

    def _play_cycle(self, begin: float) -> None:
        """Announce the pulses of a cycle, until it is time to announce the next cycle's."""
        pulses = sorted(self._schedule.pulses(), key=lambda p: p.start)
        for start, together in groupby(pulses, key=lambda p: p.start):
            self._rest_until(begin + start - LEAD)
            self._bank.heat(begin + start, {p.channel: p.length for p in together})
        self._rest_until(begin + self._schedule.period_s - LEAD)

    def _rest_until(self, t: float) -> None:
        while self.paused or self._clock.now() < t:  # where it is paused, what comes next is not announced
            if self.paused:
                raise _PausedError
            self._rest_a_moment(t)

    def _rest_a_moment(self, t: float) -> None:
        if self._stopped is not None:
            raise StoppedError(self._stopped)
        if self._finished:
            raise _FinishedError
        self._bank.wait_until(min(t, self._clock.now() + _GLANCE), self._see)

    def _wait_to_go_on(self, begin: float) -> float:
        """Keep everything off until resumed; return when the cycle begins again [s on the clock].

        `begin`: when the interrupted cycle began, or was to begin.
        """
        self._bank.abort_pulses()
        cycle = self._played + 1
        self._tell(f"paused in cycle {cycle}")
        may_have_heated = self._clock.now() > begin - LEAD
        earliest = begin + self._schedule.period_s if may_have_heated else begin
        while self.paused:
            if self._last_cycle:
                raise _FinishedError
            self._rest_a_moment(self._clock.now() + _GLANCE)
        begin = max(self._clock.now() + 2 * LEAD, earliest)
        self._tell(f"resumed: cycle {cycle} begins again at {begin - self._start:.1f} s")
        return begin

    def _see(self, report: Report) -> None:
        self._last = report
        t = report.t - self._start
        for observer in self._observers:
            observer.on_relays(t, report.closed)
            observer.on_temperatures(t, report.temperatures)
            if report.currents:
                observer.on_currents(t, report.currents, report.voltages)

    def _tell(self, text: str) -> None:
        _logger.info("%s", text)
        for observer in self._observers:
            observer.on_event(self._clock.now() - self._start, text)
