"""The emulated MOSFET board: the firmware's own limits and protocol, behind a pseudo-terminal.

Only what the chip does is emulated: clock, gates, watchdog. A modulated gate is one edge with its mean power.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard
from eldir_hardware.firmware import limits
from eldir_hardware.firmware.channel_limits import POWER_UP, WATCHDOG, ChannelLimits
from eldir_hardware.firmware.protocol import LONGEST, Conversation

_FIRST_TICK = (
    1 << 30
) - 70_000  # the board's clock begins again ten seconds after the emulation's start [ms]
_POWERED = 60_000  # the board has been powered for so long at that start [ms]


class EmulatedMosfet(EmulatedBoard):
    """A welded contact is a MOSFET that has failed closed: it conducts fully, whatever its gate does."""

    baud = 115200
    contact_time = 0.0

    def __init__(self, channels: int, clock: Clock, on_edge: Callable[[ContactEvent], None] | None = None):
        super().__init__(channels, clock, on_edge)
        self._turn = threading.RLock()  # the line and the timers have their own threads
        self._epoch = self._stepped_to = clock.now()
        self._resets = 0
        self._hung = False
        self._wake_at = float("inf")
        self._wakes = 0
        self._start(POWER_UP, _FIRST_TICK)
        self.limits.step(self._ticks())

    def reset(self) -> None:
        """The chip restarts, as after a dip of its supply: every gate falls, and the board tells so."""
        self._restart(POWER_UP)

    def hang(self) -> None:
        """The program stops, its gates stay as they are: the watchdog resets the chip."""
        with self._turn:
            self._hung = True
            due = self._clock.now() + limits.WATCHDOG_MS / 1e3
        self._clock.at(due, lambda t: self._restart(WATCHDOG))

    def _restart(self, why: str) -> None:
        with self._turn:
            self._stepped_to = max(self._stepped_to, self._clock.now())
            self._start(why, self._ticks())
            self._hung = False
            self._follow(self._stepped_to)

    def _start(self, why: str, tick: int) -> None:
        self._resets += 1
        self.limits = ChannelLimits(
            self.channels,
            limits.LONGEST_ON_MS,
            limits.DUTY_PERCENT,
            limits.HEARTBEAT_MS,
            limits.STEADY,
            tick,
            why,
        )
        self._conversation = Conversation(self.limits, 0x5EED + self._resets)

    def _ticks(self) -> int:
        """The board's clock [ms], which begins again at 0 after 2**30."""
        since = int(1e3 * (self._stepped_to - self._epoch) + 1e-6)
        return (_FIRST_TICK + _POWERED + since) & ((1 << 30) - 1)

    def _request_length(self, data: bytes) -> int:
        end = data.find(b"\n") + 1
        return end or (len(data) - LONGEST if len(data) > LONGEST else 0)

    def _obey(self, request: bytes) -> bytes:
        with self._turn:
            if self._hung:
                return b""
            t = self._stepped_to = max(self._stepped_to, self._wire_free_at)
            self.limits.step(self._ticks())
            self._follow(t)
            answer = self._conversation.answer(request[-LONGEST:], self._ticks())
            self._follow(t)
            return answer

    def _wake(self, t: float, number: int) -> None:
        """The time of the latest timer has come; older timers are of no importance any more."""
        with self._turn:
            if self._hung or number != self._wakes:
                return
            self._wake_at = float("inf")
            self._stepped_to = max(self._stepped_to, t)
            self.limits.step(self._ticks())
            self._follow(self._stepped_to)

    def _follow(self, t: float) -> None:
        """Move the gates as the limits say, and wake up when they will say something else."""
        for i, power in enumerate(self.limits.power):
            self._set_coil(i + 1, power > 0, t)
        self._conversation.disagreeing = sum(
            1 << i for i, power in enumerate(self.limits.power) if (power > 0) != self._coils[i]
        )
        due = self.limits.due_ms()
        if due >= 0:
            at = self._epoch + (int(1e3 * (t - self._epoch) + 1e-6) + due) / 1e3
            if at < self._wake_at:
                self._wake_at = at
                self._wakes += 1
                number = self._wakes
                self._clock.at(at, lambda t: self._wake(t, number))

    def _power(self, channel: int) -> float:
        return self.limits.power[channel - 1] / 100
