"""Plays a schedule on a rig and records relays, temperatures, frames, and the files of the run."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

from eldir.core.files import require_new
from eldir.design import Design
from eldir.errors import InputError, describe
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.clock import Clock, VirtualClock
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.packet_wiring import packet_of, wiring_note
from eldir_hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from eldir_hardware.run.filming import CameraFiles, film, virtual_camera
from eldir_hardware.run.opened_rig import bank_of, bank_on
from eldir_hardware.run.player import Played, Player
from eldir_hardware.safety import limits
from eldir_hardware.safety.schedule_digests import design_digest, require_made_for, schedule_digest
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.bodies import physics_name
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody, VirtualRig

_ARMING = 1.5  # until the schedule starts, or longer where it takes longer to prove everything off [s]


class _Run:
    """Shows the time of a run, and notes in its log what happened last."""

    def __init__(self, log: Recorder | BackgroundRecorder, progress: Callable[[float], None]):
        self.log = log
        self._progress = progress
        self._latest = 0.0

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        self._latest = t
        self._progress(t)

    def on_temperatures(self, *seen: object) -> None:
        """Nothing to show."""

    on_currents = on_event = on_temperatures

    def note(self, part: str, text: str, good: bool = False) -> None:
        """What a part of the rig says after the last report of the contacts."""
        self.log.on_status(self._latest, part, text, good=good)


_Filming = Callable[[_Run], AbstractContextManager[Callable[[float], None]]]
"""A context that yields the function to call with the start of the schedule [s on the clock]."""


class _OpenedRig(NamedTuple):
    """A rig that is ready to play a schedule."""

    bank: HeaterBank
    clock: Clock
    filming: _Filming


def drive_rig(
    schedule: ActuationSchedule,
    rig: Rig,
    rig_path: Path,
    log: Path,
    design_path: Path | None = None,
    progress: Callable[[float], None] = lambda t: None,
    see: Callable[[BodyFrame], None] = lambda frame: None,
    steer: Callable[[Player], AbstractContextManager[None]] = lambda player: nullcontext(),
    rest: Callable[[float], None] = lambda seconds: None,
    accept_mismatch: str = "",
) -> Played:
    """Play `schedule` and write `log`. A run that fails leaves a valid log up to the failure.

    A schedule of another design, for other rig values, or edited after `eldir gait` is refused.
    `accept_mismatch` is the reason why such a one is played nevertheless; it is written into the log. All
    limits are checked in any case.

    A virtual rig needs a design: `design_path`, or the one that the rig file names. `see` gets the true
    positions of its body, which the log does not contain. `steer` is a context around the playing. `rest` is
    called with the time for which springs rest that are still warm from the run before [s].
    Raises `EldirError`; everything is off then, or the message says to cut the supply.
    """
    require_new(log)  # checked before anything is armed
    design_path = robot_file(rig, rig_path, design_path)
    design = None if design_path is None else Design.load(design_path)
    if rig.kind == "virtual" and design is None and rig.camera is not None:
        raise InputError(
            "a virtual rig needs a robot",
            code="rig.no-design",
            expected="a design file",
            remedy="give --design, or name it in the rig file under virtual.design",
        )
    limits.check_schedule(schedule, rig)
    accepted = require_made_for(schedule, rig, design, accept_mismatch)
    facts = _facts(schedule, rig, design, accepted)
    wired = wiring_note(rig, packet_of(design_path, motors_of(schedule, rig)))
    calibrated = CameraFiles.of(rig, rig_path)
    if rig.kind == "real":
        opened: AbstractContextManager[_OpenedRig] = _real(rig)
    elif design is None:
        opened = _without_body(rig)
    else:
        opened = _virtual(rig, design, schedule, see)
    with opened as opened_rig:
        clock = opened_rig.clock
        earliest = clock.now() + _ARMING
        virtual_time = isinstance(clock, VirtualClock)
        written = Recorder(
            log,
            [f"channel{i}" for i in range(1, rig.board.channels + 1)],
            [f"spring{c.spring}_{c.face}" for c in rig.channels],
            0 if virtual_time else None,
            calibrated.lens,
            facts,
        )
        # Virtual time waits for the disk, so that no picture is ever left out and its bytes repeat.
        with written if virtual_time else BackgroundRecorder(written) as recorder:
            recorder.attach("schedule.json", schedule)
            recorder.attach("rig.yaml", rig.source)
            if design is not None:
                recorder.attach("design.json", design)
            if rig.kind == "virtual" and design is not None:
                recorder.on_status(0.0, "virtual rig", f"moved by {physics_name(rig.virtual.physics)}")
            calibrated.attach_to(recorder)
            run = _Run(recorder, progress)
            try:
                player = Player(opened_rig.bank, schedule, rig, clock, [recorder, run])
                with opened_rig.filming(run) as begin_filming, steer(player):

                    def ready(start: float) -> None:
                        if not virtual_time:
                            recorder.begin_at(time.time_ns() + round(1e9 * (start - clock.now())))
                        digests = "; ".join(f"{name} {facts[name]}" for name in facts if name != "accepted")
                        recorder.on_status(0.0, "files", digests, facts)
                        if accepted is not None:
                            recorder.on_status(0.0, "files", f"the schedule was {accepted}", good=False)
                        if wired:
                            recorder.on_status(0.0, "files", f"not wired as the packet says: {wired}")
                        begin_filming(start)

                    played = player.play(earliest, ready, rest)
            except BaseException as error:
                run.note("player", describe(error))
                raise
            run.note("player", played.ended, good=True)
    return played


def robot_file(rig: Rig, rig_path: Path, design_path: Path | None) -> Path | None:
    """The design that is driven: `design_path`, or the one that the rig file names; None if neither does."""
    if design_path is None and rig.virtual.design is not None:
        return rig_path.parent / rig.virtual.design
    return design_path


def motors_of(schedule: ActuationSchedule, rig: Rig) -> int:
    """Number of motors of the robot that a schedule is for."""
    return len(schedule.springs) or rig.motors


@contextmanager
def _real(rig: Rig) -> Iterator[_OpenedRig]:
    with _watching(rig) as filming, bank_of(rig) as opened:
        yield _OpenedRig(*opened, filming)


@contextmanager
def _watching(rig: Rig) -> Iterator[_Filming]:
    if not isinstance(rig.camera, LiveCameraEntry):
        yield _no_filming
        return
    from eldir_hardware.run.live_filming import LiveCamera

    with LiveCamera(rig.camera) as camera:
        yield lambda run: camera.filming(run.log)


def _no_filming(run: _Run) -> AbstractContextManager[Callable[[float], None]]:
    return nullcontext(lambda start: None)


def without_heat(rig: Rig) -> Rig:
    """The same rig with an emulated board in virtual time and no real camera, for a dry run."""
    board = rig.board.model_copy(update={"port": None})
    clock = rig.virtual.model_copy(update={"clock": "virtual"})
    camera = rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None
    sensor = None if rig.sensor is None else rig.sensor.model_copy(update={"port": None})
    emulated = {"kind": "virtual", "board": board, "virtual": clock, "camera": camera, "sensor": sensor}
    emulated["notify"] = ()
    return rig.model_copy(update=emulated)


@contextmanager
def _without_body(rig: Rig) -> Iterator[_OpenedRig]:
    with bank_of(rig) as opened:
        yield _OpenedRig(*opened, _no_filming)


@contextmanager
def _virtual(
    rig: Rig, design: Design, schedule: ActuationSchedule, see: Callable[[BodyFrame], None]
) -> Iterator[_OpenedRig]:
    from eldir_hardware.virtual.bodies import far_from

    rig.require_motors(design.morphology.motors)
    built, springs = None, rig.spring_parameters()
    if rig.virtual.parameter_spread == "large":
        far = far_from(RobotParameters(springs=springs), rig.virtual.seed)
        built, springs = far.printed, far.springs
    watching = rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None
    with _robot(rig, design, springs, built) as robot, VirtualRig(rig, robot, springs) as virtual:
        camera = None if watching is None else virtual_camera(rig, watching, robot, schedule)

        @contextmanager
        def filming(run: _Run) -> Iterator[Callable[[float], None]]:
            shoot = None if camera is None else film(camera, design.marks, run.log, see)

            def begin(start: float) -> None:
                virtual.start = start
                if watching is not None and shoot is not None:
                    virtual.watch(watching.rate_hz, shoot)

            try:
                yield begin
            finally:
                virtual.stop_watching()
                if robot.remark:
                    run.note("virtual rig", robot.remark)

        with bank_on(virtual, rig) as bank:
            yield _OpenedRig(bank, virtual.clock, filming)


@contextmanager
def _robot(
    rig: Rig, design: Design, springs: SpringParameters, built: BuiltParameters | None
) -> Iterator[DrivenBody]:
    from eldir_hardware.virtual.bodies import virtual_body
    from eldir_hardware.virtual.body_process import BodyProcess

    given = (rig.virtual.physics, design.morphology, rig.virtual.seed, springs, design.ballast, built)
    if rig.virtual.clock == "virtual":
        yield virtual_body(*given)
        return
    # In this process its engine would hold up the emulated board, which then looks dead.
    with BodyProcess(*given) as robot:
        yield robot


def _facts(
    schedule: ActuationSchedule, rig: Rig, design: Design | None, accepted: str | None
) -> dict[str, str]:
    """Digests of the files of a run, for its log."""
    facts = {"rig_sha256": rig.digest, "schedule_sha256": schedule_digest(schedule)}
    if design is not None:
        facts["design_sha256"] = design_digest(design)
    return facts if accepted is None else facts | {"accepted": accepted}
