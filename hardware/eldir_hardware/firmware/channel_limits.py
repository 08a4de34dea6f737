"""What a MOSFET board allows, whatever its host sends, and the pulse-width modulation of its gates.

Limits are the on-time, the duty and the heartbeat; everything is off after a reset.

Runs on MicroPython on the board and on CPython in the emulated board, so it uses whole numbers, imports
nothing and never waits. Times are those of `time.ticks_ms`, which begin again at 0 after 2**30 ms: only their
differences are used, and other times are kept as remaining times.

The modulation is slow, and not that of the chip at some kilohertz: a current-limited supply charges its
output capacitor while the gate is low and discharges it through the spring when the gate rises, so that fast
pulses carry more than the limited current. And a channel of the chip's modulation keeps its level, perhaps
high, when its block is stopped.
"""

_TICKS = 0x3FFFFFFF
_FULL = 100  # [%]

# Why everything is off. A host must acknowledge this before it may switch anything on.
NOTHING = "-"
POWER_UP = "P"
WATCHDOG = "W"
SILENCE = "S"
BUDGET = "B"
# Further reasons why one channel was switched off.
COMMAND = "C"
TIME = "T"


def elapsed_ms(now: int, before: int) -> int:
    """Time between two readings of a clock that begins again at 0 after 2**30 ms [ms]."""
    return (now - before) & _TICKS


class ChannelLimits:
    """State of all channels. `step` must be called often; nothing else makes time pass.

    Every channel has a budget of heat. It fills by power minus duty while the channel is on, and empties by
    the duty while it is off. Its size is such that full power fills it from empty in just `max_on_ms`. So
    in any time t a channel gets at most duty * t + (1 - duty) * max_on_ms of full power. After a reset
    the springs may be hot: the budget begins full.
    """

    def __init__(
        self,
        channels: int,
        max_on_ms: int,
        duty_percent: int,
        heartbeat_ms: int,
        steady: tuple[int, ...],
        now: int,
        reason: str,
    ) -> None:
        """`steady`: channels (from 1) without a budget. `reason`: `POWER_UP` or `WATCHDOG`."""
        self.channels = channels
        self.max_on_ms = max_on_ms
        self.duty_percent = duty_percent
        self.heartbeat_ms = heartbeat_ms
        self.steady = [i + 1 in steady for i in range(channels)]
        self.power = [0] * channels
        """Part of the full power on each channel [%]."""
        self.remaining_ms = [0] * channels
        """Time until each channel is switched off [ms]; 0 if only the heartbeat ends it."""
        self.off_reason = [reason] * channels
        self.trip_reason = reason
        """Why everything is off until `acknowledge`; `NOTHING` if it is not."""
        self._budget = max_on_ms * (_FULL - duty_percent)  # [% ms]
        self._spent = [self._budget] * channels
        self._silence_ms = 0
        self._now = now

    def budget_percent(self, channel: int) -> int:
        """Remaining part of a channel's budget [%]; `channel` counts from 0."""
        return _FULL - self._spent[channel] * _FULL // max(self._budget, 1)

    def on_mask(self) -> int:
        """The channels that are on, channel 1 in the lowest bit."""
        on_mask = 0
        for i in range(self.channels):
            if self.power[i]:
                on_mask |= 1 << i
        return on_mask

    def step(self, now: int) -> None:
        """Advance the time to `now`, and switch off what must be off. A clock that runs back counts as a long
        time."""
        elapsed = elapsed_ms(now, self._now)
        self._now = now
        self._silence_ms = min(self._silence_ms + elapsed, self.heartbeat_ms)
        exceeded = False
        for i in range(self.channels):
            spent = self._spent[i] + (self.power[i] - self.duty_percent) * elapsed
            self._spent[i] = min(max(spent, 0), self._budget)
            if self.power[i] and self.remaining_ms[i]:
                self.remaining_ms[i] -= min(elapsed, self.remaining_ms[i])
                if not self.remaining_ms[i]:
                    self._off(i, TIME)
            if self.power[i] and not self.is_allowed(i, self.power[i]):
                exceeded = True
        if self.on_mask():
            if self._silence_ms >= self.heartbeat_ms:
                self.trip(SILENCE)
            elif exceeded:
                self.trip(BUDGET)

    def reset_heartbeat(self) -> None:
        """The host has sent a new request."""
        self._silence_ms = 0

    def is_allowed(self, channel: int, power: int) -> bool:
        """Whether the budget of a channel (from 0) allows this power [%] at all now."""
        return self.steady[channel] or power <= self.duty_percent or self._spent[channel] < self._budget

    def switch(self, channel: int, power: int, ms: int) -> None:
        """Switch a channel (from 0) to a part of the full power [%] for `ms`; 0: until the next command.

        The caller calls `step` and `is_allowed` first.
        """
        if self.trip_reason != NOTHING or not power:
            self._off(channel, COMMAND)
        else:
            self.power[channel] = power
            self.remaining_ms[channel] = ms

    def all_off(self) -> None:
        """Everything off, as the host commanded."""
        for i in range(self.channels):
            self._off(i, COMMAND)

    def trip(self, reason: str) -> None:
        """Switch everything off until `acknowledge`."""
        self.trip_reason = reason
        for i in range(self.channels):
            self._off(i, reason)

    def acknowledge(self) -> None:
        """Confirm that the host knows why everything was switched off. Everything stays off."""
        self.all_off()
        self.trip_reason = NOTHING
        self._silence_ms = 0

    def next_event_ms(self) -> int:
        """Time from the last step until a channel is switched off [ms]; -1 if none will be."""
        next_ms = -1
        for i in range(self.channels):
            if self.power[i]:
                end = self.heartbeat_ms - self._silence_ms
                if self.remaining_ms[i]:
                    end = min(end, self.remaining_ms[i])
                rate = self.power[i] - self.duty_percent
                if rate > 0 and not self.steady[i]:
                    end = min(end, -((self._spent[i] - self._budget) // rate))
                next_ms = end if next_ms < 0 else min(next_ms, end)
        return next_ms

    def _off(self, channel: int, reason: str) -> None:
        if self.power[channel]:
            self.off_reason[channel] = reason
        self.power[channel] = 0
        self.remaining_ms[channel] = 0


class Modulation:
    """Switches each gate on at the start of a period and off after its part of the period.

    The next period compensates for a gate that was high for too long or too short because the program was
    late.
    """

    def __init__(self, channels: int, period_ms: int, now: int) -> None:
        self._period = period_ms
        self._credit = [0] * channels  # remaining on-time of a gate in its period [% ms]
        self._elapsed = [-1] * channels  # time since the start of its period [ms]; -1 if not modulated
        self._high = 0
        self._now = now

    def update(self, power: list[int], now: int) -> int:
        """Return the gates that must be high, channel 1 in the lowest bit. `power` of each channel [%]."""
        elapsed = min((now - self._now) & _TICKS, 1 << 16)
        self._now = now
        high = 0
        for i in range(len(power)):
            if 0 < power[i] < _FULL:
                if self._is_high(i, power[i], elapsed):
                    high |= 1 << i
            else:
                self._credit[i] = 0
                self._elapsed[i] = -1
                if power[i]:
                    high |= 1 << i
        self._high = high
        return high

    def _is_high(self, channel: int, power: int, elapsed: int) -> bool:
        if self._elapsed[channel] < 0:
            self._elapsed[channel] = 0
            self._credit[channel] = power * self._period
            return True
        if self._high >> channel & 1:
            self._credit[channel] -= _FULL * elapsed
        self._elapsed[channel] += elapsed
        if self._elapsed[channel] >= self._period:
            self._elapsed[channel] %= self._period
            credit = self._credit[channel] + power * self._period
            self._credit[channel] = min(credit, 2 * _FULL * self._period)
        return self._credit[channel] > 0
