"""The prediction and the provenance in a schedule file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, fields
from typing import Annotated, Any

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

from eldir.core.records import OMITTED, Record, record

_RENAMED = BeforeValidator(lambda given: "filmed" if given == "seen" else given)  # since version 0.1.0
Method = Annotated[str, Field(pattern="^(evolved|search|imitate|filmed)$"), _RENAMED]
Share = Annotated[float, Field(ge=0, le=1)]


@record
class PredictedWalk(Record):
    """Displacement of a gait over sampled robots [body lengths per five cycles]."""

    period_s: Annotated[Annotated[float, Field(gt=0)] | None, OMITTED] = None
    """Period of the gait [s]; the oldest files lack it."""
    phase: tuple[float, ...] = ()
    """When each active spring begins to heat, as a part of the period."""
    duty: tuple[float, ...] = ()
    """How long it heats, as a part of the period."""
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
    """Part of the feet's sliding in which both outer feet bear about the same load
    (`eldir.built.walking.tie_share`); left out if all fall, and in older files."""
    filmed: Annotated[float | None, Field(validation_alias=AliasChoices("filmed", "seen")), OMITTED] = None
    """Displacement of this gait as filmed [body lengths per five cycles]; left out if it was not filmed.
    Version 0.1.0 wrote `seen`."""


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


@record
class SchedulePrediction(Record):
    """Predictions for a schedule; a schedule that was written by hand may have none."""

    peak_c: Annotated[float | None, OMITTED] = None
    """Highest temperature of springs in the worst corner of the rig's tolerances [C]."""
    stuck_c: Annotated[float | None, OMITTED] = None
    """Highest temperature with a contact welded shut at the worst moment [C]."""
    margins: Annotated[HeatMargins | None, OMITTED] = None
    """How much further than the rig file's tolerances the bench may go."""
    method: Annotated[Method | None, OMITTED] = None
    """How the gait was found, a key of `displacement`. Version 0.1.0 wrote `seen` for `filmed`."""
    displacement: Annotated[
        dict[Annotated[str, _RENAMED], PredictedWalk], Field(exclude_if=lambda walks: not walks)
    ] = field(default_factory=dict)
    """The predicted walk of each method's gait."""
    cycle: Annotated[PredictedCycle | None, OMITTED] = None
    """Temperature and length of the springs over the last cycle."""
    choice: Annotated[str | None, OMITTED] = None
    """Why a filmed gait was kept or replaced; a sentence."""

    @property
    def walk(self) -> PredictedWalk | None:
        """The walk that is predicted of the schedule's own gait."""
        return None if self.method is None else self.displacement.get(self.method)


@record
class ScheduleDigests(Record):
    """SHA-256 of what a schedule was made for, by `safety.schedule_digests`: hexadecimal digits."""

    schedule: str
    """SHA-256 of this file's content without this entry."""
    design: Annotated[str | None, OMITTED] = None
    """SHA-256 of the design without its provenance; left out for a schedule that was made for no design."""
    scene: Annotated[str | None, OMITTED] = None
    """SHA-256 of the identified scene, if one was used."""
    wiring: Annotated[str | None, OMITTED] = None
    """SHA-256 of the map from channels to springs, as in a packet's manifest; older files lack it."""
    rig: dict[str, str] = field(kw_only=True)
    """The first 16 digits of the SHA-256 of each section of the rig file that matters for heat."""


@record
class ScheduleProvenance(Record):
    """Where a schedule comes from; other entries are allowed."""

    eldir: Annotated[str | None, OMITTED] = None
    """Version of the program."""
    seed: Annotated[int | None, OMITTED] = None
    """Random seed of the sampled robots."""
    rig: Annotated[str | None, OMITTED] = None
    """Name of the rig that it was compiled for."""
    design: Annotated[str | None, OMITTED] = None
    """Path from the schedule to the design; by it a virtual rig knows which robot to move."""
    hold: Annotated[float | None, OMITTED] = None
    """Of a schedule that holds springs warm: the part of the full power."""
    notes: dict[str, Any] = field(default_factory=dict)
    """Other entries of the file, kept as they are."""
    digests: Annotated[ScheduleDigests | None, OMITTED] = None
    """What the schedule was made for; without them it is played only with a reason."""

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
