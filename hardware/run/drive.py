"""Plays a schedule on a rig and records relays, temperatures, frames, and the files of the run."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eldir.core.files import require_new
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.parameters.robot import RobotParameters
from hardware.clock import Clock, VirtualClock, WallClock
from hardware.guardian.bank import Bank
from hardware.guardian.client import Guardian
from hardware.guardian.pulse_controller import PulseController
from hardware.log.background import BackgroundRecorder
from hardware.log.recorder import Recorder
from hardware.rig.configuration import Rig
from hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from hardware.run.filming import CameraFiles, film, virtual_camera
from hardware.run.player import Played, Player
from hardware.safety import limits
from hardware.schedule import ActuationSchedule
from hardware.virtual.rig import BodyFrame, VirtualRig

_ARMING = 1.5  # until the schedule starts: long enough to prove everything off [s]


class _Notes:
    """Forwards events from any thread to the log, and the time to the progress display."""

    def __init__(self, recorder: Recorder | BackgroundRecorder, progress: Callable[[float], None]):
        self._recorder = recorder
        self._progress = progress
        self._writing = threading.Lock()
        self.latest = 0.0

    def on_relays(self, t: float, states: tuple[bool, ...]) -> None:
        with self._writing:
            self._recorder.on_relays(t, states)
        self.latest = t
        self._progress(t)

    def on_temperatures(self, t: float, temperatures: tuple[float, ...]) -> None:
        with self._writing:
            self._recorder.on_temperatures(t, temperatures)

    def attach(self, name: str, mime: str, data: bytes) -> None:
        with self._writing:
            self._recorder.attach(name, mime, data)

    def on_frame(self, t: float, bgr: NDArray[np.uint8]) -> None:
        with self._writing:
            self._recorder.on_frame(t, bgr)

    def on_event(self, t: float, text: str) -> None:
        with self._writing:
            self._recorder.on_status(t, "player", text)

    def on_stall(self, t: float, seconds: float) -> None:
        with self._writing:
            self._recorder.on_status(t, "camera", f"no frame for {seconds:.1f} s", good=False)

    def on_end(self, message: str, good: bool) -> None:
        with self._writing:
            self._recorder.on_status(self.latest, "player", message, good=good)


_Filming = Callable[[_Notes, float], AbstractContextManager[None]]


class _OpenedRig(NamedTuple):
    """A rig that is ready to play a schedule."""

    bank: Bank
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
) -> Played:
    """Play `schedule` and write `log`. A run that fails leaves a valid log up to the failure.

    A virtual rig needs a design: `design_path`, or the one that the rig file names. `see` gets the true
    positions of its body, which the log does not contain. `steer` is a context around the playing.
    Raises `EldirError`; everything is off then, or the message says to cut the supply.
    """
    require_new(log)  # checked before anything is armed
    if design_path is None and rig.virtual.design is not None:
        design_path = rig_path.parent / rig.virtual.design
    design = None if design_path is None else Design.load(design_path)
    if rig.kind == "virtual" and design is None and rig.camera is not None:
        raise InputError(
            "a virtual rig needs a robot",
            expected="a design file",
            remedy="give --design, or name it in the rig file under virtual.design",
        )
    limits.check_schedule(schedule, rig)
    calibrated = CameraFiles.of(rig, rig_path)
    if rig.kind == "real":
        opened: AbstractContextManager[_OpenedRig] = _real(rig)
    elif design is None:
        opened = _without_body(rig)
    else:
        opened = _virtual(rig, design, schedule, see)
    with opened as opened_rig:
        start = opened_rig.clock.now() + _ARMING
        virtual_time = isinstance(opened_rig.clock, VirtualClock)
        written = Recorder(
            log,
            [f"channel{i}" for i in range(1, rig.board.channels + 1)],
            [f"spring{c.spring}_{c.face}" for c in rig.channels],
            0 if virtual_time else time.time_ns() + round(1e9 * _ARMING),
            calibrated.lens,
        )
        # Virtual time waits for the disk, so that no picture is ever left out and its bytes repeat.
        with written if virtual_time else BackgroundRecorder(written) as recorder:
            recorder.attach("schedule.json", "application/json", _json(schedule.to_json()))
            recorder.attach("rig.yaml", "application/yaml", rig_path.read_bytes())
            if design is not None:
                recorder.attach("design.json", "application/json", _json(design.to_json()))
            notes = _Notes(recorder, progress)
            calibrated.attach_to(notes)
            try:
                player = Player(opened_rig.bank, schedule, rig, opened_rig.clock, [notes])
                with opened_rig.filming(notes, start), steer(player):
                    played = player.play(start)
            except EldirError as error:
                notes.on_end(str(error), good=False)
                raise
            except KeyboardInterrupt:
                notes.on_end("stopped by Ctrl-C", good=False)
                raise
            notes.on_end("played to the end", good=True)
    return played


@contextmanager
def _real(rig: Rig) -> Iterator[_OpenedRig]:
    with _watching(rig) as filming, Guardian(rig) as bank:
        yield _OpenedRig(bank, WallClock(), filming)


@contextmanager
def _watching(rig: Rig) -> Iterator[_Filming]:
    if not isinstance(rig.camera, LiveCameraEntry):
        yield lambda notes, start: nullcontext()
        return
    from hardware.run.live_filming import LiveCamera

    with LiveCamera(rig.camera) as camera:
        yield camera.filming


def without_heat(rig: Rig) -> Rig:
    """The same rig with an emulated board in virtual time and no real camera, for a dry run."""
    board = rig.board.model_copy(update={"port": None})
    clock = rig.virtual.model_copy(update={"clock": "virtual"})
    camera = rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None
    return rig.model_copy(update={"kind": "virtual", "board": board, "virtual": clock, "camera": camera})


class _NoBody:
    """A body without masses, for a virtual rig without a robot."""

    springs: IntArray = np.zeros((0, 2), dtype=np.int32)
    positions: FloatArray = np.zeros((0, 2))

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Ignore the springs."""


@contextmanager
def _without_body(rig: Rig) -> Iterator[_OpenedRig]:
    with VirtualRig(rig, _NoBody()) as virtual:
        bank = PulseController(virtual.board, rig, virtual.clock)
        yield _OpenedRig(bank, virtual.clock, lambda notes, start: nullcontext())


@contextmanager
def _virtual(
    rig: Rig, design: Design, schedule: ActuationSchedule, see: Callable[[BodyFrame], None]
) -> Iterator[_OpenedRig]:
    from hardware.virtual.body import BuiltBody
    from hardware.virtual.far import far_from

    body = design.morphology
    if body.motors > rig.motors:
        raise InputError(
            "the rig has too few springs for this design", expected=f"{body.motors}", found=f"{rig.motors}"
        )
    built, springs = None, rig.spring_parameters()
    if rig.virtual.deviation == "far":
        far = far_from(RobotParameters(springs=springs), rig.virtual.seed)
        built, springs = far.printed, far.springs
    robot = BuiltBody(body, rig.virtual.seed, springs, design.ballast / 2, built)
    watching = rig.camera if isinstance(rig.camera, VirtualCameraEntry) else None
    camera = None if watching is None else virtual_camera(rig, watching, robot, schedule)
    with VirtualRig(rig, robot, springs) as virtual:

        @contextmanager
        def filming(notes: _Notes, start: float) -> Iterator[None]:
            virtual.start = start
            if watching is not None and camera is not None:
                virtual.watch(watching.rate_hz, film(camera, design.marks, notes, see))
            try:
                yield
            finally:
                virtual.stop_watching()

        if isinstance(virtual.clock, VirtualClock):
            yield _OpenedRig(PulseController(virtual.board, rig, virtual.clock), virtual.clock, filming)
        else:  # as a real one, and nothing may hold it up, such as the compiler of the engine
            spare = BuiltBody(body, rig.virtual.seed, rig.spring_parameters())
            spare.move(np.full((1, body.motors), rig.spring_parameters().cold_length), 0.05)
            if camera is not None:
                camera.render(robot.positions, robot.springs, design.marks)
            with Guardian(rig, virtual.emulator.port) as bank:
                yield _OpenedRig(bank, virtual.clock, filming)


def _json(values: object) -> bytes:
    return (json.dumps(values, indent=1) + "\n").encode()
