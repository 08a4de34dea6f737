"""The sections of a rig file: board, channels, supply, springs, fan, cut-off, limits, camera."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator, model_validator

from eldir.core.validation import Section
from eldir.errors import InputError
from eldir.parameters.tolerances import RigTolerances
from eldir_hardware.current_sensor import CHIPS
from eldir_hardware.relay.registration import get_board
from eldir_hardware.rig._board_hints import find_port_problem
from eldir_hardware.rig.addresses import is_camera

_KIT = RigTolerances()
MEASURED_CURRENT = 0.02
"""Relative tolerance of a current that a sensor or a good meter has measured."""
_MIN_RESISTIVITY, _MAX_RESISTIVITY = 0.4e-6, 1.3e-6  # of Nitinol [Ohm m]
# Published: 0.44e-6 (table II of PMC5687518), 0.8e-6 to 1.0e-6 (Dynalloy's sheet F1140).
THERMAL = ("heat_capacity", "latent_heat", "convection_fan", "convection_still")
"""Entries of `springs` that determine the temperature of a spring with a given power."""
Transition = Annotated[float, Field(ge=5, le=120)]


def _require_local_port(port: str) -> str:
    """Refuse ports of other computers: locks and the frames of `eldir rig off` do not reach them."""
    if problem := find_port_problem(port):
        raise ValueError(
            f"{problem}: expected a serial port of this computer, such as /dev/serial/by-path/..."
        )
    return port


LocalPort = Annotated[str, AfterValidator(_require_local_port)]


def calibration_entry(values: Mapping[str, float | None]) -> str:
    """The entry `springs.calibration` for measured thermal constants: their digest and names."""
    measured = {n: float(v) for n in THERMAL if (v := values.get(n)) is not None}
    digest = hashlib.sha256(json.dumps(measured, sort_keys=True).encode()).hexdigest()[:16]
    return " ".join([digest, *measured])


class BoardEntry(Section):
    """The relay board."""

    kind: Annotated[
        str, Field(examples=["feedback", "gd32", "lcus", "modbus", "mosfet", "numato", "sainsmart"])
    ]
    """An installed kind, such as lcus: an entry point of the group `eldir.boards`. It is never detected: the
    same byte switches one board on and another one off."""
    port: LocalPort | None = None
    """Serial port, such as /dev/serial/by-path/...; null on a virtual rig, which has its own."""
    channels: Annotated[int, Field(ge=1)]
    """Number of relay channels of the board."""
    contact_rating_a: Annotated[float, Field(ge=0.1, le=100)]
    """Current that one contact may carry [A]; a rig whose springs may draw more does not arm."""
    retriggerable: bool | None = None
    """For a board that times its pulses: whether a second pulse restarts the timer, or is ignored. Measure it
    with `eldir rig doctor --pulses` and the heat disconnected; without it such a board does not arm."""

    @field_validator("kind")
    @classmethod
    def _installed(cls, kind: str) -> str:
        try:
            get_board(kind)
        except InputError as error:
            raise ValueError(str(error)) from None
        return kind

    @model_validator(mode="after")
    def _large_enough(self) -> BoardEntry:
        most = get_board(self.kind).max_channels
        if self.channels > most:
            raise ValueError(f"a board of kind {self.kind} has at most {most} channels")
        return self


class SupplyEntry(Section):
    """The heating supply."""

    voltage_v: Annotated[float, Field(ge=1, le=60)]
    """Voltage of the heating supply [V]."""
    current_limit_a: Annotated[float, Field(ge=0.05, le=50)] | None = None
    """Current limit of each output [A]; without it the rig does not arm. With the fan and a timer of 6.3 s,
    springs of 0.75 mm wire allow 3.6 A in periods of 30 s."""
    outputs: Literal["each", "shared"] = "each"
    """each: a limited output for every channel; shared: one limited output for all heated springs."""
    max_total_current_a: Annotated[float, Field(ge=0.05, le=500)]
    """Largest current of all outputs together [A]."""
    lead_resistance_ohm: Annotated[float, Field(ge=0, le=5)] = 0.05
    """Resistance of the leads between the supply and one spring, both ways [Ohm]."""


class SpringEntry(Section):
    """The shape-memory springs, as measured at room temperature."""

    resistance_ohm: Annotated[float, Field(gt=0)] | None = None
    """Measured resistance of one spring at room temperature [Ohm]; it must fit the wire (0.4 to 1.3 uOhm m),
    and without it the rig does not arm."""
    resistance_tolerance: Annotated[float, Field(ge=0.01, le=0.5)] = _KIT.resistance
    """Relative tolerance of a spring's resistance; the limits are checked for the worst spring."""
    ambient_c: Annotated[float, Field(gt=-20, lt=45)] = 22.0
    """Expected air temperature [C]; its range is in `tolerances`."""
    wire_diameter_mm: Annotated[float, Field(ge=0.1, le=3)] = 0.75
    """Diameter of the wire [mm]. With the next two it gives the motors' resistance, heat, mass, stiffness and
    buckling load."""
    coil_diameter_mm: Annotated[float, Field(ge=1, le=50)] = 6.5
    """Mean diameter of the coil [mm]; 3 to 20 times the diameter of the wire."""
    turns: Annotated[float, Field(ge=2, le=300)] = 26.7
    """Number of active turns of the coil."""
    cold_length_mm: Annotated[float, Field(ge=3, le=500)] = 35.0
    """Free length of the cold motor, from mass to mass [mm]."""
    hot_length_mm: Annotated[float, Field(ge=3, le=500)] = 75.0
    """Free length of the hot motor, from mass to mass [mm]."""
    convection_fan: Annotated[float, Field(ge=10, le=600)] | None = None
    """Measured heat transfer coefficient with the fan [W/(m2 K)]. Without it 150 for a wire of 0.75 mm, and
    for another one that in the same stream of air."""
    convection_still: Annotated[float, Field(ge=2, le=100)] | None = None
    """Measured heat transfer coefficient in still air [W/(m2 K)]. Without it predictions use the correlation
    for a straight wire, and limits the least that a coil can lose (`eldir.parameters.springs`)."""
    heat_capacity: Annotated[float, Field(ge=300, le=1000)] = 466.0
    """Specific heat capacity [J/(kg K)]."""
    latent_heat: Annotated[float, Field(ge=0, le=40_000)] = 12_200.0
    """Latent heat of the transformation [J/kg]."""
    austenite_start_c: Transition = 45.0
    """Temperature at which austenite begins to form in heating [C]."""
    austenite_finish_c: Transition = 60.0
    """Temperature at which the transformation to austenite ends in heating [C]."""
    martensite_start_c: Transition = 45.0
    """Temperature at which martensite begins to form in cooling [C]."""
    martensite_finish_c: Transition = 30.0
    """Temperature at which the transformation to martensite ends in cooling [C]."""
    calibration: str | None = None
    """Names of the thermal constants that `eldir calibrate springs` measured, after a digest of their values,
    which it writes. The limits use other or edited values only if they are worse than the defaults."""

    @property
    def calibrated(self) -> frozenset[str]:
        """Names of the thermal constants whose values a calibration wrote."""
        named = (self.calibration or "").split()[1:]
        values = {name: getattr(self, name) for name in THERMAL if name in named}
        return frozenset(values if self.calibration == calibration_entry(values) else ())

    @model_validator(mode="after")
    def _plausible(self) -> SpringEntry:
        for low, high in (
            ("austenite_start_c", "austenite_finish_c"),
            ("martensite_finish_c", "martensite_start_c"),
            ("martensite_finish_c", "austenite_finish_c"),
            ("cold_length_mm", "hot_length_mm"),
        ):
            if getattr(self, low) >= getattr(self, high):
                raise ValueError(f"{low} must be less than {high}")
        index = self.coil_diameter_mm / self.wire_diameter_mm
        if not 3 <= index <= 20:
            raise ValueError(
                f"implausible spring: coil_diameter_mm is {index:.3g} times wire_diameter_mm, "
                "expected 3 to 20"
            )
        if self.resistance_ohm is not None:
            section = np.pi / 4 * (1e-3 * self.wire_diameter_mm) ** 2
            length = np.pi * 1e-3 * self.coil_diameter_mm * self.turns
            least, most = (r * length / section for r in (_MIN_RESISTIVITY, _MAX_RESISTIVITY))
            if not least <= self.resistance_ohm <= most:
                raise ValueError(
                    f"resistance_ohm {self.resistance_ohm:g} does not fit {length:.3g} m of wire of "
                    f"{self.wire_diameter_mm:g} mm: Nitinol gives {least:.3g} to {most:.3g} Ohm"
                )
        return self


class ToleranceEntry(Section):
    """Tolerances of the bench around the measured values in this file."""

    current: Annotated[float, Field(ge=0.01, le=0.5)] = _KIT.current
    """Relative tolerance of the current through a spring; 0.02 and less say that it was measured."""
    ambient_min_c: Annotated[float, Field(ge=-20, le=45)] = _KIT.ambient_min
    """Lowest temperature of the air [C]."""
    ambient_max_c: Annotated[float, Field(ge=-20, le=60)] = _KIT.ambient_max
    """Highest temperature of the air [C]."""
    convection_tolerance: Annotated[float, Field(ge=0.02, le=0.9)] = _KIT.convection
    """Relative tolerance of a measured heat transfer coefficient; 0.1 is a fifth of the air's speed."""

    @property
    def current_is_measured(self) -> bool:
        """Whether `supply.current_limit_a` is what a sensor or a good meter shows."""
        return self.current <= MEASURED_CURRENT

    @property
    def measured_fields(self) -> tuple[str, ...]:
        """Fields of `SpringParameters` that were measured on the bench."""
        return ("current_limit",) if self.current_is_measured else ()


class FanEntry(Section):
    """The fan that cools the springs."""

    interlocked: bool
    """Whether hardware cuts the heating supply when the fan stops; if not, limits assume still air."""
    channel: Annotated[int, Field(ge=1)] | None = None
    """Relay channel that runs the fan, if any; nothing is heated while its contact is open."""


class TimerEntry(Section):
    """A timer relay in series with each channel, not driven by this computer."""

    kind: Literal["timer"]
    """A timer relay."""
    max_on_s: Annotated[float, Field(ge=0.1, le=600)]
    """Longest time after which it opens a closed channel, its tolerance included [s]; it then stays open
    until the contact opens."""


class ThermalEntry(Section):
    """A thermal switch on each spring, in series with it."""

    kind: Literal["thermal"]
    """A thermal switch."""
    opens_at_c: Annotated[float, Field(ge=30, le=150)]
    """Highest temperature at which it opens, its tolerance included [C]."""


class ContactorEntry(Section):
    """A contactor in series with the whole heating supply: closed only while some spring heats. The board
    must time and restart its pulses, and not be a `mosfet`, which fails closed."""

    kind: Literal["contactor"]
    """A contactor."""
    channel: Annotated[int, Field(ge=1)]
    """Relay channel that drives the contactor."""


CutoffEntry = Annotated[TimerEntry | ThermalEntry | ContactorEntry, Field(discriminator="kind")]


class SensorEntry(Section):
    """Chips that measure the current through each spring and the voltage across it."""

    kind: Annotated[str, Field(examples=sorted(CHIPS))]
    """Kind of the measuring chips: ina226 (one input each, up to 16 chips) or ina3221 (three inputs each, up
    to 4 chips)."""
    port: LocalPort | None = None
    """Serial port of their microcontroller, such as /dev/serial/by-path/..., not that of the relay board; a
    virtual rig has its own."""
    channels: Annotated[tuple[int, ...], Field(min_length=1)] | None = None
    """Relay channel that each input measures, in the order of the inputs; default: all that heat springs, in
    the rig file's order."""
    shunt_ohm: Annotated[float, Field(ge=1e-4, le=1)] = 0.01
    """Resistance of each shunt [Ohm]."""
    shunt_tolerance: Annotated[float, Field(ge=0, le=0.05)] = 0.01
    """Relative tolerance of a shunt's resistance."""
    lead_ohm: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Resistance of the leads, both ways, between the point where the voltage is measured and the spring
    [Ohm]."""
    resistance_tolerance: Annotated[float, Field(gt=0, le=0.5)] = 0.2
    """Relative tolerance of a measured resistance around `springs.resistance_ohm`: springs, their phase and
    temperature, their clamps. Beyond it the rig stops."""

    @field_validator("kind")
    @classmethod
    def _known(cls, kind: str) -> str:
        if kind not in CHIPS:
            raise ValueError(f"unknown chips {kind!r}: expected one of {', '.join(sorted(CHIPS))}")
        return kind


class ThermometerEntry(Section):
    """A thermometer in the air around the springs, read before each run."""

    kind: Literal["w1"]
    """A DS18B20 on the 1-wire bus of this computer."""
    path: Annotated[str, Field(pattern="^/")] | None = None
    """Its file, such as /sys/bus/w1/devices/28-.../temperature, in thousandths of a degree; a virtual rig has
    its own thermometer."""


class LimitEntry(Section):
    """Limits that no schedule may exceed."""

    max_temperature_c: Annotated[float, Field(gt=60, le=90)] = 90.0
    """Highest temperature that a spring may reach in the worst corner of the tolerances [C]."""
    max_on_s: Annotated[float, Field(ge=0.05, le=600)] = 6.0
    """Longest time for which a channel may be closed [s]."""
    min_off_s: Annotated[float, Field(ge=0.05, le=600)] = 8.0
    """Shortest time for which a channel stays open between two pulses [s]."""
    duty: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Largest part of any minute for which a channel may be closed."""


class AnyCameraEntry(Section):
    """Size and calibration files of a camera, relative to the rig file; each log keeps a copy of them."""

    width: Annotated[int, Field(ge=64, le=4096)] = 640
    """Width of the picture [px]."""
    height: Annotated[int, Field(ge=48, le=4096)] = 480
    """Height of the picture [px]."""
    lens: str | None = None
    """Lens file, from `eldir calibrate camera`, relative to the rig file."""
    plane: str | None = None
    """Plane file, from `eldir calibrate plane`, relative to the rig file."""


class VirtualCameraEntry(AnyCameraEntry):
    """The camera of a virtual rig."""

    kind: Literal["virtual"]
    """A camera that the program draws."""
    rate_hz: Annotated[float, Field(gt=0, le=120)] = 10.0
    """Frames per second [Hz]."""


class LiveCameraEntry(AnyCameraEntry):
    """The camera that films a real robot while it is driven."""

    kind: Literal["live"]
    """A real camera."""
    device: str
    """Camera: camera:0, /dev/video0, or a stream, http://phone:8080/video."""
    rate_hz: Annotated[float, Field(gt=0, le=240)] = 30.0
    """Frame rate to request from a device [Hz]; a stream sets its own."""
    tags: str | None = None
    """File with the positions of the reference tags (eldir-tags/1); required without a plane file."""

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
    """Deviations of the virtual rig from the nominal robot, its physics and its clock."""

    seed: Annotated[int, Field(ge=0)] = 1
    """Random seed of the deviations of springs, body and camera."""
    parameter_spread: Literal["small", "large"] = "small"
    """Deviation of the robot's parameters from nominal. small: a few per cent; large: 10 to 50 %, to test
    `eldir calibrate dynamics`. A current that was measured (`tolerances.current`) keeps its tolerance."""
    physics: Literal["eldir", "mujoco"] = "eldir"
    """The program that moves the robot: eldir's printed scene, or MuJoCo, which models hubs, sockets and
    contact between parts (`pip install 'eldir[mujoco]'`)."""
    dimensions: Literal[2, 3] = 2
    """2: the robot moves in its plane, by the mean of both faces; 3, in MuJoCo alone: each face has its own
    strips, feet and coils, and the robot may turn, lean and fall over sideways, in three times the time."""
    clock: Literal["virtual", "wall"] = "virtual"
    """virtual: as fast as possible; wall: in real time."""
    design: str | None = None
    """Design file of the robot on it, relative to the rig file."""

    @model_validator(mode="after")
    def _simulated_in_space(self) -> VirtualEntry:
        if self.dimensions == 3 and self.physics != "mujoco":
            raise ValueError("dimensions: 3 needs physics: mujoco")
        return self
