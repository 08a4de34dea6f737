"""Heating schedules: when which relay channel closes and opens. JSON "eldir-schedule/1"."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldir.core.files import load_json, write_text
from eldir.core.records import BoolArray
from eldir.errors import InputError
from eldir.parameters.wiring import FACES
from hardware.schedule_prediction import SchedulePrediction, ScheduleProvenance

FORMAT = "eldir-schedule/1"
SHORTEST_PERIOD, LONGEST_PERIOD = 0.1, 120.0
"""Bounds of a period [s]: the time that it takes to check a schedule grows with its period."""
MOST_EVENTS = 256
"""Switchings of one period at most: eight pulses on each of sixteen channels."""
_MOST = 64  # channels and springs
_EDGE = 0.999e-3  # between two switchings of a channel; the compiler writes whole milliseconds [s]


class Event(NamedTuple):
    """One channel closes or opens, in every period."""

    t_s: float
    """Time since the start of the period [s]."""
    spring: int
    """Number of the active spring, in the design's spring order."""
    face: str
    """front | back"""
    channel: int
    """Channel of the relay board, from 1."""
    on: bool


class Pulse(NamedTuple):
    """A channel's heating within a period; it may run over the period's end."""

    channel: int
    start: float
    """Start of the pulse within the period [s]."""
    length: float
    """Duration of the pulse [s]."""


@dataclass(frozen=True)
class ActuationSchedule:
    """One period of switching, repeated."""

    period_s: float
    events: tuple[Event, ...]
    """Switchings in order of time; all channels are open at the start of the first period."""
    cycles: int = 5
    """Number of cycles that count."""
    conditioning_cycles: int = 1
    """Number of cycles before those, until temperatures repeat."""
    settle_s: float = 3.0
    """Rest before the first cycle [s]."""
    springs: tuple[int, ...] = ()
    """Index in the design's springs of each active spring."""
    predicted: SchedulePrediction = field(default_factory=SchedulePrediction)
    """Peak temperature and displacement, by the models."""
    provenance: ScheduleProvenance = field(default_factory=ScheduleProvenance)

    def __post_init__(self) -> None:
        object.__setattr__(self, "events", tuple(Event(*e) for e in self.events))
        object.__setattr__(self, "springs", tuple(self.springs))
        period = f"{SHORTEST_PERIOD:g} to {LONGEST_PERIOD:g} seconds"
        _check("period_s", self.period_s, SHORTEST_PERIOD <= self.period_s <= LONGEST_PERIOD, period)
        _check("events", len(self.events), len(self.events) <= MOST_EVENTS, f"at most {MOST_EVENTS}")
        _check("cycles", self.cycles, 1 <= self.cycles <= 100_000, "1 to 100000")
        _check(
            "conditioning_cycles", self.conditioning_cycles, 0 <= self.conditioning_cycles <= 100, "0 to 100"
        )
        _check("settle_s", self.settle_s, 0 <= self.settle_s <= 600, "0 to 600 seconds")
        _check("events", "not in order of time", list(self.events) == sorted(self.events), "sorted events")
        for event in self.events:
            _check("events.t_s", event.t_s, 0 <= event.t_s < self.period_s, "within the period")
            _check("events.channel", event.channel, 1 <= event.channel <= _MOST, f"1 to {_MOST}")
            _check("events.spring", event.spring, 0 <= event.spring < _MOST, f"0 to {_MOST - 1}")
            _check("events.face", event.face, event.face in FACES, "front or back")
        for channel in self.channels:
            own = [e for e in self.events if e.channel == channel]
            in_turn = all(a.on != b.on and b.t_s - a.t_s > _EDGE for a, b in pairwise(own))
            switchings = [(e.t_s, e.on) for e in own[:8]]
            wanted = "on and off in turn, a millisecond apart at least"
            _check(f"channel {channel}", switchings, len(own) % 2 == 0 and in_turn, wanted)

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

    def save(self, path: Path | str) -> None:
        """Write the schedule as JSON; the same schedule gives the same bytes."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> ActuationSchedule:
        """Read a schedule. Raises `InputError` for a missing, damaged or foreign file."""
        return load_json(path, FORMAT, cls.from_json)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "format": FORMAT,
            "period_s": self.period_s,
            "cycles": self.cycles,
            "conditioning_cycles": self.conditioning_cycles,
            "settle_s": self.settle_s,
            "springs": list(self.springs),
            "events": [e._asdict() for e in self.events],
            "predicted": self.predicted.to_json(),
            "provenance": self.provenance.to_json(),
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> ActuationSchedule:
        """Build a schedule from the values of `to_json`."""
        events = tuple(
            Event(float(e["t_s"]), _whole(e["spring"]), str(e["face"]), _whole(e["channel"]), _truth(e["on"]))
            for e in values["events"]
        )
        return cls(
            float(values["period_s"]),
            events,
            _whole(values["cycles"]),
            _whole(values["conditioning_cycles"]),
            float(values["settle_s"]),
            tuple(_whole(s) for s in values["springs"]),
            SchedulePrediction.from_json(values["predicted"]),
            ScheduleProvenance.from_json(values["provenance"]),
        )


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise InputError("a number is wrong", expected="a whole number", found=repr(value))
    return value


def _truth(value: object) -> bool:
    if not isinstance(value, bool):
        raise InputError("events.on is wrong", expected="true or false", found=repr(value))
    return value


def _check(name: str, found: object, ok: bool, expected: str) -> None:
    if not ok:
        raise InputError(f"the schedule's {name} is wrong", expected=expected, found=repr(found)[:100])
