"""The springs of the virtual rig: heated by the emulated board's contacts, through the cut-off."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from eldir_hardware.emulator.board import ContactEvent
from eldir_hardware.rig.supply import scale_by_shares

STEP = 0.05
"""Time step [s]; the heat model's error is below 0.001 K."""


class ThermalSprings:
    """A spring on each of the given channels, or two in series where a channel is given twice, advanced in
    whole steps from time `start`."""

    def __init__(
        self,
        channels: Sequence[int],
        parameters: Sequence[SpringParameters],
        start: float,
        cutoff_s: float | None = None,
        power_shares: FloatArray | None = None,
    ):
        """`cutoff_s`: the timer in series with each channel opens after this long [s]. `power_shares`: power
        of a spring while n springs heat, relative to its power alone (`eldir_hardware.rig.supply`); by
        default always 1."""
        self._columns: dict[int, list[int]] = {}
        for i, channel in enumerate(channels):
            self._columns.setdefault(channel, []).append(i)
        self.parameters = list(parameters)
        """Parameters of each spring."""
        self._start = start
        self._cutoff = np.inf if cutoff_s is None else cutoff_s
        self._power_shares = np.ones(len(channels) + 1) if power_shares is None else power_shares
        self._closed_at: dict[int, float] = {}
        self._power_since: dict[int, tuple[float, float]] = {}  # time, power
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
        channel = event.channel
        if channel not in self._columns:
            return
        with self._lock:
            if (closed_at := self._closed_at.get(channel)) is not None:
                begun, power = self._power_since[channel]
                self._pulses.append((channel, begun, min(event.t, closed_at + self._cutoff), power))
            if not event.closed:
                self._closed_at.pop(channel, None)
            else:
                self._power_since[channel] = (event.t, event.power)
                # A new power of a closed contact does not restart the cut-off.
                self._closed_at.setdefault(channel, event.t)

    def current_and_voltage(self, channel: int, t: float) -> tuple[float, float]:
        """Current through a channel [A] and voltage across its springs [V] at `t`, not before `now`.

        A spring's resistance is that of the last step to which the springs were advanced.
        """
        with self._lock:
            part = self._power_at(channel, t)
            if not self.has_supply or not part:
                return 0.0, 0.0
            springs = self._springs_with_leads()
            own = [(springs[i], float(self.state.martensite[i])) for i in self._columns[channel]]
            if channel in self._broken:
                return 0.0, part * own[0][0].supply_voltage
            heated = sum(self._power_at(other, t) >= 1.0 for other in self._columns)
            part *= float(np.sqrt(self._power_shares[max(heated, 1)]))
            current = part * min(float(spring.current(xi)) for spring, xi in own)
            return current, current * sum(float(spring.resistance_at(xi)) for spring, xi in own)

    def _power_at(self, channel: int, t: float) -> float:
        """Part of the whole power with which a contact heats at `t`; 0 while it is open."""
        spans = [p[1:] for p in self._pulses if p[0] == channel]
        if (closed_at := self._closed_at.get(channel)) is not None:
            begun, power = self._power_since[channel]
            spans.append((begun, closed_at + self._cutoff, power))
        return next((power for on, off, power in spans if on <= t < off), 0.0)

    def break_lead(self, channel: int) -> None:
        """From now on no current flows in a channel; it has the supply's voltage."""
        self._broken.add(channel)

    def scale_resistance(self, channel: int, factor: float) -> None:
        """From now on a channel's first spring has another resistance, such as a wrong spring or one with a
        hot clamp."""
        column = self._columns[channel][0]
        spring = self.parameters[column]
        self.parameters[column] = spring.with_resistance(factor * spring.resistance)

    def advance(self, t: float) -> FloatArray:
        """Advance to the last whole step before `t`; free lengths after each step [m], shape (steps, A)."""
        steps = int(np.floor((t - self._start) / STEP + 1e-6)) - self._steps
        if steps <= 0:
            return np.empty((0, len(self.parameters)))
        with self._lock:  # contact events come from the board's thread
            share = scale_by_shares(self._heating_shares(steps), self._power_shares)
        history = heat(share, STEP, self._springs_with_leads(), self.state)
        self.state = history.final
        self.max_temperature_c = max(self.max_temperature_c, float(history.temperature.max()))
        self._steps += steps
        return history.length

    def _springs_with_leads(self) -> list[SpringParameters]:
        """Each spring as the supply sees it: the other one in series, cold, is a resistance of its leads. The
        supply holds its current limit through both, so that the phase of the other matters little."""
        found = list(self.parameters)
        for one, other in (pair for pair in self._columns.values() if len(pair) == 2):
            for i, partner in ((one, other), (other, one)):
                lead = self.parameters[i].lead_resistance + self.parameters[partner].resistance
                found[i] = replace(self.parameters[i], lead_resistance=lead)
        return found

    def _heating_shares(self, steps: int) -> FloatArray:
        """Fraction of each of the next steps for which each spring is heated, shape (steps, A)."""
        begin = self.now + STEP * np.arange(steps)
        open_ends = [
            (channel, self._power_since[channel][0], closed_at + self._cutoff, self._power_since[channel][1])
            for channel, closed_at in self._closed_at.items()
        ]
        self._pulses = [p for p in self._pulses if p[2] > self.now]
        share = np.zeros((steps, len(self.parameters)))
        for channel, on, off, power in self._pulses + open_ends:
            overlap = np.minimum(begin + STEP, off) - np.maximum(begin, on)
            heated = power * np.clip(overlap / STEP, 0.0, 1.0)
            if channel not in self._broken:
                share[:, self._columns[channel]] += heated[:, None]
        return share if self.has_supply else 0.0 * share
