"""The rig file: board, springs and their limits. YAML "eldir-rig/1"."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    SecretStr,
    field_serializer,
    model_validator,
)

from eldir.core.arguments import require_value
from eldir.core.files import read_file
from eldir.core.validation import Section, validate
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import (
    SpringParameters,
    fan_heat_transfer_coefficient,
    wire_heat_transfer_coefficient,
)
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.wiring import FACES, Connection, Wiring
from eldir_hardware.current_sensor import CHIPS
from eldir_hardware.markers.registration import DEFAULT_KIND, require_kind
from eldir_hardware.rig._renamed_keys import require_current_names, with_current_names
from eldir_hardware.rig.addresses import hide_address, hide_addresses, hide_password, validate_addresses
from eldir_hardware.rig.sections import (
    BoardEntry,
    ContactorEntry,
    CutoffEntry,
    FanEntry,
    LimitEntry,
    LiveCameraEntry,
    SensorEntry,
    SpringEntry,
    SupplyEntry,
    ThermalEntry,
    ThermometerEntry,
    TimerEntry,
    ToleranceEntry,
    VirtualCameraEntry,
    VirtualEntry,
)

FORMAT = "eldir-rig/1"
_NO_LIMIT = 1e6  # [A]; the wire's resistance limits the current then
_HEADROOM = 1.25  # currents beyond the limit are measured up to this factor
_MIN_PART = 0.1  # part of the supply's limit that must be distinguished from zero


def _installed_marker(kind: str) -> str:
    try:
        return require_kind(kind)
    except InputError as error:
        raise ValueError(str(error)) from None


class Rig(Section):
    """A rig file."""

    format: Literal["eldir-rig/1"]
    """Format of this file."""
    name: str
    """Name of the rig, which logs and schedules repeat."""
    kind: Literal["real", "virtual"]
    """Whether the rig is physical or simulated."""
    board: BoardEntry
    """The relay board."""
    channels: Annotated[tuple[Connection, ...], Field(min_length=1)]
    """Each relay channel that heats a spring. A new rig file has the wiring of a packet: 1 is motor 0 front,
    2 motor 0 back, 3 motor 1 front, 4 motor 1 back. Another wiring is allowed; `eldir rig doctor --wiring`
    shows which spring grows warm. `face: both`, for all channels or none: the channel heats the springs of
    both faces of a motor in series."""
    supply: SupplyEntry
    """The heating supply."""
    springs: SpringEntry = SpringEntry()
    """The shape-memory springs."""
    tolerances: ToleranceEntry = ToleranceEntry()
    """How far the bench may be from the values in this file, after measuring. Limits are checked where all of
    these and `springs.resistance_tolerance` together give the hottest spring."""
    fan: FanEntry | None = None
    """The fan that cools the springs; null: there is none."""
    cutoff: CutoffEntry | None = None
    """The independent cut-off that opens when a contact welds; null: there is none. It is needed unless a
    spring that is held on for ever stays below `limits.max_temperature_c`."""
    sensor: SensorEntry | None = None
    """The current sensor; null: there is none."""
    thermometer: ThermometerEntry | None = None
    """The thermometer in the air around the springs; null: there is none."""
    limits: LimitEntry = LimitEntry()
    """Limits that no schedule may exceed."""
    camera: Annotated[VirtualCameraEntry | LiveCameraEntry, Field(discriminator="kind")] | None = None
    """The camera that films the robot, virtual or live as the rig is; null: there is none. Each log keeps a
    copy of its calibration files."""
    marker: Annotated[
        str, AfterValidator(_installed_marker), Field(examples=["apriltag", "aruco", "discs"])
    ] = DEFAULT_KIND
    """Kind of the markers on m1 to m5, an entry point of the group `eldir.markers`: coloured discs, ArUco
    squares or AprilTags; print them with `eldir markers`. `eldir track`, the report, the live page, the ROS
    node and the virtual camera use it."""
    virtual: VirtualEntry = VirtualEntry()
    """The simulated robot and its clock."""
    notify: Annotated[tuple[SecretStr, ...], BeforeValidator(validate_addresses)] = ()
    """Addresses in the form of apprise to which a notification is sent when a run ends or its camera is lost;
    at most eight."""
    _source: bytes = PrivateAttr(b"")

    @field_serializer("notify", when_used="json")
    def _hide(self, addresses: tuple[SecretStr, ...]) -> list[str]:
        return [hide_address(address.get_secret_value()) for address in addresses]

    @model_validator(mode="after")
    def _consistent(self) -> Rig:
        numbers = [c.channel for c in self.channels]
        if len(set(numbers)) != len(numbers):
            raise ValueError("channels: a relay channel is listed twice")
        numbers += [c for c in (self.fan_channel, self.master_channel) if c is not None]
        if len(set(numbers)) != len(numbers):
            raise ValueError("the channel of the fan or the contactor also heats a spring")
        if max(numbers) > self.board.channels:
            raise ValueError(
                f"channel {max(numbers)} does not exist: the board has {self.board.channels} channels"
            )
        places = [(c.spring, face) for c in self.channels for face in c.faces]
        if len(set(places)) != len(places):
            raise ValueError("two channels heat the same spring of the same face")
        low, high = self.tolerances.ambient_min_c, self.tolerances.ambient_max_c
        if not low <= self.springs.ambient_c <= high:
            raise ValueError(
                f"springs.ambient_c {self.springs.ambient_c:g} lies outside tolerances, {low:g} to {high:g} C"
            )
        if self.kind == "real" and self.board.port is None:
            raise ValueError("a real board needs its port")
        if self.camera is not None and (self.kind == "real") != (self.camera.kind == "live"):
            raise ValueError(f"a {self.kind} rig cannot have a {self.camera.kind} camera")
        if problem := self.find_series_problem():
            raise ValueError(problem)
        if self.sensor is not None:
            self._require_consistent_sensor(self.sensor)
        if self.virtual.dimensions == 3 and 2 * len({c.spring for c in self.channels}) != len(places):
            raise ValueError(
                "virtual.dimensions: 3 needs a channel for each face of every motor that is heated"
            )
        if self.kind == "real" and self.thermometer is not None and self.thermometer.path is None:
            raise ValueError("a real thermometer needs its file: thermometer.path")
        return self

    def find_series_problem(self) -> str | None:
        """Why springs cannot be wired in series as the file says; None if they can.

        The supply must hold its current limit in both springs when they have their highest resistance: then
        each is heated as if it were alone, and the limits of one spring hold for both.
        """
        if len({len(c.faces) for c in self.channels}) > 1:
            return "channels: some heat both springs of a motor in series, others one spring"
        if self.springs_per_channel == 1:
            return None
        if self.supply.outputs == "shared":
            return (
                "springs in series need supply.outputs: each, an output of limited current for each channel"
            )
        if (limit := self.supply.current_limit_a) is None:
            return None  # the rig does not arm then
        springs = self.spring_parameters()
        highest = float(max(springs.resistance_at(0.0), springs.resistance_at(1.0)))
        highest *= 1 + self.springs.resistance_tolerance
        least = limit * (self.springs_per_channel * highest + self.supply.lead_resistance_ohm)
        if self.supply.voltage_v < least:
            return (
                f"supply.voltage_v is too low for {limit:g} A through two springs in series: "
                f"expected at least {least:.3g} V, found {self.supply.voltage_v:g} V"
            )
        return None

    def _require_consistent_sensor(self, sensor: SensorEntry) -> None:
        heating, measured = [c.channel for c in self.channels], self.measured_channels
        if len(set(measured)) != len(measured) or not set(measured) <= set(heating):
            raise ValueError("sensor.channels: each must be one of the channels that heat springs, once")
        if self.kind == "real" and sensor.port in (None, self.board.port):
            raise ValueError("a real current sensor needs a port of its own: sensor.port")
        if problem := _find_sensor_problem(sensor, self.supply, self.springs):
            raise ValueError(problem)

    @property
    def fan_channel(self) -> int | None:
        """The relay channel that runs the fan."""
        return self.fan.channel if self.fan else None

    @property
    def master_channel(self) -> int | None:
        """The relay channel of the contactor in series with all others."""
        return self.cutoff.channel if isinstance(self.cutoff, ContactorEntry) else None

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the relay channels, as in the log of a run."""
        return tuple(f"channel{i}" for i in range(1, self.board.channels + 1))

    @property
    def spring_names(self) -> tuple[str, ...]:
        """Names of the springs, as in the log of a run."""
        return tuple(f"spring{c.spring}_{c.face}" for c in self.channels)

    @property
    def measured_channels(self) -> tuple[int, ...]:
        """Relay channels whose current is measured, in the order of the sensor's inputs."""
        if self.sensor is None:
            return ()
        return self.sensor.channels or tuple(c.channel for c in self.channels)

    @property
    def cutoff_s(self) -> float | None:
        """After how long a timer relay opens a channel [s]."""
        return self.cutoff.max_on_s if isinstance(self.cutoff, TimerEntry) else None

    @property
    def opens_at_c(self) -> float | None:
        """Temperature at which the thermal switch on a spring opens [C]."""
        return self.cutoff.opens_at_c if isinstance(self.cutoff, ThermalEntry) else None

    @property
    def springs_per_channel(self) -> int:
        """Number of springs that each channel heats: 2 where those of both faces are in series."""
        return len(self.channels[0].faces)

    @property
    def motors(self) -> int:
        """Number of active springs that the channels can heat."""
        return 1 + max(c.spring for c in self.channels)

    def require_port(self) -> str:
        """The port of the relay board. Raises `InputError` where the file names none."""
        if not self.board.port:
            raise InputError("the rig file names no port", code="rig.no-port", remedy="set board.port")
        return self.board.port

    def require_motors(self, motors: int) -> None:
        """Raise `InputError` for a design with more motors than the channels can heat."""
        remedy = "evolve with --max-motors, or add channels to the rig file"
        require_value(
            "number of motors", motors <= self.motors, f"at most {self.motors} on this rig", motors, remedy
        )

    def require_own_outputs(self, remedy: str = "drive and film with eldir rig drive") -> None:
        """Raise `InputError` where springs share the current of one output, for what does not simulate
        that."""
        if self.supply.outputs == "shared":
            raise InputError(
                f"the springs of {self.name} share the current of one output of the supply",
                code="rig.shared-output",
                expected="an output for each spring (supply.outputs: each): shared current is not simulated "
                "here",
                found="supply.outputs: shared",
                remedy=remedy,
            )

    def find_channel(self, spring: int, face: str) -> int | None:
        """The relay channel that heats a spring on a face."""
        for entry in self.channels:
            if (entry.spring, entry.face) == (spring, face):
                return entry.channel
        return None

    def connections_of(self, spring: int) -> Wiring:
        """The channels that heat a spring on both faces. Raises `InputError` if one of them is not heated."""
        found = tuple(c for c in self.channels if c.spring == spring)
        heated = {face for c in found for face in c.faces}
        for face in FACES:
            if face not in heated:
                raise InputError(
                    f"the rig has no channel for spring {spring} of the {face} face",
                    code="rig.no-channel",
                    expected="a channel for each face, or one for both",
                    remedy="add it to the rig file's channels",
                )
        return found

    def spring_tolerances(self) -> RigTolerances:
        """How far the springs may be from `spring_parameters`."""
        t = self.tolerances
        resistance = self.springs.resistance_tolerance
        return RigTolerances(
            t.current, t.convection_tolerance, t.ambient_min_c, t.ambient_max_c, resistance=resistance
        )

    def spring_parameters(self, *, fan: bool | None = None) -> SpringParameters:
        """The nominal springs on this supply. A missing resistance is computed from the wire.

        `fan`: whether it runs; default: whether the rig has one.
        """
        s = self.springs
        parameters = SpringParameters(
            wire_diameter=1e-3 * s.wire_diameter_mm,
            coil_diameter=1e-3 * s.coil_diameter_mm,
            turns=s.turns,
            supply_voltage=self.supply.voltage_v,
            current_limit=self.supply.current_limit_a or _NO_LIMIT,
            lead_resistance=self.supply.lead_resistance_ohm,
            convection_fan=s.convection_fan or fan_heat_transfer_coefficient(1e-3 * s.wire_diameter_mm),
            convection_still=s.convection_still
            or wire_heat_transfer_coefficient(1e-3 * s.wire_diameter_mm, s.austenite_finish_c, s.ambient_c),
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

    def nominal_robot(self) -> RobotParameters:
        """The nominal robot on this rig: with hubs, but with pins where the engine moves a virtual one, which
        has them."""
        pinned = self.kind == "virtual" and self.virtual.physics == "eldir"
        printed = BuiltParameters() if pinned else BuiltParameters().with_hubs()
        return RobotParameters.nominal(self.spring_parameters(), printed)

    @property
    def source(self) -> bytes:
        """The entries of the loaded rig file for logs, without comments, addresses of `notify` and passwords
        of cameras. It can be loaded as the same rig, with the same `digest`."""
        return self._source or self._written()

    def _written(self) -> bytes:
        from eldir.core.yaml_files import dump_yaml

        values = self.model_dump(mode="json", exclude_unset=True)
        if isinstance(self.camera, LiveCameraEntry):
            values["camera"]["device"] = hide_password(self.camera.device)
        return dump_yaml(values, default_flow_style=None).encode()

    @classmethod
    def upgrade(cls, values: dict[str, Any]) -> dict[str, Any]:
        """The entries of a log of 0.1.0 by their present names."""
        return with_current_names(values)

    @property
    def digest(self) -> str:
        """SHA-256 of `source`, hexadecimal."""
        return hashlib.sha256(self.source).hexdigest()

    @classmethod
    def load(cls, path: Path | str) -> Rig:
        """Read a rig file. Raises `InputError` with the name of an invalid entry."""
        from eldir.core.yaml_files import MAX_YAML_BYTES, parse_yaml  # the guardian starts without

        path = Path(path)
        data = read_file(path, MAX_YAML_BYTES, f"write one: eldir rig new --board virtual --out {path}")
        try:
            values = parse_yaml(data, str(path))
            found = values.get("format") if isinstance(values, dict) else None
            if found != FORMAT:
                raise InputError(
                    f"{path} is not a rig file",
                    code="file.other-format",
                    expected=f"format: {FORMAT}",
                    found=repr(found),
                )
            require_current_names(values, str(path))
            rig = validate(cls, values, str(path), remedy="see docs/reference/rig.md")
        except InputError as error:  # its message may quote an address
            raise InputError(hide_addresses(str(error)), code=error.code, key=error.key) from None
        rig._source = rig._written()
        return rig


def _find_sensor_problem(sensor: SensorEntry, supply: SupplyEntry, springs: SpringEntry) -> str | None:
    """Why the sensor's chips and shunts do not fit the rig's currents and voltages; None if they do."""
    chip, limit = CHIPS[sensor.kind], supply.current_limit_a
    if supply.voltage_v > chip.max_voltage:
        expected = f"at most {chip.max_voltage:g} V for the inputs of {sensor.kind}"
        return f"supply.voltage_v is too high: expected {expected}, found {supply.voltage_v:g} V"
    if springs.resistance_tolerance > sensor.resistance_tolerance:
        return "sensor.resistance_tolerance is smaller than springs.resistance_tolerance"
    if limit is None:
        return None  # the rig does not arm then
    if chip.full_scale_current(sensor.shunt_ohm) < _HEADROOM * limit:
        largest = chip.full_scale_current(1.0) / (_HEADROOM * limit)
        return f"sensor.shunt_ohm is too large for {limit:g} A: expected at most {largest:.3g} Ohm"
    smallest = chip.min_shunt(_MIN_PART * limit)
    if sensor.shunt_ohm < smallest:
        return f"sensor.shunt_ohm is too small for {limit:g} A: expected at least {smallest:.3g} Ohm"
    return None
