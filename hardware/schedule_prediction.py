"""The prediction and the provenance in a schedule file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from eldir.errors import InputError

_FORMER = {"builds": "samples", "seen": "filmed"}
"""Names in files of version 0.1.0, and what they are called now."""


@dataclass(frozen=True)
class PredictedWalk:
    """Displacement of a gait over sampled robots [body lengths per five cycles]."""

    period_s: float | None = None
    """Period of the gait [s]; the oldest files lack it."""
    phase: tuple[float, ...] = ()
    """When each active spring begins to heat, as a part of the period."""
    duty: tuple[float, ...] = ()
    """How long it heats, as a part of the period."""
    samples: int = 0
    """Number of sampled robots."""
    fell: int = 0
    """Robots that fall over or fold until parts touch."""
    mean: float | None = None
    """Mean displacement of the robots that stand; None if all fall."""
    spread: float | None = None
    """Standard deviation of the robots that stand; None where all fall."""
    probability_forward: float = 0.0
    """Part of all robots that go forward."""
    tie_share: float | None = None
    """Part of the feet's sliding in which both outer feet bear about the same load
    (`eldir.built.validity.ties`); None where all fall, and in older files."""
    filmed: float | None = None
    """Filmed displacement with this gait; None if it was not filmed."""

    def __post_init__(self) -> None:
        numbers = (self.period_s, self.samples, self.fell, self.mean, self.spread, self.probability_forward)
        _require_numbers("a predicted walk", (*numbers, self.tie_share, self.filmed, *self.phase, *self.duty))

    def to_json(self) -> dict[str, Any]:
        """Plain values; what the oldest files lack, or was not filmed, is left out."""
        values = asdict(self) | {"phase": list(self.phase), "duty": list(self.duty)}
        return {k: v for k, v in values.items() if v is not None or k in ("mean", "spread")}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> PredictedWalk:
        """Build the object from the values of `to_json`, or the same entries by their former names."""
        new = _renamed(values)
        known: dict[str, Any] = {f.name: new[f.name] for f in fields(cls) if f.name in new}
        return cls(**known | {name: tuple(new.get(name, ())) for name in ("phase", "duty")})


@dataclass(frozen=True)
class PredictedCycle:
    """The nominal spring on each channel over the last cycle."""

    t_s: tuple[float, ...]
    """Times since the start of the cycle [s], shape (T,)."""
    channels: tuple[int, ...]
    """Relay channels, shape (C,)."""
    temperature_c: tuple[tuple[float, ...], ...]
    """Temperature of each spring [C], shape (C, T)."""
    length_mm: tuple[tuple[float, ...], ...]
    """Free length [mm], shape (C, T)."""

    def __post_init__(self) -> None:
        rows = [*self.temperature_c, *self.length_mm]
        _require_numbers("the predicted cycle", (*self.t_s, *self.channels, *(x for r in rows for x in r)))
        if any(len(row) != len(self.t_s) for row in rows):
            raise InputError("the predicted cycle is wrong", expected=f"rows of {len(self.t_s)} values")

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "t_s": list(self.t_s),
            "channels": list(self.channels),
            "temperature_c": [list(row) for row in self.temperature_c],
            "length_mm": [list(row) for row in self.length_mm],
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> PredictedCycle:
        """Build the object from the values of `to_json`."""
        return cls(
            tuple(values["t_s"]),
            tuple(values["channels"]),
            tuple(tuple(row) for row in values["temperature_c"]),
            tuple(tuple(row) for row in values["length_mm"]),
        )


@dataclass(frozen=True)
class HeatMargins:
    """How much further than the rig file's tolerances the bench may go until a spring reaches the ceiling."""

    current_a: float
    """More current through each spring [A]."""
    ambient_c: float
    """Hotter air [K]."""
    longer_s: float
    """Longer pulses [s]."""
    coldest_c: float
    """Peak temperature of springs in the coldest corner of the tolerances [C]."""
    coldest_stroke: float
    """Part of their stroke that springs use there."""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> HeatMargins:
        """Build the object from the values of `to_json`."""
        return cls(*(float(values[f.name]) for f in fields(cls)))


@dataclass(frozen=True)
class SchedulePrediction:
    """Predictions for a schedule; a schedule that was written by hand may have none."""

    peak_c: float | None = None
    """Highest temperature of springs in the worst corner of the rig's tolerances [C]."""
    stuck_c: float | None = None
    """Highest temperature with a contact welded shut at the worst moment [C]."""
    method: str | None = None
    """How the gait was found: search, imitate or filmed; a key of `displacement`."""
    displacement: Mapping[str, PredictedWalk] = field(default_factory=dict)
    """The predicted walk of each method's gait."""
    cycle: PredictedCycle | None = None
    choice: str | None = None
    """Why a filmed gait was kept or replaced; a sentence."""
    margins: HeatMargins | None = None

    def __post_init__(self) -> None:
        _require_numbers("the predicted temperature", (self.peak_c, self.stuck_c))

    @property
    def walk(self) -> PredictedWalk | None:
        """The walk that is predicted of the schedule's own gait."""
        return None if self.method is None else self.displacement.get(self.method)

    def to_json(self) -> dict[str, Any]:
        """Plain values of what is there."""
        values = {
            "peak_c": self.peak_c,
            "stuck_c": self.stuck_c,
            "margins": None if self.margins is None else self.margins.to_json(),
            "method": self.method,
            "displacement": {name: walk.to_json() for name, walk in self.displacement.items()} or None,
            "cycle": None if self.cycle is None else self.cycle.to_json(),
            "choice": self.choice,
        }
        return {k: v for k, v in values.items() if v is not None}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> SchedulePrediction:
        """Build the object from the values of `to_json`, or from a file of version 0.1.0.

        Entries that this version does not know are ignored.
        """
        walks = {name: PredictedWalk.from_json(w) for name, w in values.get("displacement", {}).items()}
        cycle, method, margins = (values.get(name) for name in ("cycle", "method", "margins"))
        return cls(
            values.get("peak_c"),
            values.get("stuck_c"),
            _FORMER.get(method, method) if isinstance(method, str) else None,
            _renamed(walks),
            PredictedCycle.from_json(cycle) if cycle else None,
            values.get("choice"),
            HeatMargins.from_json(margins) if margins else None,
        )


@dataclass(frozen=True)
class ScheduleDigests:
    """What a schedule was made for, as `hardware.safety.schedule_digests` computes it: hexadecimal digits."""

    schedule: str
    """Of the schedule itself."""
    rig: Mapping[str, str]
    """Of each section of the rig file that matters for heat."""
    design: str | None = None
    """Of the design's content; None for a schedule that was made for no design."""
    scene: str | None = None
    """Of the identified scene, if one was used."""
    wiring: str | None = None
    """Of the map from channels to springs, as in a packet's manifest; None in older files."""

    def to_json(self) -> dict[str, Any]:
        """Plain values of what is there."""
        values = {
            "schedule": self.schedule,
            "design": self.design,
            "scene": self.scene,
            "wiring": self.wiring,
            "rig": dict(self.rig),
        }
        return {k: v for k, v in values.items() if v is not None}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> ScheduleDigests:
        """Build the object from the values of `to_json`."""
        return cls(
            str(values["schedule"]),
            {str(name): str(digest) for name, digest in values["rig"].items()},
            values.get("design"),
            values.get("scene"),
            values.get("wiring"),
        )


@dataclass(frozen=True)
class ScheduleProvenance:
    """Where a schedule comes from."""

    eldir: str | None = None
    """Version of the program."""
    seed: int | None = None
    rig: str | None = None
    """Name of the rig that it was compiled for."""
    design: str | None = None
    """Path from the schedule to the design; by it a virtual rig knows which robot to move."""
    digests: ScheduleDigests | None = None
    """What the schedule was made for; without them it is played only with a reason."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Other entries of the file, kept as they are."""

    def to_json(self) -> dict[str, Any]:
        """Plain values of what is there."""
        own = {name: getattr(self, name) for name in _OWN}
        digests = {} if self.digests is None else {"digests": self.digests.to_json()}
        return {k: v for k, v in own.items() if v is not None} | dict(self.notes) | digests

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> ScheduleProvenance:
        """Build the object from the values of `to_json`."""
        own = {name: values.get(name) for name in _OWN}
        digests = values.get("digests")
        return cls(
            **own,
            digests=None if digests is None else ScheduleDigests.from_json(digests),
            notes={k: v for k, v in values.items() if k not in (*_OWN, "digests")},
        )


_OWN = ("eldir", "seed", "rig", "design")


def _require_numbers(what: str, values: Iterable[object]) -> None:
    for value in values:
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise InputError(f"{what} is wrong", expected="a number", found=repr(value)[:40])


def _renamed(values: Mapping[str, Any]) -> dict[str, Any]:
    return {_FORMER.get(name, name): value for name, value in values.items()}
