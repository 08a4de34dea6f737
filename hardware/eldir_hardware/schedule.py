"""Heating schedules: when which relay channel closes and opens. JSON "eldir-schedule/1"."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import field
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from eldir.core.records import BoolArray, FileRecord, Record, record
from eldir.parameters.wiring import Face
from eldir_hardware.schedule_prediction import SchedulePrediction, ScheduleProvenance

SHORTEST_PERIOD, LONGEST_PERIOD = 0.1, 120.0
"""Bounds of a period [s]: the time that it takes to check a schedule grows with its period."""
MOST_EVENTS = 256
"""Switchings of one period at most: eight pulses on each of sixteen channels."""
_MOST = 64  # channels and springs
_EDGE = 0.999e-3  # between two switchings of a channel; the compiler writes whole milliseconds [s]


@record
class Event(Record):
    """One channel closes or opens, in every period."""

    t_s: Annotated[float, Field(ge=0)]
    """Time since the start of the period [s]."""
    spring: Annotated[int, Field(ge=0, lt=_MOST)]
    """Number of the active spring, in the design's spring order, from 0."""
    face: Face
    """Face of the robot on which the spring is."""
    channel: Annotated[int, Field(ge=1, le=_MOST)]
    """Number of the relay channel, from 1."""
    on: bool
    """true: the contact closes and the spring is heated; false: it opens."""


class Pulse(NamedTuple):
    """A channel's heating within a period; it may run over the period's end."""

    channel: int
    start: float
    """Start of the pulse within the period [s]."""
    length: float
    """Duration of the pulse [s]."""


@record
class ActuationSchedule(FileRecord):
    """One period of switching, repeated. A channel closed over the end of a period opens in the next one."""

    FORMAT = "eldir-schedule/1"
    OPTIONAL = frozenset()

    period_s: Annotated[float, Field(ge=SHORTEST_PERIOD, le=LONGEST_PERIOD)]
    """Period of the schedule [s]."""
    cycles: Annotated[int, Field(ge=1, le=100_000)] = 5
    """Number of cycles that count."""
    conditioning_cycles: Annotated[int, Field(ge=0, le=100)] = 1
    """Number of cycles before those that count, until temperatures repeat."""
    settle_s: Annotated[float, Field(ge=0, le=600)] = 3.0
    """Rest before the first cycle [s]."""
    springs: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Index in the design's springs of each active spring."""
    events: Annotated[tuple[Event, ...], Field(max_length=MOST_EVENTS)] = field(kw_only=True)
    """Switchings of one period, in order of time; all channels are open at the start of the first period."""
    predicted: SchedulePrediction = field(default_factory=SchedulePrediction)
    """Predictions of the models; empty for a schedule that was written by hand."""
    provenance: ScheduleProvenance = field(default_factory=ScheduleProvenance)
    """Origin of the schedule."""

    def __post_init__(self) -> None:
        if list(self.events) != sorted(self.events):
            raise ValueError("the events are not in order of time")
        if any(event.t_s >= self.period_s for event in self.events):
            raise ValueError(f"events.t_s: expected a time within the period of {self.period_s:g} s")
        for channel in self.channels:
            own = [e for e in self.events if e.channel == channel]
            in_turn = all(a.on != b.on and b.t_s - a.t_s > _EDGE for a, b in pairwise(own))
            if len(own) % 2 or not in_turn:
                raise ValueError(
                    f"events of channel {channel}: expected on and off in turn, a millisecond apart, "
                    f"found {[(e.t_s, e.on) for e in own[:8]]}"
                )

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels that switch, ascending."""
        return tuple(sorted({e.channel for e in self.events}))

    @property
    def start_of_cycles(self) -> float:
        """When the first cycle that counts begins [s]."""
        return self.settle_s + self.conditioning_cycles * self.period_s

    @property
    def duration(self) -> float:
        """Duration from the start to the end of the last cycle [s]."""
        return self.start_of_cycles + self.cycles * self.period_s

    def cycle_at(self, t: float) -> int:
        """Number of the cycle at `t` [s since the start]: 0 before the first, and the last after its end."""
        passed = t - self.start_of_cycles
        return 0 if passed < 0 else min(int(passed / self.period_s) + 1, self.cycles)

    def pulses(self) -> list[Pulse]:
        """The heating pulses of one period."""
        found = []
        for channel in self.channels:
            own = [e for e in self.events if e.channel == channel]
            for i, event in enumerate(own):
                if event.on:
                    off = own[(i + 1) % len(own)].t_s
                    found.append(Pulse(channel, event.t_s, (off - event.t_s) % self.period_s))
        return found

    def switchings(self) -> Iterator[tuple[float, dict[int, bool]]]:
        """Each instant at which channels switch [s from the start], with the new states of those channels.

        A channel that is closed over the end of a period opens in the first one without effect.
        """
        instants = sorted({e.t_s for e in self.events})
        for cycle in range(self.conditioning_cycles + self.cycles):
            begin = self.settle_s + cycle * self.period_s
            for t in instants:
                yield begin + t, {e.channel: e.on for e in self.events if e.t_s == t}

    def sampled(self, dt: float) -> tuple[tuple[int, ...], BoolArray]:
        """The channels and their states in each step of the whole run, shape (steps, channels)."""
        times = np.arange(round(self.duration / dt)) * dt
        states = np.zeros((len(times), len(self.channels)), dtype=bool)
        column = {c: i for i, c in enumerate(self.channels)}
        for t, changes in self.switchings():
            for channel, on in changes.items():
                states[times >= t - dt / 2, column[channel]] = on
        return self.channels, states
