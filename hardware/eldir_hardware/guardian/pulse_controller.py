"""Drives the board: pulses on time and their extension, read-back, interlocks, keepalive.

Runs in the guardian process on a wall clock, and in the process of a virtual rig on a virtual clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from eldir.errors import EldirError
from eldir_hardware.clock import Clock
from eldir_hardware.current_sensor import CurrentSensor, SensorError
from eldir_hardware.guardian._forecast import HeatingInterval
from eldir_hardware.guardian._interlock import Interlock
from eldir_hardware.guardian.bank import BOARD_PROOF, HeaterBank, Report, ReportCallback, ignore_report
from eldir_hardware.guardian.measured_heat import CurrentWatch
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import get_requirements, is_retriggerable
from eldir_hardware.safety.spring_memory import SpringHeat, Springs

PATIENCE = 0.6
"""Everything is switched off after this time without a keepalive message [s]."""
MAX_PULSE = 0.5
"""A board that times its pulses gets pulses of at most this duration, which are extended as needed [s]."""
_REARM_MARGIN = 0.25  # remaining time of such a pulse when it is extended [s]
_READ_INTERVAL = 0.1  # from one read-back to the next, while a contact is closed or may be stuck [s]
_IDLE_READ_INTERVAL = 0.5  # while all contacts were read as open [s]
_MAX_POSTPONED = 0.4  # a read-back is postponed for a switching for this time at most [s]
_MAX_UNREAD = 1.5  # longest time without a read-back while something heats [s]
_MAX_DELAY = 0.5  # a longer delay means that the program was suspended [s]
_MARGIN = 0.02  # before a switching, for a late answer of the board and for this program [s]
_SPIN_TIME = 0.002  # a switching that is due within this time is waited for in a busy loop [s]
_SAME_INSTANT = 1e-3  # switchings within this time are sent together [s]
_FOREVER = float("inf")


class KeepaliveError(EldirError):
    """The program that heats sends no keepalive messages."""

    code = "guardian.heartbeat"


class SuspendedError(EldirError):
    """The computer was suspended; contacts may have been closed all that time."""

    code = "guardian.asleep"


@dataclass
class _ClosedChannel:
    """A closed channel."""

    since: float
    """When it closed [s on the clock]."""
    until: float
    """When it opens [s]."""
    board_opens_at: float
    """When the board itself opens it [s]."""


class _Switching(NamedTuple):
    """Channels that switch at one instant."""

    at: float
    """When their contacts must move [s]."""
    send: float
    """When the command must be sent for this [s]."""
    opening: list[int]
    closing: dict[int, float]
    """Channels that close, each with the time when it opens again [s]."""


_NO_SWITCHING = _Switching(_FOREVER, _FOREVER, [], {})


class Host(NamedTuple):
    """Functions of the process in which a pulse controller runs."""

    suspended_time: Callable[[], float] = lambda: 0.0
    """Time for which the computer has been suspended since a fixed instant [s]."""
    before_closing: Callable[[], None] = lambda: None
    """Called before a contact closes; raises to prevent that."""


class PulseController(HeaterBank):
    """Drives a board. `step` does what is due, and returns when it must be called again."""

    def __init__(
        self,
        board: RelayBoard,
        rig: Rig,
        clock: Clock,
        sensor: CurrentSensor | None = None,
        springs: Springs | None = None,
        host: Host = Host(),  # noqa: B008 # immutable
    ):
        """`sensor`: that of the rig file. `springs`: after the previous run; None if all are cold."""
        self._interlock = Interlock(rig, clock.now(), springs)
        self._currents = CurrentWatch(rig, sensor, clock)
        self._board, self._rig, self._clock, self._host = board, rig, clock, host
        self.on_report: ReportCallback = ignore_report
        """Called with each report."""
        self._suspended_before = host.suspended_time()
        self._extends_pulses = board.times_pulses and is_retriggerable(rig) is True
        self._idle_interval = min(_IDLE_READ_INTERVAL, board.patience / 2)
        self._announced: list[tuple[float, int, float]] = []  # at, channel, seconds; in order of time
        self._pulses: dict[int, _ClosedChannel] = {}
        self._armed = False
        self.armed_once = False
        """Whether anything may have been heated."""
        self._kept_alive_at = self._read_at = self._switched_at = clock.now()
        self._max_delay = 0.0
        self._next_step_at = _FOREVER
        self._stop_reason: str | None = None

    # Commands.

    def check_limits(self) -> None:
        """Raise `EldirError` if the board's own limits are stricter than the rig file's."""
        self._board.check_limits(get_requirements(self._rig))

    def arm(self) -> None:
        self._require_not_stopped()
        self._suspended_before = self._host.suspended_time()
        self._board.all_off()
        self._currents.arm()
        self.check_limits()
        if (fan := self._rig.fan_channel) is not None:
            self._board.switch({fan: True})
        now = self._clock.now()
        self._interlock.record_fan(True, now)
        self.ready_at = now + self._interlock.rest_time(now)
        self._armed = self.armed_once = True
        self._next_step_at = self._clock.now()
        self.keep_alive()
        self._read_back()

    def heat(self, at: float, durations: Mapping[int, float]) -> None:
        self._require_not_stopped()
        if not self._armed:
            raise EldirError(
                "the rig is not armed", code="guardian.not-armed", remedy="arm it before heating"
            )
        master = self._rig.master_channel
        closed = [HeatingInterval(p.since, c, p.until) for c, p in self._pulses.items() if c != master]
        announced = [HeatingInterval(t, c, t + seconds) for t, c, seconds in self._announced]
        self._interlock.check_pulses(at, durations, [*closed, *announced])
        self._announced = sorted([*self._announced, *((at, c, s) for c, s in durations.items())])

    def export_springs(self) -> dict[int, SpringHeat] | None:
        """The springs by channel, for the next run, after everything was proven off.

        None if the computer was suspended since arming: it is unknown how long contacts were closed.
        """
        if self._was_suspended:
            return None
        return self._interlock.export_springs(self._clock.now())

    def keep_alive(self) -> None:
        """Record that the program that heats is alive."""
        self._kept_alive_at = self._clock.now()

    def abort_pulses(self) -> None:
        self._announced = []
        if self._pulses:
            now = self._clock.now()
            self._switch(_Switching(now, now, list(self._pulses), {}))

    def wait_until(self, t: float, on_report: ReportCallback = ignore_report) -> None:
        self.on_report = on_report
        while True:
            self.keep_alive()
            due = self.step()
            if self._clock.now() >= t:
                return
            self._clock.sleep_until(min(due, t))

    def disarm(self) -> None:
        if self._armed:
            self._switch_off()
            self._read_back()
            self._interlock.record_fan(False, self._clock.now())  # a fan without a relay may stop now

    def stop(self, reason: str) -> None:
        if self._stop_reason is None:
            self._stop_reason = reason
            with suppress(SensorError):  # then the proof is that of the board alone
                self._switch_off()

    # Switching and watching.

    def step(self) -> float:
        """Do what is due, and return when there will be more to do [s on the clock]."""
        if not self._armed:
            return _FOREVER
        begun = self._clock.now()
        try:
            return self._step(begun)
        except RelayError:  # a program that was suspended while it waited for an answer has missed it
            self._require_no_delay(self._clock.now() - begun - self._read_time)
            raise

    def _step(self, now: float) -> float:
        if now - self._kept_alive_at > PATIENCE:
            raise KeepaliveError(
                f"no keepalive message of the program that heats for {now - self._kept_alive_at:.1f} s"
            )
        self._require_no_delay(now - self._next_step_at)  # a message that waited in the socket proves nothing
        if self._was_suspended:
            raise SuspendedError(
                "the computer was suspended while it heated", remedy="disable its suspension"
            )
        since = now
        while (switching := self._next_switching()).send <= self._clock.now() + _SPIN_TIME:
            self._clock.spin_until(switching.send)
            self._record_delay(max(self._clock.now() - switching.send, 0.0))
            self._switch(switching)
            since = self._require_progress(since)
        self._extend_pulses()
        since = self._require_progress(since)
        if self._next_read_at(self._next_switching()) <= self._clock.now():
            self._read_back()
        elif self._pulses and self._clock.now() - self._read_at > _MAX_UNREAD:
            raise EldirError(
                f"the board's contacts were not read for {_MAX_UNREAD:g} s",
                code="guardian.contacts-unseen",
                remedy="leave at least 0.15 s between the switchings of the schedule",
            )
        self._next_step_at = self._next_time()
        self._require_progress(since, self._read_time)
        return self._next_step_at

    def _next_switching(self) -> _Switching:
        """The next switching. A contactor is closed while any channel is closed."""
        instants = [*(p.until for p in self._pulses.values()), *(t for t, _, _ in self._announced[:1])]
        if not instants:
            return _NO_SWITCHING
        at = min(instants)
        opening = [c for c, p in self._pulses.items() if p.until <= at + _SAME_INSTANT]
        closing = {c: t + s for t, c, s in self._announced if t <= at + _SAME_INSTANT}
        master = self._rig.master_channel
        if master in opening and closing:
            opening.remove(master)
        if master is not None and closing:
            last = max(closing.values())
            if master in self._pulses:
                last = max(last, self._pulses[master].until)
            closing = {master: last} | closing
        return _Switching(
            at, at - self._board.switching_delay(self._changes(opening, closing)), opening, closing
        )

    def _switch(self, switching: _Switching) -> None:
        """Open and close channels in the fewest frames that the board allows."""
        self._announced = [
            a for a in self._announced if a[1] not in switching.closing or a[0] > switching.at + _SAME_INSTANT
        ]
        self._interlock.check_together((set(switching.closing) | set(self._pulses)) - set(switching.opening))
        if switching.closing:
            self._host.before_closing()
        self._send(switching.opening, switching.closing)
        self._switched_at = self._clock.now()
        changes = self._changes(switching.opening, switching.closing)
        self._interlock.record_switching(changes, self._clock.now())
        self._currents.record_switching(changes)

    def _send(self, opening: list[int], closing: Mapping[int, float]) -> None:
        """Close channels until the times in `closing`, or extend the pulses of those that are closed."""
        changes, now = self._changes(opening, closing), self._clock.now()
        if self._board.times_pulses:
            most = MAX_PULSE if self._extends_pulses else _FOREVER
            seconds = {c: min(max(until - now, 0.1), most) for c, until in closing.items()}
            self._board.send(changes, seconds)
            board_opens_at = {c: now + math.ceil(10 * s - 1e-6) / 10 for c, s in seconds.items()}
        else:
            self._board.send(changes)
            board_opens_at = dict.fromkeys(closing, _FOREVER)
        for channel in opening:
            del self._pulses[channel]
        for channel, until in closing.items():
            since = self._pulses[channel].since if channel in self._pulses else now
            self._pulses[channel] = _ClosedChannel(since, until, board_opens_at[channel])

    def _changes(self, opening: Iterable[int], closing: Iterable[int]) -> dict[int, bool]:
        """The changes in the order of the commands: a contactor closes first and opens last."""
        in_order = sorted(opening, key=lambda c: c == self._rig.master_channel)
        return dict.fromkeys(in_order, False) | dict.fromkeys(closing, True)

    def _extend_pulses(self) -> None:
        switching, begun = self._next_switching(), self._clock.now()
        for channel, pulse in list(self._pulses.items()):
            if self._extend_at(pulse, switching) <= self._clock.now():
                self._send([], {channel: pulse.until})
        self._record_delay(self._clock.now() - begun)

    def _extend_at(self, pulse: _ClosedChannel, switching: _Switching) -> float:
        """When to extend a pulse of the board; after the next switching if that is early enough."""
        if not self._extends_pulses or pulse.until <= pulse.board_opens_at:
            return _FOREVER
        due = pulse.board_opens_at - _REARM_MARGIN
        if due < switching.send < due + _REARM_MARGIN / 2:
            return switching.send + _SAME_INSTANT
        return due

    def _next_read_at(self, switching: _Switching) -> float:
        """When the next read-back is due: after settling, and ended before the next switching."""
        ready = max(self._board.report_valid_at, self._clock.now())
        interval = (
            _READ_INTERVAL if self._pulses or self._read_at < self._switched_at else self._idle_interval
        )
        due = max(self._read_at + interval, ready)
        latest = switching.send - self._read_time - _MARGIN
        if due <= latest:
            return due
        after = switching.at + self._board.settling
        if after - self._read_at < _MAX_POSTPONED:
            return after
        return max(latest, ready)  # better early than during it

    def _next_time(self) -> float:
        switching = self._next_switching()
        extensions = [self._extend_at(pulse, switching) for pulse in self._pulses.values()]
        due = min([switching.send - _SPIN_TIME, self._next_read_at(switching), *extensions])
        return max(due, self._clock.now())

    @property
    def _was_suspended(self) -> bool:
        """Whether the computer was suspended since arming."""
        return self._host.suspended_time() - self._suspended_before > _MAX_DELAY / 2

    @property
    def _read_time(self) -> float:
        """Duration of a read-back with its measurement [s]."""
        return self._board.report_time + self._currents.query_time

    def _read_back(self) -> None:
        """Read the board back, advance the model, measure, and report."""
        closed = self._board.verify()
        self._read_at = now = self._clock.now()
        self._interlock.record_report(closed, now)
        report = Report(now, closed, self._interlock.temperatures, self._interlock.peak, self._max_delay)
        measured = self._currents.measure(self._next_switching().send - _MARGIN)
        self.on_report(self._currents.add_to(report, measured))
        self._interlock.check(now)
        self._currents.check(measured)
        self._interlock.record_currents(self._currents.heating_currents(measured))

    def _record_delay(self, seconds: float) -> None:
        self._max_delay = max(self._max_delay, seconds)
        self._require_no_delay(seconds)

    def _require_progress(self, since: float, allowed: float = 0.0) -> float:
        """Raise `EldirError` if a part of a step since `since` took too long, beyond the `allowed` time [s].

        Returns the present time. A process that was suspended while it waited for the board gets the answer
        when it continues; neither that answer nor a keepalive message shows the gap.
        """
        now = self._clock.now()
        self._require_no_delay(now - since - allowed)
        return now

    def _require_no_delay(self, seconds: float) -> None:
        if seconds > _MAX_DELAY:
            raise EldirError(
                f"the program was delayed by {seconds:.1f} s",
                code="guardian.stood-still",
                remedy="close other programs and start again",
            )

    def _switch_off(self) -> None:
        self._announced = []
        self._armed = False
        closed, self._pulses = dict.fromkeys(self._pulses, False), {}
        self.proof = BOARD_PROOF
        began = self._clock.now()
        self._board.all_off()
        if self._rig.fan_channel is not None:
            self._interlock.record_fan(False, began)
        self._interlock.record_switching(closed, self._clock.now())
        self._currents.record_switching(closed)
        if measured := self._currents.prove_no_current():
            self.proof += f"; {measured}"

    def _require_not_stopped(self) -> None:
        if self._stop_reason is not None:
            raise EldirError(
                f"the rig is stopped: {self._stop_reason}",
                code="guardian.stopped",
                remedy="reset it first: eldir rig reset",
            )
