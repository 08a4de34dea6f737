"""The emulated MOSFET board: the firmware's own limits and protocol, behind a pseudo-terminal.

Only what the chip does is emulated: clock, gates, watchdog. A modulated gate is one contact event
with its mean power.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from eldir_hardware.clock import Clock
from eldir_hardware.emulator.board import ContactEvent, EmulatedBoard
from eldir_hardware.firmware import limits
from eldir_hardware.firmware.channel_limits import POWER_UP, WATCHDOG, ChannelLimits
from eldir_hardware.firmware.protocol import MAX_REQUEST, RequestHandler

_FIRST_TICK = (1 << 30) - 70_000  # the board's clock wraps ten seconds after the emulation's start [ms]
_POWERED = 60_000  # the board has been powered for so long at that start [ms]


class EmulatedMosfet(EmulatedBoard):
    """A welded contact is a MOSFET that has failed closed: it conducts fully, whatever its gate does."""

    baud = 115200
    contact_time = 0.0

    def __init__(
        self, channels: int, clock: Clock, on_contact_event: Callable[[ContactEvent], None] | None = None
    ):
        super().__init__(channels, clock, on_contact_event)
        self._state_lock = threading.RLock()  # line and timers have their own threads
        self._epoch = self._now = clock.now()
        self._resets = 0
        self._hung = False
        self._wake_time = float("inf")
        self._wake_count = 0
        self._start(POWER_UP, _FIRST_TICK)
        self.limits.step(self._tick())

    def reset(self) -> None:
        """Restart the chip, as after a dip of its supply: every gate falls, and the board reports it."""
        self._restart(POWER_UP)

    def hang(self) -> None:
        """Stop the program with its gates as they are; the watchdog resets the chip later."""
        with self._state_lock:
            self._hung = True
            due = self._clock.now() + limits.WATCHDOG_MS / 1e3
        self._clock.call_at(due, lambda t: self._restart(WATCHDOG))

    def _restart(self, reason: str) -> None:
        with self._state_lock:
            self._now = max(self._now, self._clock.now())
            self._start(reason, self._tick())
            self._hung = False
            self._move_gates(self._now)

    def _start(self, reason: str, tick: int) -> None:
        self._resets += 1
        self.limits = ChannelLimits(
            self.channels,
            limits.MAX_ON_MS,
            limits.DUTY_PERCENT,
            limits.HEARTBEAT_MS,
            limits.STEADY,
            tick,
            reason,
        )
        self._handler = RequestHandler(self.limits, 0x5EED + self._resets)

    def _tick(self) -> int:
        """The board's clock [ms], which begins again at 0 after 2**30."""
        since = int(1e3 * (self._now - self._epoch) + 1e-6)
        return (_FIRST_TICK + _POWERED + since) & ((1 << 30) - 1)

    def request_length(self, data: bytes) -> int:
        end = data.find(b"\n") + 1
        return end or (len(data) - MAX_REQUEST if len(data) > MAX_REQUEST else 0)

    def obey(self, request: bytes) -> bytes:
        with self._state_lock:
            if self._hung:
                return b""
            t = self._now = max(self._now, self._wire_free_at)
            self.limits.step(self._tick())
            self._move_gates(t)
            answer = self._handler.answer(request[-MAX_REQUEST:], self._tick())
            self._move_gates(t)
            return answer

    def _wake(self, t: float, number: int) -> None:
        """Called by a timer; only the latest timer has an effect."""
        with self._state_lock:
            if self._hung or number != self._wake_count:
                return
            self._wake_time = float("inf")
            self._now = max(self._now, t)
            self.limits.step(self._tick())
            self._move_gates(self._now)

    def _move_gates(self, t: float) -> None:
        """Switch the gates as the limits require, and set a timer for their next change."""
        for i, power in enumerate(self.limits.power):
            self.set_coil(i + 1, power > 0, t)
        self._handler.mismatched_gates = sum(
            1 << i for i, power in enumerate(self.limits.power) if (power > 0) != self.coils[i]
        )
        due = self.limits.next_event_ms()
        if due >= 0:
            at = self._epoch + (int(1e3 * (t - self._epoch) + 1e-6) + due) / 1e3
            if at < self._wake_time:
                self._wake_time = at
                self._wake_count += 1
                number = self._wake_count
                self._clock.call_at(at, lambda t: self._wake(t, number))

    def _power(self, channel: int) -> float:
        return self.limits.power[channel - 1] / 100
