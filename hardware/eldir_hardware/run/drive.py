"""Opens a rig, plays a schedule on it, and records relays, temperatures, frames, and the files of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.built.ground import lay_on_table
from eldir.core.files import require_new
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import InputError, describe
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.clock import Clock, VirtualClock, WallClock
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.measured_power import describe_correction
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.messages import DRY_RUN, HEAT_MODEL, MOVED_BY, ROOM, VIRTUAL_RIG
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from eldir_hardware.run.filming import CameraFiles, FilmLog, LiveCamera, record_frames, virtual_camera
from eldir_hardware.run.player import Player, RunResult
from eldir_hardware.run.room import MeasuredRoom, measure_room, with_room
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import (
    compare_wiring,
    design_digest,
    packet_wiring,
    require_compatible,
    schedule_digest,
)
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.bodies import find_parameters, physics_version
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody, VirtualRig

_ARMING = 1.5  # the schedule starts after this time, or later if arming takes longer [s]


@dataclass(frozen=True)
class DriveConfig:
    """Options of a run."""

    design_path: Path | None = None
    """Design of the robot, instead of the one that the rig file names; required with a virtual camera."""
    accept_mismatch: str = ""
    """Reason to play a schedule of another design or for other rig values; it is written into the log."""
    dry_run: bool = False
    """Whether to rehearse: on an emulated board in virtual time. The log says so."""
    room_c: float | None = None
    """Temperature of the air around the springs, measured before the run [C]; it is written into the log.
    None: the rig's thermometer measures it, if there is one."""
    on_time: Callable[[float], None] = lambda t: None
    """Called with the time of each report [s since the start of the schedule]."""
    on_room: Callable[[MeasuredRoom], None] = lambda room: None
    """Called with what was measured of the air before the run."""
    on_body: Callable[[BodyFrame], None] = lambda frame: None
    """Called with the true positions of a virtual robot in every frame; the log does not contain them."""
    on_rest: Callable[[float], None] = lambda seconds: None
    """Called with the time for which springs rest that are still warm from the previous run [s]."""
    control: Callable[[Player], AbstractContextManager[None]] = lambda player: nullcontext()
    """A context around the playing, such as one that obeys keys."""


class _LatestTime:
    """Observer that keeps the time of the latest report."""

    def __init__(self, on_time: Callable[[float], None]):
        self.t = 0.0
        self._on_time = on_time

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self.t = t
        self._on_time(t)

    def on_temperatures(self, *values: object) -> None:
        """Nothing to keep."""

    on_currents = on_event = on_temperatures


class _RealTimePauses:
    """In virtual time, makes a pause last as long as the person takes, and not the hours that the clock could
    move meanwhile."""

    def __init__(self) -> None:
        self._begun: tuple[float, float] | None = None  # of a pause, by the run and in real time

    def on_event(self, t: float, text: str) -> None:
        self._begun = (t, time.monotonic()) if text.startswith("paused") else None

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        if self._begun is not None:
            paused, real = self._begun
            time.sleep(max(t - paused - (time.monotonic() - real), 0.0))

    def on_temperatures(self, *values: object) -> None:
        """Reports of a board come with both."""

    on_currents = on_temperatures


def drive_rig(
    schedule: ActuationSchedule,
    rig: Rig,
    rig_path: Path,
    log: Path,
    config: DriveConfig = DriveConfig(),  # frozen
) -> RunResult:
    """Play `schedule` and write `log`. A run that fails leaves a valid log up to the failure.

    `rig_path` is the rig file's; the files that it names are relative to its folder. A schedule of another
    design, for other rig values, or edited after `eldir gait` is refused unless `config` has a reason to
    play it. All limits are checked in any case. Raises `EldirError`; everything is off then, or the message
    says to cut the supply.
    """
    require_new(log)  # checked before anything is armed
    design_path = find_design(rig, rig_path, config.design_path)
    design = None if design_path is None else Design.load(design_path)
    if rig.kind == "virtual" and design is None and rig.camera is not None:
        raise InputError(
            "a virtual rig needs a robot",
            code="rig.no-design",
            expected="a design file",
            remedy="give --design, or name it in the rig file under virtual.design",
        )
    if config.dry_run:
        rig = to_dry_run(rig)
    limits.check_schedule(schedule, rig)
    room = measure_room(rig, config.room_c)
    config.on_room(room)
    facts = {"rig_sha256": rig.digest, "schedule_sha256": schedule_digest(schedule)}
    if design is not None:
        facts["design_sha256"] = design_digest(design)
    accepted = require_compatible(schedule, rig, design, config.accept_mismatch)
    if config.dry_run:
        facts[DRY_RUN] = "yes"
    if accepted is not None:
        facts["accepted"] = accepted
    if room.room_c is not None:
        facts[ROOM] = f"{room.room_c:g}"
    wiring = compare_wiring(rig, packet_wiring(design_path, count_motors(schedule, rig), rig))
    calibration = CameraFiles.load(rig, rig_path)
    with open_rig(rig, design, schedule, config.on_body, room.room_c) as opened:
        earliest = opened.clock.now() + _ARMING
        # In virtual time the run waits for the disk, so that no picture is left out and the bytes repeat.
        virtual_time = isinstance(opened.clock, VirtualClock)
        recorder = Recorder(
            log,
            rig.channel_names,
            rig.spring_names,
            0 if virtual_time else None,
            calibration.lens,
            facts,
        )
        with recorder if virtual_time else BackgroundRecorder(recorder) as writer:
            _attach_files(writer, schedule, rig, design, calibration)
            latest = _LatestTime(config.on_time)
            try:
                observers = [writer, latest, *([_RealTimePauses()] if virtual_time else [])]
                player = Player(opened.bank, schedule, rig, opened.clock, observers)
                with _filming(opened, writer, latest) as begin_filming, config.control(player):

                    def begin(start: float) -> None:
                        if not virtual_time:
                            writer.begin_at(time.time_ns() + round(1e9 * (start - opened.clock.now())))
                        _log_facts(writer, facts, wiring, room, describe_correction(rig))
                        begin_filming(start)

                    result = player.play(earliest, begin, config.on_rest)
            except BaseException as error:
                writer.on_status(latest.t, "player", describe(error), good=False)
                raise
            writer.on_status(latest.t, "player", result.ended)
        return replace(result, impossible_motion=opened.get_remark())


def find_design(rig: Rig, rig_path: Path, design_path: Path | None) -> Path | None:
    """The design that is driven: `design_path`, or the one that the rig file names; None if neither does."""
    if design_path is None and rig.virtual.design is not None:
        return rig_path.parent / rig.virtual.design
    return design_path


def count_motors(schedule: ActuationSchedule, rig: Rig) -> int:
    """Number of motors of the robot for which a schedule was made."""
    return len(schedule.springs) or rig.motors


def to_dry_run(rig: Rig) -> Rig:
    """The same rig with an emulated board in virtual time, and without a real camera and notifications."""
    changes = {
        "kind": "virtual",
        "board": rig.board.model_copy(update={"port": None}),
        "virtual": rig.virtual.model_copy(update={"clock": "virtual"}),
        "camera": rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None,
        "sensor": None if rig.sensor is None else rig.sensor.model_copy(update={"port": None}),
        "thermometer": None if rig.thermometer is None else rig.thermometer.model_copy(update={"path": None}),
        "notify": (),
    }
    return rig.model_copy(update=changes)


_Writer = Recorder | BackgroundRecorder


def _attach_files(
    log: _Writer, schedule: ActuationSchedule, rig: Rig, design: Design | None, calibration: CameraFiles
) -> None:
    log.attach("schedule.json", schedule)
    log.attach("rig.yaml", rig.source)
    if design is not None:
        log.attach("design.json", design)
    if rig.kind == "virtual" and design is not None:
        log.on_status(0.0, VIRTUAL_RIG, f"{MOVED_BY}{physics_version(rig.virtual.physics)}")
    calibration.attach_to(log)


@contextmanager
def _filming(opened: OpenedRig, log: _Writer, latest: _LatestTime) -> Iterator[Callable[[float], None]]:
    """Film the run, and record what the virtual robot did that a real one could not have done."""
    try:
        with opened.filming(log) as begin:
            yield begin
    finally:
        if remark := opened.get_remark():
            log.on_status(latest.t, VIRTUAL_RIG, remark, good=False)


def _log_facts(log: _Writer, facts: dict[str, str], wiring: str, room: MeasuredRoom, correction: str) -> None:
    """Record the digests of the run's files, an accepted mismatch, and another wiring than the packet's."""
    digests = "; ".join(f"{name} {facts[name]}" for name in facts if name not in ("accepted", ROOM, DRY_RUN))
    log.on_status(0.0, "files", digests, facts)
    if DRY_RUN in facts:
        log.on_status(0.0, DRY_RUN, "a rehearsal on an emulated board in virtual time: nothing is heated")
    if "accepted" in facts:
        log.on_status(0.0, "files", f"the schedule was {facts['accepted']}", good=False)
    if room.text:
        log.on_status(0.0, "room", room.text, good=not room.is_doubtful)
    if correction:
        log.on_status(0.0, HEAT_MODEL, correction)
    if wiring:
        log.on_status(0.0, "files", f"not wired as the packet says: {wiring}")


class OpenedBank(NamedTuple):
    """Springs that can be heated, and the clock of their times."""

    bank: HeaterBank
    clock: Clock


Filming = Callable[[FilmLog], AbstractContextManager[Callable[[float], None]]]
"""A context that yields the function to call with the start of the schedule [s on the clock]."""


class OpenedRig(NamedTuple):
    """A rig that is ready to play a schedule."""

    bank: HeaterBank
    clock: Clock
    filming: Filming
    get_remark: Callable[[], str] = lambda: ""
    """What the virtual robot did that a real one could not have done; empty if nothing."""


class _NoBody:
    """A body without masses, for a virtual rig without a robot."""

    springs: IntArray = np.zeros((0, 2), dtype=np.int32)
    positions: FloatArray = np.zeros((0, 2))
    discs = None
    remark = ""

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Ignore the springs."""


@contextmanager
def open_bank(rig: Rig, room_c: float | None = None) -> Iterator[OpenedBank]:
    """The springs of a real rig, or of a virtual one without a robot. `room_c`: the measured air, for the
    modelled temperatures [C]."""
    modelled = with_room(rig, room_c)
    if rig.kind == "real":
        with Guardian(modelled) as guardian:
            yield OpenedBank(guardian, WallClock())
        return
    _, springs = find_parameters(rig)
    with VirtualRig(rig, _NoBody(), springs) as virtual, open_virtual_bank(virtual, modelled) as bank:
        yield OpenedBank(bank, virtual.clock)


@contextmanager
def open_virtual_bank(virtual: VirtualRig, rig: Rig) -> Iterator[HeaterBank]:
    """The springs of a virtual rig. On the wall clock a guardian process drives them, as on a real rig.

    `rig`: as the program that drives knows it, with the air that was measured.
    """
    if isinstance(virtual.clock, VirtualClock):
        yield PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)
    else:
        with Guardian(rig, virtual.emulator.port, virtual.sensor_port) as guardian:
            yield guardian


def open_rig(
    rig: Rig,
    design: Design | None,
    schedule: ActuationSchedule,
    on_body: Callable[[BodyFrame], None],
    room_c: float | None = None,
) -> AbstractContextManager[OpenedRig]:
    """The rig as a context. On a virtual rig with a design, `on_body` gets the positions in every frame.
    `room_c`: the measured air, for the modelled temperatures [C]."""
    if rig.kind == "virtual" and design is not None:
        return _open_virtual(rig, design, schedule, on_body, room_c)
    return _open_unsimulated(rig, room_c)


@contextmanager
def _open_unsimulated(rig: Rig, room_c: float | None) -> Iterator[OpenedRig]:
    """A real rig with its camera, or a virtual one without a robot."""
    if rig.kind == "real" and isinstance(rig.camera, LiveCameraEntry):
        with LiveCamera(rig.camera) as camera, open_bank(rig, room_c) as opened:
            yield OpenedRig(*opened, camera.filming)
    else:
        with open_bank(rig, room_c) as opened:
            yield OpenedRig(*opened, lambda log: nullcontext(lambda start: None))


@contextmanager
def _open_virtual(
    rig: Rig,
    design: Design,
    schedule: ActuationSchedule,
    on_body: Callable[[BodyFrame], None],
    room_c: float | None,
) -> Iterator[OpenedRig]:
    rig.require_motors(design.morphology.motors)
    printed, springs = find_parameters(rig)
    entry = rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None
    with _open_body(rig, design, springs, printed) as body, VirtualRig(rig, body, springs) as virtual:
        camera = None if entry is None else virtual_camera(rig, entry, body, schedule, lay_on_table(design))

        @contextmanager
        def filming(log: FilmLog) -> Iterator[Callable[[float], None]]:
            record = None if camera is None else record_frames(camera, design.marks, log, on_body)

            def begin(start: float) -> None:
                virtual.start = start
                if entry is not None and record is not None:
                    virtual.watch(entry.rate_hz, record)

            try:
                yield begin
            finally:
                virtual.stop_watching()

        with open_virtual_bank(virtual, with_room(rig, room_c)) as bank:
            yield OpenedRig(bank, virtual.clock, filming, lambda: body.remark)


@contextmanager
def _open_body(
    rig: Rig, design: Design, springs: SpringParameters, printed: BuiltParameters | None
) -> Iterator[DrivenBody]:
    from eldir_hardware.virtual.bodies import BodyProcess, virtual_body

    virtual, body = rig.virtual, design.morphology
    ground = lay_on_table(design)
    given = (
        virtual.physics,
        body,
        virtual.seed,
        springs,
        design.ballast,
        printed,
        ground,
        virtual.dimensions,
    )
    if virtual.clock == "virtual":
        yield virtual_body(*given)
        return
    # In this process its engine would delay the emulated board, which then would not answer in time.
    with BodyProcess(*given) as process:
        yield process
