"""The rig file: which board, which springs, what they may never do. YAML "eldir-rig/1"."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from eldir.core.yaml_files import Section, read_yaml, validated
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from hardware.relay.registration import board_of
from hardware.rig.camera_name import is_camera

FORMAT = "eldir-rig/1"
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Face = Literal["front", "back"]
_NO_LIMIT = 1e6  # [A]; the wire's resistance limits the current then


class BoardEntry(Section):
    """The relay board. Its kind is never guessed: the same byte means on to one board, off to another."""

    kind: Annotated[str, Field(examples=["feedback", "gd32", "lcus", "modbus", "numato", "sainsmart"])]
    """An installed kind: an entry point of the group `eldir.boards`."""
    port: str | None = None
    """Such as /dev/serial/by-path/...; a virtual rig brings its own."""
    channels: Annotated[int, Field(ge=1)]
    contact_rating_a: Positive
    second_flash: Literal["restarts", "ignored"] | None = None
    """What a board that times its pulses makes of a pulse during a pulse, as `eldir rig doctor --pulses`
    measured it with the heat disconnected; without it such a board does not arm."""

    @field_validator("kind")
    @classmethod
    def _installed(cls, kind: str) -> str:
        try:
            board_of(kind)
        except InputError as error:
            raise ValueError(str(error)) from None
        return kind

    @model_validator(mode="after")
    def _large_enough(self) -> BoardEntry:
        most = board_of(self.kind).most_channels
        if self.channels > most:
            raise ValueError(f"a board of kind {self.kind} has at most {most} channels")
        return self


class ChannelEntry(Section):
    """Which spring a relay channel heats."""

    channel: Annotated[int, Field(ge=1)]
    spring: Annotated[int, Field(ge=0)]
    """Number of the active spring, in the design's spring order, from 0."""
    face: Face


class SupplyEntry(Section):
    """The heating supply."""

    voltage_v: Positive
    current_limit_a: Positive | None = None
    """Of each output; without it the rig does not arm."""
    outputs: Literal["each", "shared"] = "each"
    """each: a limited output for every channel; shared: one, whose limit the heated springs share."""
    budget_a: Positive
    """Of all outputs together."""
    lead_resistance_ohm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.05


class SpringEntry(Section):
    """The shape-memory springs, as measured at room temperature."""

    resistance_ohm: Positive | None = None
    """Of one spring; without it the rig does not arm."""
    resistance_tolerance: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Springs may have this much more; limits are checked for those."""
    ambient_c: Annotated[float, Field(gt=-20, lt=45)] = 22.0
    wire_diameter_mm: Positive = 0.75
    coil_diameter_mm: Positive = 6.5
    turns: Positive = 26.7
    cold_length_mm: Positive = 35.0
    hot_length_mm: Positive = 75.0
    convection_fan: Positive = 150.0
    """[W/(m2 K)]"""
    convection_still: Positive = 50.0
    """[W/(m2 K)]"""
    heat_capacity: Positive = 466.0
    """[J/(kg K)]"""
    latent_heat: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 12_200.0
    """[J/kg]"""
    austenite_start_c: float = 45.0
    austenite_finish_c: float = 60.0
    martensite_start_c: float = 45.0
    martensite_finish_c: float = 30.0


class FanEntry(Section):
    """The fan that cools the springs."""

    interlocked: bool
    """Whether the heating supply is cut by hardware when the fan stands still."""
    channel: Annotated[int, Field(ge=1)] | None = None
    """Relay channel that runs it; nothing is heated while its contact is open."""


class TimerEntry(Section):
    """A timer relay in series with each channel, which the host does not drive."""

    kind: Literal["timer"]
    longest_on_s: Positive
    """Opens when its channel has been closed for so long, and stays so until the contact opens."""


class ThermalEntry(Section):
    """A thermal switch on each spring, in series with it."""

    kind: Literal["thermal"]
    opens_at_c: float
    """Highest temperature at which it opens, its tolerance included."""


class ContactorEntry(Section):
    """A contactor in series with the whole heating supply, driven by a channel of a board that times its
    pulses: closed only while some spring heats."""

    kind: Literal["contactor"]
    channel: Annotated[int, Field(ge=1)]


CutoffEntry = Annotated[TimerEntry | ThermalEntry | ContactorEntry, Field(discriminator="kind")]


class LimitEntry(Section):
    """What no schedule may pass."""

    ceiling_c: Annotated[float, Field(gt=60, le=90)] = 90.0
    longest_on_s: Positive = 6.0
    least_off_s: Positive = 8.0
    duty: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Largest part of any minute for which a channel is closed."""


class _CameraEntry(Section):
    """A camera's pictures and calibration files, relative to the rig file: these are kept with each log."""

    width: Annotated[int, Field(ge=64, le=4096)] = 640
    height: Annotated[int, Field(ge=48, le=4096)] = 480
    lens: str | None = None
    """From `eldir calibrate camera`."""
    plane: str | None = None
    """Of motion, from `eldir calibrate plane`."""


class CameraEntry(_CameraEntry):
    """What watches the virtual robot."""

    kind: Literal["virtual"]
    rate_hz: Annotated[float, Field(gt=0, le=120)] = 10.0


class LiveCameraEntry(_CameraEntry):
    """What watches a real robot while it is driven."""

    kind: Literal["live"]
    device: str
    """camera:0, /dev/video0, or a stream: http://phone:8080/video."""
    rate_hz: Annotated[float, Field(gt=0, le=240)] = 30.0
    """What a device is asked for; a stream has its own."""
    tags: str | None = None
    """Where the fixed tags are."""

    @model_validator(mode="after")
    def _tells_where(self) -> LiveCameraEntry:
        if not is_camera(self.device):
            raise ValueError(
                f"a camera is camera:0, /dev/video0, http://... or rtsp://..., not {self.device}"
            )
        if self.plane is None and self.tags is None:
            raise ValueError("a live camera needs a plane file or a tag file")
        return self


class VirtualEntry(Section):
    """How the virtual rig differs from the nominal robot, and how its time runs."""

    seed: Annotated[int, Field(ge=0)] = 1
    specimen: Literal["near", "far"] = "near"
    """Off by a few per cent, or by 10 to 50: something to identify."""
    clock: Literal["virtual", "wall"] = "virtual"
    design: str | None = None
    """Design file of the robot on it, relative to the rig file."""


class Rig(Section):
    """A rig file."""

    format: Literal["eldir-rig/1"]
    name: str
    kind: Literal["real", "virtual"]
    board: BoardEntry
    channels: Annotated[tuple[ChannelEntry, ...], Field(min_length=1)]
    supply: SupplyEntry
    springs: SpringEntry = SpringEntry()
    fan: FanEntry | None = None
    cutoff: CutoffEntry | None = None
    limits: LimitEntry = LimitEntry()
    camera: Annotated[CameraEntry | LiveCameraEntry, Field(discriminator="kind")] | None = None
    virtual: VirtualEntry = VirtualEntry()

    @model_validator(mode="after")
    def _consistent(self) -> Rig:
        numbers = [c.channel for c in self.channels]
        if len(set(numbers)) != len(numbers):
            raise ValueError("a relay channel is used twice")
        numbers += [c for c in (self.fan_channel, self.master_channel) if c is not None]
        if len(set(numbers)) != len(numbers):
            raise ValueError("the channel of the fan or the contactor heats a spring too")
        if max(numbers) > self.board.channels:
            raise ValueError(f"channel {max(numbers)} is beyond the board's {self.board.channels}")
        places = [(c.spring, c.face) for c in self.channels]
        if len(set(places)) != len(places):
            raise ValueError("two channels heat the same spring of the same face")
        if self.kind == "real" and self.board.port is None:
            raise ValueError("a real board needs its port")
        if self.camera is not None and (self.kind == "real") != (self.camera.kind == "live"):
            raise ValueError(f"a {self.camera.kind} camera does not see a {self.kind} rig")
        return self

    @property
    def fan_channel(self) -> int | None:
        """The relay channel that runs the fan."""
        return self.fan.channel if self.fan else None

    @property
    def master_channel(self) -> int | None:
        """The relay channel of the contactor in series with all others."""
        return self.cutoff.channel if isinstance(self.cutoff, ContactorEntry) else None

    @property
    def cutoff_s(self) -> float | None:
        """After how long a timer relay opens a channel [s]."""
        return self.cutoff.longest_on_s if isinstance(self.cutoff, TimerEntry) else None

    @property
    def motors(self) -> int:
        """Number of active springs that the channels can heat."""
        return 1 + max(c.spring for c in self.channels)

    def channel_of(self, spring: int, face: str) -> int | None:
        """The relay channel that heats a spring on a face."""
        for entry in self.channels:
            if (entry.spring, entry.face) == (spring, face):
                return entry.channel
        return None

    def spring_parameters(self, *, fan: bool | None = None) -> SpringParameters:
        """The nominal springs on this supply. A missing resistance is computed from the wire.

        `fan` says whether it blows; as the rig is equipped where not given.
        """
        s = self.springs
        parameters = SpringParameters(
            wire_diameter=1e-3 * s.wire_diameter_mm,
            coil_diameter=1e-3 * s.coil_diameter_mm,
            turns=s.turns,
            supply_voltage=self.supply.voltage_v,
            current_limit=self.supply.current_limit_a or _NO_LIMIT,
            lead_resistance=self.supply.lead_resistance_ohm,
            convection_fan=s.convection_fan,
            convection_still=s.convection_still,
            fan=self.fan is not None if fan is None else fan,
            ambient=s.ambient_c,
            cold_length=1e-3 * s.cold_length_mm,
            hot_length=1e-3 * s.hot_length_mm,
            heat_capacity=s.heat_capacity,
            latent_heat=s.latent_heat,
            austenite_start=s.austenite_start_c,
            austenite_finish=s.austenite_finish_c,
            martensite_start=s.martensite_start_c,
            martensite_finish=s.martensite_finish_c,
        )
        return parameters if s.resistance_ohm is None else parameters.with_resistance(s.resistance_ohm)

    @classmethod
    def load(cls, path: Path | str) -> Rig:
        """Read a rig file; what is wrong in it is named with its place."""
        path = Path(path)
        values = read_yaml(path, remedy=f"write one: eldir rig new --board virtual --out {path}")
        found = values.get("format") if isinstance(values, dict) else None
        if found != FORMAT:
            raise InputError(f"{path} is not a rig file", expected=f"format: {FORMAT}", found=repr(found))
        return validated(cls, values, str(path), remedy="see docs/reference/rig.md")
