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
HYSTERESIS_K = 5.0
"""A thermal switch closes again when its spring is colder by this than where it opened [K]. Bimetal switches
have 5 to 15 K; with the least the springs stay hottest."""


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
        opens_at_c: float | None = None,
    ):
        """`cutoff_s`: the timer in series with each channel opens after this long [s]. `power_shares`: power
        of a spring while n springs heat, relative to its power alone (`eldir_hardware.rig.supply`); by
        default always 1. `opens_at_c`: the thermal switch on each spring, in series with it, opens at this
        temperature [C]."""
        self._columns: dict[int, list[int]] = {}
        for i, channel in enumerate(channels):
            self._columns.setdefault(channel, []).append(i)
        self.parameters = list(parameters)
        """Parameters of each spring."""
        self._start = start
        self._cutoff = np.inf if cutoff_s is None else cutoff_s
        self._power_shares = np.ones(len(channels) + 1) if power_shares is None else power_shares
        self._opens_at = np.inf if opens_at_c is None else opens_at_c
        self._switch_is_open = np.zeros(len(parameters), dtype=bool)
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
            if self._is_interrupted(channel):
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
        lengths: list[FloatArray] = [np.empty((0, len(self.parameters)))]
        while steps > 0:
            with self._lock:  # contact events come from the board's thread
                share = scale_by_shares(self._heating_shares(steps), self._power_shares)
            history = heat(share, STEP, self._springs_with_leads(), self.state)
            done = self._operate_switches(history.temperature)
            temperature = history.temperature[:done]
            self.state = SpringState(temperature[-1], history.martensite[done - 1])
            self.max_temperature_c = max(self.max_temperature_c, float(temperature.max()))
            lengths.append(history.length[:done])
            self._steps += done
            steps -= done
        return np.concatenate(lengths)

    def _operate_switches(self, temperature: FloatArray) -> int:
        """Open and close thermal switches after the first step in which one does, and return the number of
        steps until then, at most all. `temperature` after each step [C], shape (steps, A)."""
        limit = self._opens_at - HYSTERESIS_K * self._switch_is_open
        changes = (temperature >= limit) != self._switch_is_open
        first = np.flatnonzero(changes.any(axis=1))[:1]
        if not len(first):
            return len(temperature)
        self._switch_is_open ^= changes[first[0]]
        return int(first[0]) + 1

    def _is_interrupted(self, channel: int) -> bool:
        """Whether no current can flow in a channel, for a broken lead or an open thermal switch."""
        return channel in self._broken or bool(self._switch_is_open[self._columns[channel]].any())

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
            if not self._is_interrupted(channel):
                share[:, self._columns[channel]] += heated[:, None]
        return share if self.has_supply else 0.0 * share
