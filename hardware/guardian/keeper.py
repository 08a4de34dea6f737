"""The one who switches: pulses on time and re-armed, read-back, interlocks, heartbeats.

Runs in the guardian process on the wall's clock, and in the virtual rig's own process on a virtual one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from eldir.errors import EldirError
from hardware.clock import Clock
from hardware.guardian.bank import Bank, Report, See
from hardware.guardian.interlock import Interlock
from hardware.relay.board import RelayBoard
from hardware.relay.errors import RelayError
from hardware.rig import Rig

PATIENCE = 0.6
"""Without a heartbeat for so long, everything goes off [s]."""
PULSE = 0.5
"""A board that times its pulses is told to heat for at most so long, again and again [s]."""
_REARM = 0.25  # what is left of such a pulse when it is told again [s]
_TICK, _IDLE_TICK = 0.1, 0.5  # from one read-back to the next, while something is closed or not [s]
_LONGEST_BLIND = 0.4  # a read-back is put off for a switching no longer than this [s]
_LATE = 0.5  # a switching later than this means that the program stood still [s]
_MARGIN = 0.01  # for a board that answers late [s]
_TOGETHER = 1e-3  # edges closer than this go out as one [s]
_FOREVER = float("inf")


class HeartbeatError(EldirError):
    """Whoever ordered the heat is silent."""


@dataclass
class _Pulse:
    """A closed channel."""

    until: float
    """When it opens [s]."""
    runs_to: float
    """When the board opens it by itself [s]."""


class Keeper(Bank):
    """Owns a board. `step` does what is due and must be called again when it says."""

    def __init__(
        self,
        board: RelayBoard,
        rig: Rig,
        clock: Clock,
        see: See = lambda report: None,
        suspended: Callable[[], float] = lambda: 0.0,
    ):
        """`suspended`: seconds for which this computer has slept since some instant."""
        self._interlock = Interlock(rig, clock.now())
        self._board, self._rig, self._clock, self.see = board, rig, clock, see
        self._suspended = suspended
        self._slept = suspended()
        self._ahead = board.delay
        self._rearms = board.times_pulses and rig.board.second_flash == "restarts"
        self._announced: list[tuple[float, int, float]] = []  # at, channel, seconds; in order of time
        self._pulses: dict[int, _Pulse] = {}
        self._armed = False
        self.armed_once = False
        """Whether anything may have been heated."""
        self._heard = self._seen = clock.now()
        self._latest = 0.0
        self._stopped: str | None = None

    # What may be asked of it.

    def arm(self) -> None:
        self._refuse_stopped()
        self._board.all_off()
        if (fan := self._rig.fan_channel) is not None:
            self._board.switch({fan: True})
        self._armed = self.armed_once = True
        self.beat()
        self._look()

    def heat(self, at: float, lengths: Mapping[int, float]) -> None:
        self._refuse_stopped()
        if not self._armed:
            raise EldirError("the rig is not armed", remedy="arm it before heating")
        opens = {c: p.until for c, p in self._pulses.items() if c != self._rig.master_channel}
        opens |= {c: t + seconds for t, c, seconds in self._announced}
        self._interlock.allow(at, lengths, opens)
        self._announced = sorted([*self._announced, *((at, c, s) for c, s in lengths.items())])

    def beat(self) -> None:
        """Whoever ordered the heat is there."""
        self._heard = self._clock.now()

    def cut(self) -> None:
        self._announced = []
        self._open(list(self._pulses))

    def rest_until(self, t: float, see: See) -> None:
        self.see = see
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
            self._off()

    # What it does by itself.

    def step(self) -> float:
        """Do what is due, and return when there will be more to do [s on the clock]."""
        if not self._armed:
            return _FOREVER
        now = self._clock.now()
        if now - self._heard > PATIENCE:
            raise HeartbeatError(
                f"nothing was heard for {now - self._heard:.1f} s from the program that heats"
            )
        if self._suspended() - self._slept > _LATE / 2:
            raise EldirError("the computer was asleep while it heated", remedy="keep it awake")
        reach = now + self._ahead + _TOGETHER
        self._open([c for c, p in self._pulses.items() if p.until <= reach])
        self._close_due(now)
        self._rearm()
        if self._time_to_look() <= self._clock.now():
            self._look()
        return self._next()

    def _close_due(self, now: float) -> None:
        reach = now + self._ahead + _TOGETHER
        due = {c: (t, s) for t, c, s in self._announced if t <= reach}
        if not due:
            return
        self._announced = [a for a in self._announced if a[0] > reach]
        self._note_delay(now + self._ahead - min(t for t, _ in due.values()))
        ends = {c: t + s for c, (t, s) in due.items()}
        if (master := self._rig.master_channel) is not None:  # closes first, opens last
            last = max(ends.values())
            if master in self._pulses:
                self._pulses[master].until = max(last, self._pulses[master].until)
            else:
                ends = {master: last} | ends
        self._interlock.check_together(set(ends) | set(self._pulses))
        self._send_pulses(ends)
        self._interlock.switched(dict.fromkeys(ends, True), self._clock.now())

    def _send_pulses(self, ends: Mapping[int, float]) -> None:
        """Close channels until `ends`, or tell the board again that they stay closed."""
        if not self._board.times_pulses:
            self._board.send(dict.fromkeys(ends, True))
            self._pulses |= {c: _Pulse(end, _FOREVER) for c, end in ends.items()}
            return
        for channel, end in ends.items():
            seconds = max(end - self._clock.now(), 0.1)
            if self._rearms:
                seconds = min(seconds, PULSE)
            self._board.send({channel: True}, {channel: seconds})
            runs_to = self._clock.now() + math.ceil(10 * seconds - 1e-6) / 10
            self._pulses[channel] = _Pulse(end, runs_to)

    def _rearm(self) -> None:
        now = self._clock.now()
        for channel, pulse in list(self._pulses.items()):
            if self._rearm_at(pulse) <= self._clock.now():
                self._send_pulses({channel: pulse.until})
        self._note_delay(self._clock.now() - now)

    def _rearm_at(self, pulse: _Pulse) -> float:
        """When the board is told again that a pulse goes on: not across an edge, if it can wait for that."""
        if not self._rearms or pulse.until <= pulse.runs_to:
            return _FOREVER
        due, edge = pulse.runs_to - _REARM, self._next_edge()
        if due < edge < due + _REARM / 2 + _TOGETHER:
            return edge + _TOGETHER
        return due

    def _open(self, channels: list[int]) -> None:
        if not channels:
            return
        master = self._rig.master_channel
        channels.sort(key=lambda c: c == master)
        now = self._clock.now()
        self._note_delay(now + self._ahead - min(self._pulses[c].until for c in channels))
        self._board.send(dict.fromkeys(channels, False))
        for channel in channels:
            del self._pulses[channel]
        self._interlock.switched(dict.fromkeys(channels, False), self._clock.now())

    def _time_to_look(self) -> float:
        """When the next read-back is due: after settling, and not across the next edge."""
        tick = _TICK if self._pulses else _IDLE_TICK
        due = max(self._seen + tick, self._board.settled_at)
        edge = self._next_edge()
        if due + self._board.report_time + _MARGIN > edge:
            after = edge + self._board.settling
            return after if after - self._seen < _LONGEST_BLIND else due
        return due

    def _next_edge(self) -> float:
        opening = min((p.until for p in self._pulses.values()), default=_FOREVER)
        return min([opening, *(a[0] for a in self._announced[:1])]) - self._ahead

    def _next(self) -> float:
        due = [self._next_edge(), self._time_to_look(), *map(self._rearm_at, self._pulses.values())]
        return max(min(due), self._clock.now())

    def _look(self) -> None:
        """Read the board back, move the model on, and show both."""
        closed = self._board.verify()
        self._seen = now = self._clock.now()
        self._interlock.reported(closed, now)
        self.see(Report(now, closed, self._interlock.temperatures, self._interlock.hottest, self._latest))
        self._interlock.check(now)
        fan = self._rig.fan_channel
        if self._armed and fan is not None and not closed[fan - 1]:
            raise RelayError("the fan is off", remedy="look at its relay")

    def _note_delay(self, seconds: float) -> None:
        self._latest = max(self._latest, seconds)
        if seconds > _LATE:
            raise EldirError(
                f"the program stood still for {seconds:.1f} s", remedy="close other programs and start again"
            )

    def _off(self) -> None:
        self._announced = []
        self._armed = False
        closed, self._pulses = list(self._pulses), {}
        self._board.all_off()
        self._interlock.switched(dict.fromkeys(closed, False), self._clock.now())

    def _refuse_stopped(self) -> None:
        if self._stopped is not None:
            raise EldirError(f"the rig is stopped: {self._stopped}", remedy="reset it first: eldir rig reset")
