"""Switches the board: pulses on time, re-arming, read-back, interlocks, heartbeats.

Runs in the guardian process on the wall's clock, and in the virtual rig's own process on a virtual one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

from eldir.errors import EldirError
from eldir_hardware.clock import Clock
from eldir_hardware.guardian.bank import BY_THE_BOARD, HeaterBank, Report, ReportCallback
from eldir_hardware.guardian.current_watch import CurrentWatch
from eldir_hardware.guardian.forecast import Heating
from eldir_hardware.guardian.interlock import Interlock
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.relay.errors import RelayError
from eldir_hardware.rig.boards import is_retriggerable, requirements_of
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.spring_memory import SpringHeat, Springs
from eldir_hardware.sensor.driver import CurrentSensor
from eldir_hardware.sensor.errors import SensorError

PATIENCE = 0.6
"""Everything is switched off after this time without a heartbeat [s]."""
PULSE = 0.5
"""A board that times its pulses gets pulses of at most this length, repeated as long as needed [s]."""
_REARM = 0.25  # remaining time of such a pulse when it is sent again [s]
_TICK = 0.1  # from one read-back to the next, while something is closed or may have stuck [s]
_IDLE_TICK = 0.5  # while all was seen open [s]
_LONGEST_BLIND = 0.4  # a read-back is put off for a switching no longer than this [s]
_LONGEST_UNSEEN = 1.5  # without a read-back while something heats [s]
_LATE = 0.5  # anything done later than this means that the program stood still [s]
_MARGIN = 0.02  # for a board that answers late, and for this program, until an edge [s]
_NEAR = 0.002  # an edge no farther away is waited for without sleeping [s]
_TOGETHER = 1e-3  # edges closer than this go out as one [s]
_FOREVER = float("inf")


class HeartbeatError(EldirError):
    """The program that ordered the heat sends no heartbeats."""

    code = "guardian.heartbeat"


class AsleepError(EldirError):
    """The computer was asleep; its contacts may have been closed all that time."""

    code = "guardian.asleep"


@dataclass
class _ClosedChannel:
    """A closed channel."""

    since: float
    """When it closed [s]."""
    until: float
    """When it opens [s]."""
    runs_to: float
    """When the board opens it by itself [s]."""


class _Switching(NamedTuple):
    """Channels that switch at one instant."""

    at: float
    """When their contacts are to move [s]."""
    send: float
    """When the command must be sent for that [s]."""
    opens: list[int]
    closes: dict[int, float]
    """Channels that close, each with the time when it opens again [s]."""


_NOTHING = _Switching(_FOREVER, _FOREVER, [], {})


class PulseController(HeaterBank):
    """Owns a board. `step` does what is due, and returns when it must be called again."""

    def __init__(
        self,
        board: RelayBoard,
        rig: Rig,
        clock: Clock,
        on_report: ReportCallback = lambda report: None,
        suspended: Callable[[], float] = lambda: 0.0,
        sensor: CurrentSensor | None = None,
        may_close: Callable[[], None] = lambda: None,
        before: Springs | None = None,
    ):
        """`suspended`: seconds for which this computer has slept since some instant; `sensor`: the one that
        the rig file names; `may_close`: called before a contact closes, raises where none may; `before`: what
        is known of the springs from the run before."""
        self._interlock = Interlock(rig, clock.now(), before)
        self._currents = CurrentWatch(rig, sensor, clock)
        self._board, self._rig, self._clock, self.on_report = board, rig, clock, on_report
        self._suspended, self._may_close = suspended, may_close
        self._slept = suspended()
        self._rearms = board.times_pulses and is_retriggerable(rig) is True
        self._idle = min(_IDLE_TICK, board.patience / 2)
        self._announced: list[tuple[float, int, float]] = []  # at, channel, seconds; in order of time
        self._pulses: dict[int, _ClosedChannel] = {}
        self._armed = False
        self.armed_once = False
        """Whether anything may have been heated."""
        self._heard = self._seen = self._switched = clock.now()
        self._latest = 0.0
        self._due = _FOREVER
        self._stopped: str | None = None

    # Commands.

    def check_limits(self) -> None:
        """Raise `EldirError` where the board's own limits are stricter than the rig file's."""
        self._board.check_limits(requirements_of(self._rig))

    def arm(self) -> None:
        self._refuse_stopped()
        self._slept = self._suspended()
        self._board.all_off()
        self._currents.arm()
        self.check_limits()
        if (fan := self._rig.fan_channel) is not None:
            self._board.switch({fan: True})
        now = self._clock.now()
        self.rested_at = now + self._interlock.rest_left(now)
        self._armed = self.armed_once = True
        self._due = self._clock.now()
        self.beat()
        self._look()

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._refuse_stopped()
        if not self._armed:
            raise EldirError(
                "the rig is not armed", code="guardian.not-armed", remedy="arm it before heating"
            )
        master = self._rig.master_channel
        closed = [Heating(p.since, c, p.until) for c, p in self._pulses.items() if c != master]
        announced = [Heating(t, c, t + seconds) for t, c, seconds in self._announced]
        self._interlock.allow(at, lengths, [*closed, *announced])
        self._announced = sorted([*self._announced, *((at, c, s) for c, s in lengths.items())])

    def heat_left(self) -> dict[int, SpringHeat] | None:
        """The springs by channel, for the next run; after everything was proven off.

        None if the computer slept since arming: nobody knows for how long contacts were closed.
        """
        if self._has_slept:
            return None
        return self._interlock.heat_left(self._clock.now())

    def beat(self) -> None:
        """A heartbeat: the program that ordered the heat is alive."""
        self._heard = self._clock.now()

    def abort_pulses(self) -> None:
        self._announced = []
        if self._pulses:
            now = self._clock.now()
            self._switch(_Switching(now, now, list(self._pulses), {}))

    def wait_until(self, t: float, on_report: ReportCallback) -> None:
        self.on_report = on_report
        while True:
            self.beat()
            due = self.step()
            if self._clock.now() >= t:
                return
            self._clock.sleep_until(min(due, t))

    def disarm(self) -> None:
        if self._armed:
            self._off()
            self._look()

    def stop(self, why: str) -> None:
        if self._stopped is None:
            self._stopped = why
            with suppress(SensorError):  # then the board's report is all that there is
                self._off()

    # Switching and watching.

    def step(self) -> float:
        """Do what is due, and return when there will be more to do [s on the clock]."""
        if not self._armed:
            return _FOREVER
        begun = self._clock.now()
        try:
            return self._step(begun)
        except RelayError:  # a program that slept while it waited for an answer has missed it
            self._refuse_late(self._clock.now() - begun - self._looking_time)
            raise

    def _step(self, now: float) -> float:
        if now - self._heard > PATIENCE:
            raise HeartbeatError(
                f"nothing was heard for {now - self._heard:.1f} s from the program that heats"
            )
        self._refuse_late(now - self._due)  # a heartbeat that waited in the pipe proves nothing
        if self._has_slept:
            raise AsleepError("the computer was asleep while it heated", remedy="keep it awake")
        since = now
        while (edge := self._next_edge()).send <= self._clock.now() + _NEAR:
            self._clock.meet(edge.send)
            self._note_delay(max(self._clock.now() - edge.send, 0.0))
            self._switch(edge)
            since = self._refuse_standstill(since)
        self._rearm()
        since = self._refuse_standstill(since)
        if self._time_to_look(self._next_edge()) <= self._clock.now():
            self._look()
        elif self._pulses and self._clock.now() - self._seen > _LONGEST_UNSEEN:
            raise EldirError(
                f"the board's contacts were not seen for {_LONGEST_UNSEEN:g} s",
                code="guardian.contacts-unseen",
                remedy="leave 0.15 s between the switchings of the schedule",
            )
        self._due = self._next()
        self._refuse_standstill(since, self._looking_time)
        return self._due

    def _next_edge(self) -> _Switching:
        """The next switching. A contactor is closed while any channel is."""
        instants = [*(p.until for p in self._pulses.values()), *(t for t, _, _ in self._announced[:1])]
        if not instants:
            return _NOTHING
        at = min(instants)
        opens = [c for c, p in self._pulses.items() if p.until <= at + _TOGETHER]
        closes = {c: t + s for t, c, s in self._announced if t <= at + _TOGETHER}
        master = self._rig.master_channel
        if master in opens and closes:
            opens.remove(master)
        if master is not None and closes:
            last = max(closes.values())
            if master in self._pulses:
                last = max(last, self._pulses[master].until)
            closes = {master: last} | closes
        return _Switching(at, at - self._board.delay(self._changes(opens, closes)), opens, closes)

    def _switch(self, edge: _Switching) -> None:
        """Open and close channels in as few frames as the board allows."""
        self._announced = [
            a for a in self._announced if a[1] not in edge.closes or a[0] > edge.at + _TOGETHER
        ]
        self._interlock.check_together((set(edge.closes) | set(self._pulses)) - set(edge.opens))
        if edge.closes:
            self._may_close()
        self._send(edge.opens, edge.closes)
        self._switched = self._clock.now()
        changes = self._changes(edge.opens, edge.closes)
        self._interlock.switched(changes, self._clock.now())
        self._currents.switched(changes)

    def _send(self, opens: list[int], closes: Mapping[int, float]) -> None:
        """Close channels until the times in `closes`, or repeat the command for channels that stay closed."""
        changes, now = self._changes(opens, closes), self._clock.now()
        if self._board.times_pulses:
            most = PULSE if self._rearms else _FOREVER
            seconds = {c: min(max(end - now, 0.1), most) for c, end in closes.items()}
            self._board.send(changes, seconds)
            runs_to = {c: now + math.ceil(10 * s - 1e-6) / 10 for c, s in seconds.items()}
        else:
            self._board.send(changes)
            runs_to = dict.fromkeys(closes, _FOREVER)
        for channel in opens:
            del self._pulses[channel]
        for channel, end in closes.items():
            since = self._pulses[channel].since if channel in self._pulses else now
            self._pulses[channel] = _ClosedChannel(since, end, runs_to[channel])

    def _changes(self, opens: Iterable[int], closes: Iterable[int]) -> dict[int, bool]:
        """Changes in the order of the commands: a contactor closes first and opens last."""
        in_order = sorted(opens, key=lambda c: c == self._rig.master_channel)
        return dict.fromkeys(in_order, False) | dict.fromkeys(closes, True)

    def _rearm(self) -> None:
        edge, begun = self._next_edge(), self._clock.now()
        for channel, pulse in list(self._pulses.items()):
            if self._rearm_at(pulse, edge) <= self._clock.now():
                self._send([], {channel: pulse.until})
        self._note_delay(self._clock.now() - begun)

    def _rearm_at(self, pulse: _ClosedChannel, edge: _Switching) -> float:
        """When to send a pulse again so that it goes on; after the next edge if it can wait."""
        if not self._rearms or pulse.until <= pulse.runs_to:
            return _FOREVER
        due = pulse.runs_to - _REARM
        if due < edge.send < due + _REARM / 2:
            return edge.send + _TOGETHER
        return due

    def _time_to_look(self, edge: _Switching) -> float:
        """When the next read-back is due: after settling, and not across the next edge."""
        ready = max(self._board.settled_at, self._clock.now())
        tick = _TICK if self._pulses or self._seen < self._switched else self._idle
        due = max(self._seen + tick, ready)
        before = edge.send - self._looking_time - _MARGIN
        if due <= before:
            return due
        after = edge.at + self._board.settling
        if after - self._seen < _LONGEST_BLIND:
            return after
        return max(before, ready)  # rather too early than across it

    def _next(self) -> float:
        edge = self._next_edge()
        rearms = [self._rearm_at(pulse, edge) for pulse in self._pulses.values()]
        due = min([edge.send - _NEAR, self._time_to_look(edge), *rearms])
        return max(due, self._clock.now())

    @property
    def _has_slept(self) -> bool:
        """Whether the computer was asleep since arming."""
        return self._suspended() - self._slept > _LATE / 2

    @property
    def _looking_time(self) -> float:
        """Duration of a read-back with its measurement [s]."""
        return self._board.report_time + self._currents.query_time

    def _look(self) -> None:
        """Read the board back, advance the model, measure, and report all of it."""
        closed = self._board.verify()
        self._seen = now = self._clock.now()
        self._interlock.reported(closed, now)
        report = Report(now, closed, self._interlock.temperatures, self._interlock.hottest, self._latest)
        measured = self._currents.measure(self._next_edge().send - _MARGIN)
        self.on_report(self._currents.added(report, measured))
        self._interlock.check(now)
        self._currents.judge(measured)

    def _note_delay(self, seconds: float) -> None:
        self._latest = max(self._latest, seconds)
        self._refuse_late(seconds)

    def _refuse_standstill(self, since: float, spared: float = 0.0) -> float:
        """Refuse a gap since `since` in the middle of a step, beyond the `spared` seconds that it needs.

        Returns the present time. A process that was suspended while it waited for the board finds the answer
        when it continues; neither that answer nor a heartbeat that arrived meanwhile shows the gap.
        """
        now = self._clock.now()
        self._refuse_late(now - since - spared)
        return now

    def _refuse_late(self, seconds: float) -> None:
        if seconds > _LATE:
            raise EldirError(
                f"the program stood still for {seconds:.1f} s",
                code="guardian.stood-still",
                remedy="close other programs and start again",
            )

    def _off(self) -> None:
        self._announced = []
        self._armed = False
        closed, self._pulses = dict.fromkeys(self._pulses, False), {}
        self.proof = BY_THE_BOARD
        self._board.all_off()
        self._interlock.switched(closed, self._clock.now())
        self._currents.switched(closed)
        if measured := self._currents.prove_none():
            self.proof += f"; {measured}"

    def _refuse_stopped(self) -> None:
        if self._stopped is not None:
            raise EldirError(
                f"the rig is stopped: {self._stopped}",
                code="guardian.stopped",
                remedy="reset it first: eldir rig reset",
            )
