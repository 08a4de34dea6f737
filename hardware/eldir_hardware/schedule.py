"""Heating schedules: when which relay channel closes and opens. JSON "eldir-schedule/1"."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import field, fields
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import (
    AliasChoices,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from eldir.core.records import OMITTED, BoolArray, FileRecord, Record, record
from eldir.parameters.wiring import HeatedFaces

_RENAMED = BeforeValidator(lambda given: "filmed" if given == "seen" else given)  # since version 0.1.0
Method = Annotated[str, Field(pattern="^(evolved|search|imitate|filmed)$"), _RENAMED]
Share = Annotated[float, Field(ge=0, le=1)]
MIN_PERIOD, MAX_PERIOD = 0.1, 120.0
"""Bounds of a period [s]; the time for checking a schedule grows with its period."""
MAX_EVENTS = 256
"""Largest number of switchings of one period: eight pulses on each of sixteen channels."""
_MAX_CHANNELS = 64  # channels and springs
_MIN_INTERVAL = 0.999e-3  # between two switchings of a channel; the compiler writes whole milliseconds [s]


@record
class PredictedWalk(Record):
    """Displacement of a gait over sampled robots [body lengths per five cycles]."""

    period_s: Annotated[Annotated[float, Field(gt=0)] | None, OMITTED] = None
    """Period of the gait [s]; missing in the oldest files."""
    phase: tuple[float, ...] = ()
    """Start of the heating of each active spring, as a fraction of the period."""
    duty: tuple[float, ...] = ()
    """Duration of the heating, as a fraction of the period."""
    samples: Annotated[int, Field(ge=0, validation_alias=AliasChoices("samples", "builds"))] = 0
    """Number of sampled robots. Version 0.1.0 wrote `builds`."""
    fell: Annotated[int, Field(ge=0)] = 0
    """Number of robots that fall over or fold until parts touch."""
    mean: float | None = None
    """Mean displacement of the robots that stand [body lengths per five cycles]; null if all fall."""
    spread: float | None = None
    """Standard deviation of the robots that stand [body lengths per five cycles]; null if all fall."""
    probability_forward: Share = 0.0
    """Share of all sampled robots that stay upright and go forward."""
    tie_share: Annotated[Share | None, OMITTED] = None
    """Fraction of the feet's sliding in which both outer feet bear about the same load
    (`eldir.built.walking.tie_share`); left out if all fall, and in older files."""
    filmed: Annotated[float | None, Field(validation_alias=AliasChoices("filmed", "seen")), OMITTED] = None
    """Displacement of this gait as filmed [body lengths per five cycles]; left out if it was not filmed.
    Version 0.1.0 wrote `seen`."""

    @property
    def expected(self) -> float | None:
        """Mean of all sampled robots, a fall counted as no motion; None if all fall."""
        return None if self.mean is None else self.mean * (1.0 - self.fell / max(self.samples, 1))

    @property
    def spread_with_falls(self) -> float:
        """Standard deviation of all sampled robots, a fall counted as no motion."""
        n, k, mean = self.samples, self.samples - self.fell, self.mean or 0.0
        if n < 2:
            return self.spread or 0.0
        squares = max(k - 1, 0) * (self.spread or 0.0) ** 2 + k * mean**2
        return float(max(squares - k**2 * mean**2 / n, 0.0) / (n - 1)) ** 0.5


@record
class PredictedCycle(Record):
    """The nominal spring on each channel over the last cycle."""

    t_s: tuple[float, ...]
    """Times since the start of the cycle [s]."""
    channels: tuple[int, ...]
    """Relay channels, in the order of the rows below."""
    temperature_c: tuple[tuple[float, ...], ...]
    """Temperature of each channel's spring at each time [C]."""
    length_mm: tuple[tuple[float, ...], ...]
    """Free length of each channel's spring at each time [mm]."""

    def __post_init__(self) -> None:
        if any(len(row) != len(self.t_s) for row in (*self.temperature_c, *self.length_mm)):
            raise ValueError(f"expected rows of {len(self.t_s)} values, as many as t_s has")


@record
class HeatMargins(Record):
    """Margins beyond the rig file's tolerances until a spring reaches the highest allowed temperature."""

    current_a: float
    """Additional current through each spring [A]."""
    ambient_c: float
    """Additional temperature of the air [K]."""
    longer_s: float
    """Extension of every pulse [s]."""
    coldest_c: float
    """Peak temperature of springs in the coldest corner of the tolerances [C]."""
    coldest_stroke: float
    """Fraction of their stroke that springs use in that corner."""


Walk = Annotated[float, Field(allow_inf_nan=False)] | None


@record
class ToleranceWalks(Record):
    """Walks of the most probable robot where current, cooling or air are at an end of the rig's tolerances,
    the same for all springs [body lengths per five cycles]; null where it falls over or folds."""

    nominal: Walk
    """With the values of the rig file."""
    current: tuple[Walk, Walk]
    """With the least and the largest current."""
    convection: tuple[Walk, Walk]
    """In the weakest and the strongest stream of air."""
    room: tuple[Walk, Walk]
    """In the coldest and the warmest room."""
    coldest: Walk
    """With the least current in the strongest stream of air and the coldest room."""


@record
class NarrowerTolerances(Record):
    """What narrower tolerances of the rig file would allow, if measurements prove them."""

    current: float
    """Relative tolerance of the current."""
    ambient_min_c: float
    """Least temperature of the air around the springs [C]."""
    ambient_max_c: float
    """Highest temperature of the air around the springs [C]."""
    current_limit_a: float
    """Highest current limit of the supply with which this schedule keeps the limits [A]."""
    coldest_stroke: float
    """Fraction of their stroke that springs use at that current in the coldest corner."""
    coldest: Walk
    """Walk of the most probable robot there [body lengths per five cycles]; null where it falls or folds."""


@record
class SchedulePrediction(Record):
    """Predictions for a schedule; a schedule that was written by hand may have none."""

    peak_c: Annotated[float | None, OMITTED] = None
    """Highest temperature of springs in the worst corner of the rig's tolerances [C]."""
    stuck_c: Annotated[float | None, OMITTED] = None
    """Highest temperature if a contact welds shut at the worst moment [C]."""
    margins: Annotated[HeatMargins | None, OMITTED] = None
    """Margins beyond the rig file's tolerances."""
    method: Annotated[Method | None, OMITTED] = None
    """How the gait was found, a key of `displacement`. Version 0.1.0 wrote `seen` for `filmed`."""
    displacement: Annotated[
        dict[Annotated[str, _RENAMED], PredictedWalk], Field(exclude_if=lambda walks: not walks)
    ] = field(default_factory=dict)
    """The predicted walk of each method's gait."""
    cycle: Annotated[PredictedCycle | None, OMITTED] = None
    """Temperature and length of the springs over the last cycle."""
    tolerances: Annotated[ToleranceWalks | None, OMITTED] = None
    """Walks at the ends of the rig's tolerances; left out in older files."""
    narrower: Annotated[tuple[NarrowerTolerances, ...] | None, OMITTED] = None
    """What narrower tolerances would allow; left out in older files."""
    choice: Annotated[str | None, OMITTED] = None
    """Why a filmed gait was kept or replaced; a sentence."""

    @property
    def walk(self) -> PredictedWalk | None:
        """The predicted walk of the schedule's own gait."""
        return None if self.method is None else self.displacement.get(self.method)


@record
class ScheduleDigests(Record):
    """SHA-256 of the design, rig and scene of a schedule, in hexadecimal digits."""

    schedule: str
    """SHA-256 of this file's content without this entry."""
    design: Annotated[str | None, OMITTED] = None
    """SHA-256 of the design without its provenance; left out for a schedule without a design."""
    scene: Annotated[str | None, OMITTED] = None
    """SHA-256 of the identified scene, if one was used."""
    wiring: Annotated[str | None, OMITTED] = None
    """SHA-256 of the map from channels to springs, as in a packet's manifest; missing in older files."""
    rig: dict[str, str] = field(kw_only=True)
    """The first 16 digits of the SHA-256 of each section of the rig file that affects heat."""


@record
class ScheduleProvenance(Record):
    """Origin of a schedule; other entries are allowed."""

    eldir: Annotated[str | None, OMITTED] = None
    """Version of the program."""
    seed: Annotated[int | None, OMITTED] = None
    """Random seed of the sampled robots."""
    rig: Annotated[str | None, OMITTED] = None
    """Name of the rig that it was compiled for."""
    design: Annotated[str | None, OMITTED] = None
    """Path from the schedule to the design, whose robot a virtual rig moves."""
    hold: Annotated[float | None, OMITTED] = None
    """Mean power of a schedule that holds springs warm, as a fraction of the full power."""
    notes: dict[str, Any] = field(default_factory=dict)
    """Other entries of the file, kept as they are."""
    digests: Annotated[ScheduleDigests | None, OMITTED] = None
    """Digests of design, rig and scene; without them the schedule is played only with a reason."""

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, values: Any) -> Any:
        """Plain values with the other entries in `notes`; arguments of the constructor as they are."""
        if not isinstance(values, dict):
            return values
        own = {f.name for f in fields(cls)} - {"notes"}  # type: ignore[arg-type]
        notes = {name: value for name, value in values.items() if name not in own}
        return {name: value for name, value in values.items() if name in own} | {"notes": notes}

    @model_serializer(mode="wrap")
    def _spread(self, handler: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
        values = handler(self)
        digests = {"digests": values.pop("digests")} if "digests" in values else {}
        return values | values.pop("notes") | digests

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        schema = super().__get_pydantic_json_schema__(core, handler)
        resolved = handler.resolve_ref_schema(schema)
        del resolved["properties"]["notes"]
        resolved["additionalProperties"] = True
        return schema


@record
class Event(Record):
    """A switching of one channel in every period."""

    t_s: Annotated[float, Field(ge=0)]
    """Time since the start of the period [s]."""
    spring: Annotated[int, Field(ge=0, lt=_MAX_CHANNELS)]
    """Number of the active spring, in the design's spring order, from 0."""
    face: HeatedFaces
    """Face of the robot on which the spring is; `both`: the springs of both faces, in series."""
    channel: Annotated[int, Field(ge=1, le=_MAX_CHANNELS)]
    """Number of the relay channel, from 1."""
    on: bool
    """true: the contact closes and the spring is heated; false: it opens."""


class Pulse(NamedTuple):
    """A heating pulse of a channel; it may extend over the end of the period."""

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

    period_s: Annotated[float, Field(ge=MIN_PERIOD, le=MAX_PERIOD)]
    """Period of the schedule [s]."""
    cycles: Annotated[int, Field(ge=1, le=100_000)] = 5
    """Number of cycles that count."""
    conditioning_cycles: Annotated[int, Field(ge=0, le=100)] = 1
    """Number of cycles before those that count, until temperatures repeat."""
    settle_s: Annotated[float, Field(ge=0, le=600)] = 3.0
    """Rest before the first cycle [s]."""
    springs: tuple[Annotated[int, Field(ge=0)], ...] = ()
    """Index in the design's springs of each active spring."""
    events: Annotated[tuple[Event, ...], Field(max_length=MAX_EVENTS)] = field(kw_only=True)
    """Switchings of one period, in order of time; all channels are open at the start of the first period."""
    predicted: SchedulePrediction = field(default_factory=SchedulePrediction)
    """Predictions of the models; empty for a schedule that was written by hand."""
    provenance: ScheduleProvenance = field(default_factory=ScheduleProvenance)
    """Origin of the schedule."""

    def __post_init__(self) -> None:
        if list(self.events) != sorted(self.events):
            raise ValueError("events: expected in the order of time")
        if any(event.t_s >= self.period_s for event in self.events):
            raise ValueError(f"events.t_s: expected a time within the period of {self.period_s:g} s")
        for channel in self.channels:
            own = [e for e in self.events if e.channel == channel]
            in_turn = all(a.on != b.on and b.t_s - a.t_s > _MIN_INTERVAL for a, b in pairwise(own))
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
