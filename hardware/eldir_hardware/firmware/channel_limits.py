"""What a MOSFET board allows, whatever its host sends: on-time, duty, heartbeat, and all off after a reset.

Runs on MicroPython on the board and on CPython in the emulated board, so it uses whole numbers, imports
nothing and never waits. Times are those of `time.ticks_ms`, which begin again at 0 after 2**30 ms: only their
differences are used, and every other time is kept as what is left of it.
"""

_TICKS = 0x3FFFFFFF
_FULL = 100  # [%]

# Why everything is off. A host must acknowledge it before it may switch anything on.
NOTHING = "-"
POWER_UP = "P"
WATCHDOG = "W"
SILENCE = "S"
BUDGET = "B"
# Why one channel went off, beside these.
COMMAND = "C"
TIME = "T"


def elapsed_ms(now: int, before: int) -> int:
    """Time between two readings of a clock that begins again at 0 after 2**30 ms [ms]."""
    return (now - before) & _TICKS


class ChannelLimits:
    """State of all channels. `step` must be called often; nothing else makes time pass.

    Every channel has a budget of heat. It fills by power minus duty while the channel is on, and empties by
    the duty while it is off. Its size is such that full power fills it from empty in just `longest_on_ms`. So
    in any time t a channel gets at most duty * t + (1 - duty) * longest_on_ms of full power. After a reset
    the springs may be hot: the budget begins full.
    """

    def __init__(
        self,
        channels: int,
        longest_on_ms: int,
        duty_percent: int,
        heartbeat_ms: int,
        steady: tuple[int, ...],
        now: int,
        why: str,
    ) -> None:
        """`steady`: channels (from 1) without a budget. `why`: `POWER_UP` or `WATCHDOG`."""
        self.channels = channels
        self.longest_on_ms = longest_on_ms
        self.duty_percent = duty_percent
        self.heartbeat_ms = heartbeat_ms
        self.steady = [i + 1 in steady for i in range(channels)]
        self.power = [0] * channels
        """Part of the full power on each channel [%]."""
        self.left = [0] * channels
        """Time until each channel goes off by itself [ms]; 0 where nothing but the heartbeat ends it."""
        self.why_off = [why] * channels
        self.tripped = why
        """Why everything is off until `acknowledge`; `NOTHING` where it is not."""
        self._most = longest_on_ms * (_FULL - duty_percent)  # [% ms]
        self._spent = [self._most] * channels
        self._quiet = 0
        self._now = now

    def budget_percent(self, channel: int) -> int:
        """What is left of a channel's budget [%]; `channel` counts from 0."""
        return _FULL - self._spent[channel] * _FULL // max(self._most, 1)

    def mask(self) -> int:
        """The channels that are on, channel 1 in the lowest bit."""
        mask = 0
        for i in range(self.channels):
            if self.power[i]:
                mask |= 1 << i
        return mask

    def step(self, now: int) -> None:
        """Let time pass until `now`, and switch off what must go off. A clock that goes back is a long
        time."""
        elapsed = elapsed_ms(now, self._now)
        self._now = now
        self._quiet = min(self._quiet + elapsed, self.heartbeat_ms)
        exceeded = False
        for i in range(self.channels):
            spent = self._spent[i] + (self.power[i] - self.duty_percent) * elapsed
            self._spent[i] = min(max(spent, 0), self._most)
            if self.power[i] and self.left[i]:
                self.left[i] -= min(elapsed, self.left[i])
                if not self.left[i]:
                    self._off(i, TIME)
            if self.power[i] and not self.may(i, self.power[i]):
                exceeded = True
        if self.mask():
            if self._quiet >= self.heartbeat_ms:
                self.trip(SILENCE)
            elif exceeded:
                self.trip(BUDGET)

    def beat(self) -> None:
        """The host lives."""
        self._quiet = 0

    def may(self, channel: int, power: int) -> bool:
        """Whether the budget of a channel (from 0) allows this power [%] at all now."""
        return self.steady[channel] or power <= self.duty_percent or self._spent[channel] < self._most

    def switch(self, channel: int, power: int, ms: int) -> None:
        """Put a channel (from 0) at a part of the full power [%] for so long; 0 ms: until the next command.

        The caller has asked `may`, and steps to the present first.
        """
        if self.tripped != NOTHING or not power:
            self._off(channel, COMMAND)
        else:
            self.power[channel] = power
            self.left[channel] = ms

    def all_off(self) -> None:
        """Everything off, as the host commanded."""
        for i in range(self.channels):
            self._off(i, COMMAND)

    def trip(self, why: str) -> None:
        """Everything off until `acknowledge`."""
        self.tripped = why
        for i in range(self.channels):
            self._off(i, why)

    def acknowledge(self) -> None:
        """The host knows why everything went off. Everything is off after this too."""
        self.all_off()
        self.tripped = NOTHING
        self._quiet = 0

    def due_ms(self) -> int:
        """Time from the last step until something goes off by itself [ms]; -1 where nothing will."""
        due = -1
        for i in range(self.channels):
            if self.power[i]:
                ends = self.heartbeat_ms - self._quiet
                if self.left[i]:
                    ends = min(ends, self.left[i])
                rate = self.power[i] - self.duty_percent
                if rate > 0 and not self.steady[i]:
                    ends = min(ends, -((self._spent[i] - self._most) // rate))
                due = ends if due < 0 else min(due, ends)
        return due

    def _off(self, channel: int, why: str) -> None:
        if self.power[channel]:
            self.why_off[channel] = why
        self.power[channel] = 0
        self.left[channel] = 0
