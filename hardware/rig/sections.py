"""The sections of a rig file: board, channels, supply, springs, fan, cut-off, limits, camera."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AliasChoices, Field, field_validator, model_validator

from eldir.core.yaml_files import Section
from eldir.errors import InputError
from hardware.relay.registration import board_of
from hardware.rig.camera_name import is_camera

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Face = Literal["front", "back"]


class BoardEntry(Section):
    """The relay board. Its kind is never guessed: the same byte switches one board on and another one off."""

    kind: Annotated[str, Field(examples=["feedback", "gd32", "lcus", "modbus", "numato", "sainsmart"])]
    """An installed kind: an entry point of the group `eldir.boards`."""
    port: str | None = None
    """Serial port, such as /dev/serial/by-path/...; a virtual rig has its own."""
    channels: Annotated[int, Field(ge=1)]
    contact_rating_a: Positive
    second_flash: Literal["restarts", "ignored"] | None = None
    """For a board that times its pulses: whether a second pulse restarts the timer or is ignored. Measure it
    with `eldir rig doctor --pulses` and the heat disconnected; without it such a board does not arm."""

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
    """Current limit of each output [A]; without it the rig does not arm."""
    outputs: Literal["each", "shared"] = "each"
    """each: a limited output for every channel; shared: one, whose limit the heated springs share."""
    budget_a: Positive
    """Largest current of all outputs together [A]."""
    lead_resistance_ohm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.05


class SpringEntry(Section):
    """The shape-memory springs, as measured at room temperature."""

    resistance_ohm: Positive | None = None
    """Resistance of one spring; without it the rig does not arm."""
    resistance_tolerance: Annotated[float, Field(ge=0, le=0.5)] = 0.05
    """Springs may deviate by this part; the limits are checked for the worst of them."""
    ambient_c: Annotated[float, Field(gt=-20, lt=45)] = 22.0
    wire_diameter_mm: Positive = 0.75
    coil_diameter_mm: Positive = 6.5
    turns: Positive = 26.7
    cold_length_mm: Positive = 35.0
    hot_length_mm: Positive = 75.0
    convection_fan: Positive = 150.0
    """Heat transfer coefficient with the fan [W/(m2 K)]."""
    convection_still: Positive = 50.0
    """Heat transfer coefficient in still air [W/(m2 K)]."""
    heat_capacity: Positive = 466.0
    """Specific heat capacity [J/(kg K)]."""
    latent_heat: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 12_200.0
    """Latent heat of the transformation [J/kg]."""
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
    """Time after which it opens a closed channel [s]; it then stays open until the contact opens."""


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
    """Limits that no schedule may exceed."""

    ceiling_c: Annotated[float, Field(gt=60, le=90)] = 90.0
    longest_on_s: Positive = 6.0
    least_off_s: Positive = 8.0
    duty: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Largest part of any minute for which a channel is closed."""


class AnyCameraEntry(Section):
    """Size and calibration files of a camera, relative to the rig file; each log keeps a copy of them."""

    width: Annotated[int, Field(ge=64, le=4096)] = 640
    height: Annotated[int, Field(ge=48, le=4096)] = 480
    lens: str | None = None
    """Lens file, from `eldir calibrate camera`."""
    plane: str | None = None
    """Plane file, from `eldir calibrate plane`."""


class VirtualCameraEntry(AnyCameraEntry):
    """The camera of a virtual rig."""

    kind: Literal["virtual"]
    rate_hz: Annotated[float, Field(gt=0, le=120)] = 10.0


class LiveCameraEntry(AnyCameraEntry):
    """The camera that films a real robot while it is driven."""

    kind: Literal["live"]
    device: str
    """Camera: camera:0, /dev/video0, or a stream, http://phone:8080/video."""
    rate_hz: Annotated[float, Field(gt=0, le=240)] = 30.0
    """Frame rate to request from a device; a stream sets its own."""
    tags: str | None = None
    """File with the places of the fixed tags."""

    @model_validator(mode="after")
    def _requires_place(self) -> LiveCameraEntry:
        if not is_camera(self.device):
            raise ValueError(
                f"a camera is camera:0, /dev/video0, http://... or rtsp://..., not {self.device}"
            )
        if self.plane is None and self.tags is None:
            raise ValueError("a live camera needs a plane file or a tag file")
        return self


class VirtualEntry(Section):
    """How the virtual rig deviates from the nominal robot, and how its time runs."""

    seed: Annotated[int, Field(ge=0)] = 1
    deviation: Annotated[
        Literal["near", "far"], Field(validation_alias=AliasChoices("deviation", "specimen"))
    ] = "near"
    """Deviation of the robot's parameters: a few per cent, or 10 to 50 % as a test for the identification.
    Older rig files call it `specimen`."""
    clock: Literal["virtual", "wall"] = "virtual"
    design: str | None = None
    """Design file of the robot on it, relative to the rig file."""
