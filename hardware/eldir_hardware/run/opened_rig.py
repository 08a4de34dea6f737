"""Opens a rig for a run: the guardian of a real board or an emulated board, its clock, and its camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import NamedTuple

import numpy as np

from eldir.built.ground import lay_on_table
from eldir.core.records import FloatArray, IntArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_hardware.clock import Clock, VirtualClock, WallClock
from eldir_hardware.guardian.bank import HeaterBank
from eldir_hardware.guardian.client import Guardian
from eldir_hardware.guardian.pulse_controller import PulseController
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import LiveCameraEntry, VirtualCameraEntry
from eldir_hardware.run.filming import FilmLog, LiveCamera, record_frames, virtual_camera
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.virtual.rig import BodyFrame, DrivenBody, VirtualRig


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
    remark = ""

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Ignore the springs."""


@contextmanager
def open_bank(rig: Rig) -> Iterator[OpenedBank]:
    """The springs of a real rig, or of a virtual one without a robot."""
    if rig.kind == "real":
        with Guardian(rig) as guardian:
            yield OpenedBank(guardian, WallClock())
        return
    with VirtualRig(rig, _NoBody()) as virtual, open_virtual_bank(virtual, rig) as bank:
        yield OpenedBank(bank, virtual.clock)


@contextmanager
def open_virtual_bank(virtual: VirtualRig, rig: Rig) -> Iterator[HeaterBank]:
    """The springs of a virtual rig. On the wall clock a guardian process drives them, as on a real rig."""
    if isinstance(virtual.clock, VirtualClock):
        yield PulseController(virtual.board, rig, virtual.clock, sensor=virtual.sensor)
    else:
        with Guardian(rig, virtual.emulator.port, virtual.sensor_port) as guardian:
            yield guardian


def open_rig(
    rig: Rig, design: Design | None, schedule: ActuationSchedule, on_body: Callable[[BodyFrame], None]
) -> AbstractContextManager[OpenedRig]:
    """The rig as a context. On a virtual rig with a design, `on_body` gets the positions in every frame."""
    if rig.kind == "virtual" and design is not None:
        return _open_virtual(rig, design, schedule, on_body)
    return _open_unsimulated(rig)


@contextmanager
def _open_unsimulated(rig: Rig) -> Iterator[OpenedRig]:
    """A real rig with its camera, or a virtual one without a robot."""
    if rig.kind == "real" and isinstance(rig.camera, LiveCameraEntry):
        with LiveCamera(rig.camera) as camera, open_bank(rig) as opened:
            yield OpenedRig(*opened, camera.filming)
    else:
        with open_bank(rig) as opened:
            yield OpenedRig(*opened, lambda log: nullcontext(lambda start: None))


@contextmanager
def _open_virtual(
    rig: Rig, design: Design, schedule: ActuationSchedule, on_body: Callable[[BodyFrame], None]
) -> Iterator[OpenedRig]:
    from eldir_hardware.virtual.bodies import sample_large_spread

    rig.require_motors(design.morphology.motors)
    printed, springs = None, rig.spring_parameters()
    if rig.virtual.parameter_spread == "large":
        far = sample_large_spread(RobotParameters(springs=springs), rig.virtual.seed)
        printed, springs = far.printed, far.springs
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

        with open_virtual_bank(virtual, rig) as bank:
            yield OpenedRig(bank, virtual.clock, filming, lambda: body.remark)


@contextmanager
def _open_body(
    rig: Rig, design: Design, springs: SpringParameters, printed: BuiltParameters | None
) -> Iterator[DrivenBody]:
    from eldir_hardware.virtual.bodies import BodyProcess, virtual_body

    virtual, terrain = rig.virtual, lay_on_table(design)
    given = (
        virtual.physics,
        design.morphology,
        virtual.seed,
        springs,
        design.ballast,
        printed,
        terrain,
    )
    if rig.virtual.clock == "virtual":
        yield virtual_body(*given)
        return
    # In this process its engine would delay the emulated board, which then would not answer in time.
    with BodyProcess(*given) as body:
        yield body
