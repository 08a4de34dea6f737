"""The virtual rig: the parts of a real one, emulated, from a rig file of kind `virtual`.

The real driver talks bytes over a pseudo-terminal to an emulated board; the board's contacts heat
springs; the springs' lengths move a body. Its parameters deviate from the nominal ones by the seed.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES, Face
from eldir_hardware.camera.projection import DiscPoses
from eldir_hardware.clock import VirtualClock, WallClock
from eldir_hardware.current_sensor import CurrentSensor
from eldir_hardware.emulator.board import EmulatedBoard
from eldir_hardware.emulator.current_sensor import EmulatedCurrentSensor, Shunts
from eldir_hardware.relay.board import RelayBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.devices import connect_sensor, get_driver, get_emulator
from eldir_hardware.rig.supply import power_shares
from eldir_hardware.thermometer import ERROR_K, STEP_K
from eldir_hardware.virtual.springs import STEP, ThermalSprings

_logger = logging.getLogger(__name__)
_MAX_DELAY = 1.0
"""A simulation that is later than this on the wall's clock is too slow for it [s]."""


class BodyFrame(NamedTuple):
    """The true positions of the body."""

    time_s: float
    """Time since the schedule's start [s]."""
    positions: FloatArray
    """All masses [m], shape (M, 2)."""
    springs: IntArray
    """Mass indices of every spring, shape (S, 2)."""
    discs: DiscPoses | None = None
    """The discs of both faces; None for a body that stays in its plane."""


class DrivenBody(Protocol):
    """A body that the active springs move."""

    springs: IntArray
    """Mass indices of every spring, shape (S, 2)."""

    @property
    def remark(self) -> str:
        """What a printed robot cannot do, such as parts that pass through each other, and when it was first
        seen; else empty."""

    @property
    def positions(self) -> FloatArray:
        """Current positions of the masses [m], shape (M, 2)."""

    @property
    def discs(self) -> DiscPoses | None:
        """Current places of the discs of both faces; None for a body that stays in its plane."""

    def move(self, lengths: FloatArray, interval: float) -> None:
        """Follow free lengths of the coils on the front and the back of each motor given every `interval`
        [s], shape (steps, motors, 2)."""


def room_temperature(rig: Rig) -> float:
    """Temperature of the air around the springs of a virtual rig, which depends on its seed [C]."""
    return rig.spring_tolerances().perturb_by_seed(rig.spring_parameters(), rig.virtual.seed).ambient


def thermometer_reading(rig: Rig) -> float:
    """What a thermometer at a virtual rig shows [C], with its error, which depends on the seed."""
    error = np.random.default_rng([rig.virtual.seed, 7]).uniform(-ERROR_K, ERROR_K)
    return STEP_K * round((room_temperature(rig) + error) / STEP_K)


class VirtualRig:
    """Powered between `open` and `close`, or in a `with`.

    On a virtual clock `board` is the real driver on the emulated board's port, and `sensor` on the emulated
    sensor's; on the wall's a guardian process opens these ports.
    """

    def __init__(self, rig: Rig, body: DrivenBody, springs: SpringParameters | None = None):
        """`springs`: those that the rig should have, by default the nominal ones. All together deviate by the
        seed within the rig's tolerances, and each by itself."""
        if rig.kind != "virtual":
            raise InputError(
                "this is not a virtual rig", code="rig.real", expected="kind: virtual", found=rig.kind
            )
        self.clock = VirtualClock() if rig.virtual.clock == "virtual" else WallClock()
        self.emulator: EmulatedBoard
        self.board: RelayBoard
        self.emulated_sensor: EmulatedCurrentSensor | None = None
        """None where the rig file names no current sensor."""
        self.sensor: CurrentSensor | None = None
        self.start = 0.0
        """The schedule's start on the clock [s]; frames count from it."""
        self._rig = rig
        self._body = body
        self._body_lock = threading.Lock()
        self._closed = threading.Event()
        self._failure: Exception | None = None
        self._watchers: list[threading.Thread] = []
        tolerances = rig.spring_tolerances()
        common = tolerances.perturb_by_seed(springs or rig.spring_parameters(), rig.virtual.seed)
        deviations = np.random.default_rng([rig.virtual.seed, 3])
        coils = [(c.spring, face) for c in rig.channels for face in c.faces]
        self.springs = ThermalSprings(
            [c.channel for c in rig.channels for _ in c.faces],
            [tolerances.perturb_one(common, deviations) for _ in coils],
            self.clock.now(),
            rig.cutoff_s,
            power_shares(rig, common) if rig.supply.outputs == "shared" else None,
            rig.opens_at_c,
        )
        self._cold_length = common.cold_length
        self._coils = np.array(
            [[_find_coil(coils, motor, face) for face in FACES] for motor in range(rig.motors)]
        )

    def open(self) -> None:
        """Power the emulated board on; on a virtual clock, connect its driver."""
        kind, channels = self._rig.board.kind, self._rig.board.channels
        self.emulator = get_emulator(kind)(channels, self.clock, self.springs.on_contact_event)
        self.emulator.start()
        self._open_sensor()
        if isinstance(self.clock, VirtualClock):
            self.board = get_driver(kind)(self.emulator.port, channels, self.clock)
            # Bytes arrive in no virtual time: the board acts on them before time moves on.
            self.clock.add_barrier(lambda: self.emulator.wait_for_bytes(self.board.bytes_written))

    @property
    def sensor_port(self) -> str | None:
        """Port of the emulated current sensor, if the rig has one."""
        return None if self.emulated_sensor is None else self.emulated_sensor.port

    def _open_sensor(self) -> None:
        entry, clock = self._rig.sensor, self.clock
        if entry is None:
            return
        self.emulated_sensor = emulated = EmulatedCurrentSensor(
            entry.kind,
            self._rig.measured_channels,
            self.springs.current_and_voltage,
            clock,
            Shunts(entry.shunt_ohm, entry.shunt_tolerance, entry.lead_ohm),
            self._rig.virtual.seed,
        )
        emulated.start()
        if isinstance(clock, VirtualClock):
            self.sensor = connect_sensor(self._rig, emulated.port, clock)

    def close(self) -> None:
        """Power off. Raises the error of a `watch` that failed."""
        self.stop_watching()
        if self.sensor is not None:
            self.sensor.close()
        if self.emulated_sensor is not None:
            self.emulated_sensor.close()
        if isinstance(self.clock, VirtualClock):
            self.board.close()
        self.emulator.close()

    def __enter__(self) -> VirtualRig:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def frame(self, t: float) -> BodyFrame:
        """Advance springs and body to `t` on the clock, and return the body's positions."""
        with self._body_lock:
            lengths = self.springs.advance(t)
            if len(lengths):
                unheated = np.full((len(lengths), 1), self._cold_length)
                self._body.move(np.hstack([lengths, unheated])[:, self._coils], STEP)
            body = self._body
            return BodyFrame(t - self.start, body.positions.copy(), body.springs, body.discs)

    def watch(self, rate: float, on_frame: Callable[[BodyFrame], None]) -> None:
        """Call `on_frame` with a frame `rate` times a second of the rig's time, from `start` until the
        end."""
        if isinstance(self.clock, VirtualClock):
            self._schedule_frames(self.clock, rate, on_frame, 0)
        else:
            thread = threading.Thread(target=self._run_frames, args=(rate, on_frame), name="virtual body")
            self._watchers.append(thread)
            thread.start()

    def stop_watching(self) -> None:
        """Stop calling `on_frame`. Raises the error of a call that failed."""
        self._closed.set()
        while self._watchers:
            self._watchers.pop().join()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _schedule_frames(
        self, clock: VirtualClock, rate: float, on_frame: Callable[[BodyFrame], None], number: int
    ) -> None:
        def deliver(t: float) -> None:
            if not self._closed.is_set():
                on_frame(self.frame(t))
                self._schedule_frames(clock, rate, on_frame, number + 1)

        clock.call_at(self.start + number / rate, deliver)

    def _run_frames(self, rate: float, on_frame: Callable[[BodyFrame], None]) -> None:
        number, warned = 0, False
        try:
            while not self._closed.is_set():
                t = self.start + number / rate
                self.clock.sleep_until(t)
                on_frame(self.frame(t))
                if not warned and (delay := self.clock.now() - t) > _MAX_DELAY:
                    _logger.warning(
                        "the robot's simulation is %.1f s behind the clock: pictures come late and are few. "
                        "Take a robot with fewer masses, or virtual.dimensions: 2",
                        delay,
                    )
                    warned = True
                number = max(number + 1, math.ceil((self.clock.now() - self.start) * rate))  # missed ones
        except Exception as error:  # raised by `stop_watching`
            self._failure = error


def _find_coil(coils: Sequence[tuple[int, Face]], motor: int, face: Face) -> int:
    """Number of the heated coil of a motor on a face, or else the one on its other face; the number of heated
    coils where none is of that motor."""
    rank = {place: i for i, place in enumerate(coils)}
    other = FACES[1 - FACES.index(face)]
    return rank.get((motor, face), rank.get((motor, other), len(rank)))
