"""The springs of the virtual rig: heated by the emulated board's contacts, through the cut-off."""

from __future__ import annotations

import threading
from collections.abc import Sequence

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.core.records import FloatArray
from eldir.parameters.springs import SpringParameters
from hardware.emulator.board import Edge

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
        self._parameters = list(parameters)
        self._start = start
        self._cutoff = np.inf if cutoff_s is None else cutoff_s
        self._closed_at: list[float | None] = [None] * len(channels)
        self._pulses: list[tuple[int, float, float]] = []
        self._lock = threading.Lock()
        self._steps = 0
        self.peak = max(p.ambient for p in parameters)
        """Highest true temperature so far [C]."""
        self.state = SpringState(np.array([p.ambient for p in parameters]), np.ones(len(parameters)))

    @property
    def now(self) -> float:
        """The time that the springs have reached on the clock [s]."""
        return self._start + self._steps * STEP

    def on_edge(self, edge: Edge) -> None:
        """A contact moved; channels that heat nothing are ignored."""
        column = self._column.get(edge.channel)
        if column is None:
            return
        with self._lock:
            if edge.closed:
                self._closed_at[column] = edge.t
            elif (since := self._closed_at[column]) is not None:
                self._closed_at[column] = None
                self._pulses.append((column, since, min(edge.t, since + self._cutoff)))

    def advance(self, t: float) -> FloatArray:
        """Advance to the last whole step before `t`; free lengths after each step [m], shape (steps, A)."""
        steps = int(np.floor((t - self._start) / STEP + 1e-6)) - self._steps
        if steps <= 0:
            return np.empty((0, len(self._parameters)))
        with self._lock:  # edges come from the board's thread
            share = self._closed_share(steps)
        history = heat(share, STEP, self._parameters, self.state)
        self.state = history.final
        self.peak = max(self.peak, float(history.temperature.max()))
        self._steps += steps
        return history.length

    def _closed_share(self, steps: int) -> FloatArray:
        """Fraction of each of the next steps for which each spring is heated, shape (steps, A)."""
        begin = self.now + STEP * np.arange(steps)
        open_ends = [
            (i, since, since + self._cutoff) for i, since in enumerate(self._closed_at) if since is not None
        ]
        self._pulses = [p for p in self._pulses if p[2] > self.now]
        share = np.zeros((steps, len(self._parameters)))
        for column, on, off in self._pulses + open_ends:
            overlap = np.minimum(begin + STEP, off) - np.maximum(begin, on)
            share[:, column] += np.clip(overlap / STEP, 0.0, 1.0)
        return share
