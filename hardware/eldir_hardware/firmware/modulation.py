"""Slow pulse-width modulation: which gates are high now, for a part of the full power on each channel.

Why slow, and not the chip's own modulation at some kilohertz: a current-limited supply charges its output
capacitor while the gate is low and empties it through the spring when the gate rises, so that fast pulses
carry more than the limited current. And a channel of the chip's own modulation stands still, perhaps high,
when its block is stopped.

Runs on MicroPython and on CPython: whole numbers, no imports.
"""

_TICKS = 0x3FFFFFFF
_FULL = 100  # [%]


class Modulation:
    """Switches each gate on at the start of a period and off when its part of the period is spent.

    A gate that was high for too long or too short, because the program was late, makes up for it in the next
    period.
    """

    def __init__(self, channels: int, period_ms: int, now: int) -> None:
        self._period = period_ms
        self._credit = [0] * channels  # what a gate may still be high in its period [% ms]
        self._into = [-1] * channels  # its period began this long ago [ms]; -1 where it is not modulated
        self._high = 0
        self._now = now

    def gates(self, power: list[int], now: int) -> int:
        """The gates that are to be high, channel 1 in the lowest bit. `power` of each channel [%]."""
        elapsed = min((now - self._now) & _TICKS, 1 << 16)
        self._now = now
        high = 0
        for i in range(len(power)):
            if 0 < power[i] < _FULL:
                if self._modulated(i, power[i], elapsed):
                    high |= 1 << i
            else:
                self._credit[i] = 0
                self._into[i] = -1
                if power[i]:
                    high |= 1 << i
        self._high = high
        return high

    def _modulated(self, channel: int, power: int, elapsed: int) -> bool:
        if self._into[channel] < 0:
            self._into[channel] = 0
            self._credit[channel] = power * self._period
            return True
        if self._high >> channel & 1:
            self._credit[channel] -= _FULL * elapsed
        self._into[channel] += elapsed
        if self._into[channel] >= self._period:
            self._into[channel] %= self._period
            credit = self._credit[channel] + power * self._period
            self._credit[channel] = min(credit, 2 * _FULL * self._period)
        return self._credit[channel] > 0
