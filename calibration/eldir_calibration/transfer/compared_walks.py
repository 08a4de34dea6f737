"""Walks of designs as predicted by the engine, and in MuJoCo with other samples of the robots."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Event
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeInt

from eldir.built.gait import Gait, read_gait
from eldir.built.samples import NominalRobots, SampledWalks, sample_walks
from eldir.built.screening import screen
from eldir.built.walking import MAX_TIE_SHARE
from eldir.core.records import BoolArray, FloatArray, Record, record
from eldir.design import Design
from eldir.engine.threads import worker_threads
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_calibration.report.verdict import prediction_interval
from eldir_calibration.transfer.biplane_walks import BiplaneWalk, walk_sampled_biplane
from eldir_calibration.transfer.mujoco_walks import MujocoWalk, WalkFault, walk_sampled_robot

_MAX_PERIOD = 120.0  # period of a gait [s]: as of a schedule
StepProgress = Callable[[str, float], None]
"""Called with the present step, and how many steps have been done since the last call."""


@record
class SimulationExtent(Record):
    """Extent of the simulations."""

    OPTIONAL = frozenset({"dimensions"})
    """Keys that files of version 0.1.0 do not have."""

    samples: Annotated[int, Field(ge=2)] = 8
    """Number of robots of each prediction, and of as many others in MuJoCo."""
    cycles: Annotated[int, Field(ge=1)] = 2
    """Number of cycles that are measured in MuJoCo, after one of conditioning; predictions have five."""
    phases: NonNegativeInt = 0
    """Number of other phases of each gait that are compared too."""
    seed: NonNegativeInt = 0
    """Random seed of the samples."""
    dimensions: Annotated[Literal[2, 3], Field(exclude_if=lambda value: value == 2)] = 2
    """Dimensions in which robots move in MuJoCo: in their plane, or in space, with each face by itself."""


@record
class TransferConfig(SimulationExtent):
    """Extent of the simulations, and the springs."""

    springs: SpringParameters = field(default_factory=SpringParameters)
    """Mean of the springs."""
    tolerances: RigTolerances = RigTolerances()
    """Tolerances of the rigs."""
    rig_file: str | None = None
    """Name of the rig file that springs and tolerances are from; None: those of evolution."""
    rig_digest: str | None = None
    """SHA-256 of that file."""


@dataclass(frozen=True)
class WalkingDesign:
    """A design and the gait that it walks with."""

    file: str
    design: Design
    gait: Gait
    screened: bool
    """Whether the gait is the best one of a screening; otherwise the design file has it."""


@dataclass(frozen=True, eq=False)
class ComparedWalk(Record):
    """A design with one gait in both simulations."""

    file: str
    """The design's file."""
    gait: Gait
    is_own_gait: bool
    """Whether this is the design's own gait; otherwise one of its other phases."""
    predicted: SampledWalks
    seeds: tuple[int, ...]
    """Seeds of the robots in MuJoCo."""
    mujoco: SampledWalks
    faults: tuple[WalkFault, ...]
    """Why a robot in MuJoCo did not walk (see `MujocoWalk`), empty if it did."""
    in_space: tuple[BiplaneWalk, ...] = ()
    """How each robot in MuJoCo leaves its plane; empty where it cannot."""

    @property
    def tied(self) -> bool:
        """Whether ties make the prediction doubtful."""
        return self.predicted.tie_share > MAX_TIE_SHARE

    @property
    def interval(self) -> tuple[float, float] | None:
        """Prediction interval for one more robot that stays upright [body lengths per five cycles]. None if
        fewer than two samples stay upright."""
        interval = prediction_interval(self.predicted.displacement)
        return (interval.low, interval.high) if np.isfinite(interval.low) else None

    @property
    def within_interval(self) -> BoolArray:
        """Whether each robot in MuJoCo does what was predicted, shape (n,): it walks within the interval, or
        it falls as at least one sample did."""
        walks = self.mujoco.displacement
        low, high = self.interval or (np.inf, -np.inf)
        falls = bool(self.predicted.fallen > 0)
        return np.where(np.isfinite(walks), (low <= walks) & (walks <= high), falls)

    @property
    def largest_yaw(self) -> float:
        """Largest rotation of a robot in MuJoCo about the vertical, either way [rad per five cycles];
        NaN where none is known."""
        return max((abs(walk.yaw) for walk in self.in_space if np.isfinite(walk.yaw)), default=np.nan)

    @property
    def largest_roll(self) -> float:
        """Largest lean to either side of a robot in MuJoCo [rad]; NaN where none is known."""
        return max((walk.roll for walk in self.in_space if np.isfinite(walk.roll)), default=np.nan)

    @property
    def fault_counts(self) -> dict[str, int]:
        """How many robots in MuJoCo had each fault."""
        return dict(Counter(fault for fault in self.faults if fault))

    @property
    def means(self) -> tuple[float, float]:
        """Mean of all predicted robots and of all robots in MuJoCo, a fall counted as no motion [body lengths
        per five cycles]."""
        return _mean_walk(self.predicted.displacement), _mean_walk(self.mujoco.displacement)


def load_walking_design(
    file: str, springs: SpringParameters, on_step: Callable[[str], None] = lambda _: None
) -> WalkingDesign:
    """Read a design; without a gait of `eldir shortlist` it gets the best one of a screening.

    `on_step` is called with the name of a slow step. Raises `InputError` for a file that is no design, and
    for a design that does not stand in any phase.
    """
    design = Design.load(file)
    try:
        gait = read_gait(design)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    if gait is not None:
        if gait.period > _MAX_PERIOD:
            raise InputError(
                f"the gait of {file} is too slow",
                expected=f"a period of at most {_MAX_PERIOD:g} s",
                found=f"{gait.period:g} s",
            )
        return WalkingDesign(file, design, gait, False)
    on_step(f"all phases of {file}")
    screening, nominal = None, RobotParameters.nominal(springs)
    if design.morphology.motors:
        ground, ballast = design.printed_terrain, design.ballast / 2
        (screening,) = screen(
            [design.morphology], nominal.printed, springs, terrain=ground, ballasts=[ballast]
        )
    if screening is None or screening.gait is None or not np.isfinite(screening.best):
        why = "no motor" if screening is None else screening.rejected or "it falls, folds or buckles a coil"
        raise InputError(f"{file} walks in no phase", code="design.no-walk", found=why, remedy="leave it out")
    return WalkingDesign(file, design, screening.gait, True)


def shift_phases(gait: Gait, count: int) -> list[Gait]:
    """`count` gaits whose motors heat at other times: motor k is later by k j / (`count` + 1) of a period in
    the j-th. None for a single motor, which has no other phases."""
    motors = np.arange(len(gait.phase))
    if len(motors) < 2:
        return []
    return [
        Gait(gait.period, (gait.phase + motors * j / (count + 1)) % 1.0, gait.duty, gait.method)
        for j in range(1, count + 1)
    ]


def count_steps(designs: Sequence[WalkingDesign], settings: TransferConfig) -> int:
    """Number of steps that `compare_walks` reports to `progress`."""
    return sum(1 + _count_gaits(d, settings) * settings.samples for d in designs)


def compare_walks(
    designs: Sequence[WalkingDesign],
    settings: TransferConfig,
    progress: StepProgress = lambda _what, _done: None,
) -> list[ComparedWalk]:
    """Predict each design's walk from samples, and simulate as many other samples in MuJoCo.

    Every design has seeds of its own, from `settings.seed` + 1 on; the samples use `settings.seed` itself,
    so that no robot of one simulation occurs in the other.
    """
    compared = []
    for number, one in enumerate(designs):
        body = one.design.morphology
        progress(f"predicting {one.file}", 0)
        gaits = [one.gait, *shift_phases(one.gait, settings.phases)]
        robot = RobotParameters.nominal(settings.springs, BuiltParameters().with_hubs())
        robots = NominalRobots(
            body, robot, one.design.ballast / 2, one.design.printed_terrain, settings.tolerances
        )
        predicted = sample_walks(robots, gaits, settings.samples, settings.seed)
        progress(f"MuJoCo: {one.file}", 1)
        seeds = robot_seeds(number, settings)
        for k, (gait, walks) in enumerate(zip(gaits, predicted, strict=True)):
            walks_in_mujoco = []
            for found_walk in _walk_in_parallel(one.design, gait, seeds, settings):
                walks_in_mujoco.append(found_walk)
                progress(f"MuJoCo: {one.file}", 1)
            mujoco = SampledWalks(np.array([walk.displacement for walk in walks_in_mujoco]))
            faults = tuple(walk.fault for walk in walks_in_mujoco)
            in_space = tuple(walk for walk in walks_in_mujoco if isinstance(walk, BiplaneWalk))
            compared.append(ComparedWalk(one.file, gait, k == 0, walks, seeds, mujoco, faults, in_space))
    return compared


def _walk_in_parallel(
    design: Design, gait: Gait, seeds: Sequence[int], settings: TransferConfig
) -> Iterator[MujocoWalk]:
    """Walks in MuJoCo, one in each thread: it computes without Python's lock. The order is that of the
    seeds."""
    cancelled = Event()
    walk = walk_sampled_robot if settings.dimensions == 2 else walk_sampled_biplane
    with ThreadPoolExecutor(worker_threads()) as pool:
        try:
            yield from pool.map(
                lambda seed: walk(
                    design, gait, seed, settings.springs, settings.tolerances, settings.cycles, cancelled
                ),
                seeds,
            )
        finally:  # after Ctrl-C nobody waits for the others
            cancelled.set()


def robot_seeds(number: int, settings: TransferConfig) -> tuple[int, ...]:
    """Seeds of the robots of design `number` in MuJoCo."""
    first = settings.seed + 1 + number * settings.samples
    return tuple(range(first, first + settings.samples))


def _count_gaits(one: WalkingDesign, settings: TransferConfig) -> int:
    return 1 + len(shift_phases(one.gait, settings.phases))


def _mean_walk(walks: FloatArray) -> float:
    return float(np.where(np.isfinite(walks), walks, 0.0).mean())
