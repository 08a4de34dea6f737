"""The springs of the virtual rig: heated by the emulated board's contacts, through the cut-off."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_hardware.emulator.board import ContactEvent

STEP = 0.05
"""Time step [s]; the heat model's error is below 0.001 K."""


class ThermalSprings:
    """One spring on each of the given channels, advanced in whole steps from time `start`."""

    def __init__(
        self,
        channels: Sequence[int],
        parameters: Sequence[SpringParameters],
        start: float,
        cutoff_s: float | None = None,
    ):
        """`cutoff_s`: the timer in series with each channel opens after this long [s]."""
        self._column = {channel: i for i, channel in enumerate(channels)}
        self.parameters = list(parameters)
        """Parameters of the spring on each channel."""
        self._start = start
        self._cutoff = np.inf if cutoff_s is None else cutoff_s
        self._closed_at: list[float | None] = [None] * len(channels)
        self._power_since: list[tuple[float, float]] = [(0.0, 0.0)] * len(channels)  # time, power
        self._pulses: list[tuple[int, float, float, float]] = []
        self._broken: set[int] = set()
        self.has_supply = True
        """Whether the heating supply is on."""
        self._lock = threading.Lock()
        self._steps = 0
        self.max_temperature_c = max(p.ambient for p in parameters)
        """Highest true temperature so far [C]."""
        self.state = SpringState(np.array([p.ambient for p in parameters]), np.ones(len(parameters)))

    @property
    def now(self) -> float:
        """The time that the springs have reached on the clock [s]."""
        return self._start + self._steps * STEP

    def on_contact_event(self, event: ContactEvent) -> None:
        """A contact moved; channels that heat nothing are ignored."""
        column = self._column.get(event.channel)
        if column is None:
            return
        with self._lock:
            if (closed_at := self._closed_at[column]) is not None:
                begun, power = self._power_since[column]
                self._pulses.append((column, begun, min(event.t, closed_at + self._cutoff), power))
            if not event.closed:
                self._closed_at[column] = None
            else:
                self._power_since[column] = (event.t, event.power)
                if closed_at is None:  # a new power of a closed contact does not restart the cut-off
                    self._closed_at[column] = event.t

    def current_and_voltage(self, channel: int, t: float) -> tuple[float, float]:
        """Current through a channel [A] and voltage across its spring [V] at `t`, not before `now`.

        A spring's resistance is that of the last step to which the springs were advanced.
        """
        column = self._column[channel]
        with self._lock:
            closed_at = self._closed_at[column]
            spans = [p[1:] for p in self._pulses if p[0] == column]
            if closed_at is not None:
                begun, power = self._power_since[column]
                spans.append((begun, closed_at + self._cutoff, power))
            part = next((power for on, off, power in spans if on <= t < off), 0.0)
            if not self.has_supply or not part:
                return 0.0, 0.0
            spring, xi = self.parameters[column], float(self.state.martensite[column])
            if column in self._broken:
                return 0.0, part * spring.supply_voltage
            current = part * float(spring.current(xi))
            return current, current * float(spring.resistance_at(xi))

    def break_lead(self, channel: int) -> None:
        """From now on no current flows in a channel; it has the supply's voltage."""
        self._broken.add(self._column[channel])

    def scale_resistance(self, channel: int, factor: float) -> None:
        """From now on a spring has another resistance, such as a wrong spring or a hot clamp in series."""
        column = self._column[channel]
        spring = self.parameters[column]
        self.parameters[column] = spring.with_resistance(factor * spring.resistance)

    def advance(self, t: float) -> FloatArray:
        """Advance to the last whole step before `t`; free lengths after each step [m], shape (steps, A)."""
        steps = int(np.floor((t - self._start) / STEP + 1e-6)) - self._steps
        if steps <= 0:
            return np.empty((0, len(self.parameters)))
        with self._lock:  # edges come from the board's thread
            share = self._heating_shares(steps)
        history = heat(share, STEP, self.parameters, self.state)
        self.state = history.final
        self.max_temperature_c = max(self.max_temperature_c, float(history.temperature.max()))
        self._steps += steps
        return history.length

    def _heating_shares(self, steps: int) -> FloatArray:
        """Fraction of each of the next steps for which each spring is heated, shape (steps, A)."""
        begin = self.now + STEP * np.arange(steps)
        open_ends = [
            (i, self._power_since[i][0], closed_at + self._cutoff, self._power_since[i][1])
            for i, closed_at in enumerate(self._closed_at)
            if closed_at is not None
        ]
        self._pulses = [p for p in self._pulses if p[2] > self.now]
        share = np.zeros((steps, len(self.parameters)))
        for column, on, off, power in self._pulses + open_ends:
            overlap = np.minimum(begin + STEP, off) - np.maximum(begin, on)
            share[:, column] += power * np.clip(overlap / STEP, 0.0, 1.0)
        share[:, sorted(self._broken)] = 0.0
        return share if self.has_supply else 0.0 * share
