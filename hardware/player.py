"""Plays a schedule on a relay board: on time, watched by a thermal model, off on every way out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from eldir.errors import EldirError
from eldir.sma import SpringState, heat
from hardware import limits
from hardware.clock import Clock
from hardware.relay.board import RelayBoard
from hardware.rig import Rig
from hardware.schedule import ActuationSchedule
from hardware.stop import Stop

TICK = 0.5
"""How often the board is read back and the model moved on, at least [s]."""
_LATE = 0.5  # a switching later than this means that the program stood still [s]
_MODEL_STEP = 0.05  # [s]
_SAFE = "everything was switched off"
_MARGIN = 0.02  # for a board that answers late [s]


class Observer(Protocol):
    """Learns what happens on the rig, such as the recorder of a log."""

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        """The board's report of all channels at `t` [s since the start]."""

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        """Modelled from the reports, one for each channel of the rig file in its order [C]."""


@dataclass(frozen=True)
class Played:
    """How it went."""

    peak_c: float
    """Highest modelled temperature [C]."""
    latest_s: float
    """Greatest delay of a switching [s]."""
    duration_s: float
    """[s]"""


class Player:
    """One schedule on one board. `play` refuses, plays to the end, or raises with everything off."""

    def __init__(
        self,
        board: RelayBoard,
        schedule: ActuationSchedule,
        rig: Rig,
        clock: Clock,
        observers: Sequence[Observer] = (),
    ):
        self.prediction = limits.check(schedule, rig)
        self._board = board
        self._schedule = schedule
        self._rig = rig
        self._clock = clock
        self._observers = observers
        self._springs = rig.spring_parameters()
        self._state = SpringState.cold(len(rig.channels), self._springs)
        self._peak = self._springs.ambient
        self._believed = (False,) * board.channels
        self._closed_since: dict[int, float] = {}

    def play(self, start: float | None = None) -> Played:
        """Heat as scheduled from `start` on the clock, or at once.

        Ctrl-C, SIGTERM and a closed terminal end it with everything off. Observers' times count
        from the start.
        """
        stop = Stop()
        with stop.caught(), self._board.armed(), stop.heeded():
            self._start = self._clock.now() if start is None else start
            self._clock.sleep_until(self._start)
            self._modelled_to = self._elapsed()
            self._observe(self._believed)
            latest = 0.0
            for t, changes in self._schedule.switchings():
                self._watch_until(t)
                self._clock.sleep_until(self._start + t)
                late = self._elapsed() - t
                if late > _LATE:
                    raise EldirError(
                        f"the program stood still for {late:.1f} s",
                        remedy=f"{_SAFE}; close other programs and start again",
                    )
                latest = max(latest, late)
                self._switch(t, changes)
            self._watch_until(self._schedule.duration)
            self._clock.sleep_until(self._start + self._schedule.duration)
        self._observe((False,) * self._board.channels)
        return Played(round(self._peak, 2), latest, self._elapsed())

    def _switch(self, t: float, changes: dict[int, bool]) -> None:
        self._model_until_now(self._believed)
        self._board.send(changes, self._lengths(changes, t))
        now = self._elapsed()
        for channel, on in changes.items():
            if on:
                self._closed_since.setdefault(channel, now)
            else:
                self._closed_since.pop(channel, None)
        # What was opened counts as open from here if the next report says so.
        self._believed = tuple(
            state and changes.get(channel, True) for channel, state in enumerate(self._believed, start=1)
        )

    def _lengths(self, changes: dict[int, bool], t: float) -> dict[int, float]:
        """How long the channels that close now are to stay so [s]: a board's own timer holds it to that."""
        period = self._schedule.period_s
        phase = t - self._schedule.settle_s
        return {
            p.channel: p.length
            for p in self._schedule.pulses()
            if changes.get(p.channel) and abs((phase - p.start + period / 2) % period - period / 2) < 1e-6
        }

    def _watch_until(self, t: float) -> None:
        """Verify, model and report again and again, but leave the board alone just before `t`."""
        need = self._board.verification_time + _MARGIN
        while t - self._elapsed() > need + 1e-3:
            self._observe(self._board.verify())
            self._supervise()
            self._clock.sleep_until(self._start + min(self._elapsed() + TICK, t - need))

    def _observe(self, reported: tuple[bool, ...]) -> None:
        """A contact counts as closed since the last report if either report says so."""
        self._model_until_now(tuple(a or b for a, b in zip(self._believed, reported, strict=True)))
        self._believed = reported
        now = self._elapsed()
        for observer in self._observers:
            observer.on_relays(now, reported)
            observer.on_temperatures(now, tuple(float(x) for x in self._state.temperature))

    def _model_until_now(self, closed: tuple[bool, ...]) -> None:
        elapsed = self._elapsed() - self._modelled_to
        if elapsed <= 0:
            return
        steps = int(np.ceil(elapsed / _MODEL_STEP))
        heated = [closed[c.channel - 1] for c in self._rig.channels]
        history = heat(np.tile(heated, (steps, 1)), elapsed / steps, self._springs, self._state)
        self._state = history.final
        self._peak = max(self._peak, float(history.temperature.max()))
        self._modelled_to += elapsed

    def _supervise(self) -> None:
        ceiling = self._rig.limits.ceiling_c
        if self._state.temperature.max() > ceiling:
            hot = self._rig.channels[int(self._state.temperature.argmax())]
            raise EldirError(
                f"the spring on channel {hot.channel} is too hot by the model",
                expected=f"at most {ceiling:g} C",
                found=f"{self._state.temperature.max():.1f} C",
                remedy=_SAFE,
            )
        now = self._elapsed()
        for channel, since in self._closed_since.items():
            if now - since > self._rig.limits.longest_on_s + TICK:
                raise EldirError(
                    f"channel {channel} was closed for too long",
                    expected=f"at most {self._rig.limits.longest_on_s:g} s",
                    found=f"{now - since:.1f} s",
                    remedy=_SAFE,
                )

    def _elapsed(self) -> float:
        return self._clock.now() - self._start
