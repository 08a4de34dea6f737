"""Walks of designs predicted by the engine, and walked in MuJoCo by robots that the prediction never saw."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Event
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeInt

from eldir.built.gait import Gait, gait_of
from eldir.built.samples import NominalRobots, SampledWalks, sampled_walks
from eldir.built.screening import screen
from eldir.built.walking import TIED
from eldir.core.records import BoolArray, FloatArray, Record, record
from eldir.design import Design
from eldir.engine.threads import worker_threads
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_calibration.report.sampled_motions import prediction_interval
from eldir_calibration.transfer.mujoco_walks import Fault, MujocoWalk, drawn_walk

_LONGEST = 120.0  # period of a gait [s]: as of a schedule
Progress = Callable[[str, float], None]
"""Called with the present step, and how many steps have been done since the last call."""


@record
class Extent(Record):
    """How much is simulated."""

    samples: Annotated[int, Field(ge=2)] = 8
    """Number of robots of each prediction, and of as many others in MuJoCo."""
    cycles: Annotated[int, Field(ge=1)] = 2
    """Number of cycles that count in MuJoCo, after one that does not; predictions count five."""
    phases: NonNegativeInt = 0
    """Number of other phases of each gait that are compared too."""
    seed: NonNegativeInt = 0
    """Random seed of the samples."""


@record
class TransferSettings(Extent):
    """How much is simulated, and with which springs."""

    springs: SpringParameters = field(default_factory=SpringParameters)
    """Mean of the springs."""


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
    chosen: bool
    """Whether this is the design's own gait; otherwise one of its other phases."""
    predicted: SampledWalks
    seeds: tuple[int, ...]
    """Seeds of the robots in MuJoCo."""
    mujoco: SampledWalks
    faults: tuple[Fault, ...]
    """Why a robot in MuJoCo did not walk (see `MujocoWalk`), empty if it did."""

    @property
    def tied(self) -> bool:
        """Whether ties make the prediction doubtful."""
        return self.predicted.tie_share > TIED

    @property
    def interval(self) -> tuple[float, float] | None:
        """Prediction interval for one more robot that stays upright [body lengths per five cycles]. None if
        fewer than two samples stay upright."""
        found = prediction_interval(self.predicted.displacement)
        return (found.low, found.high) if np.isfinite(found.low) else None

    @property
    def inside(self) -> BoolArray:
        """Whether each robot in MuJoCo does what was predicted, shape (n,): it walks within the interval, or
        it falls as at least one sample did."""
        walks = self.mujoco.displacement
        low, high = self.interval or (np.inf, -np.inf)
        falls = bool(self.predicted.fallen > 0)
        return np.where(np.isfinite(walks), (low <= walks) & (walks <= high), falls)

    @property
    def fault_counts(self) -> dict[str, int]:
        """How many robots in MuJoCo had each fault."""
        return dict(Counter(fault for fault in self.faults if fault))

    @property
    def means(self) -> tuple[float, float]:
        """Mean of all predicted robots and of all robots in MuJoCo, a fall counted as no motion [body lengths
        per five cycles]."""
        return _mean(self.predicted.displacement), _mean(self.mujoco.displacement)


def walking_design(
    file: str, springs: SpringParameters, say: Callable[[str], None] = lambda _: None
) -> WalkingDesign:
    """Read a design; without a gait of `eldir shortlist` it gets the best one of a screening.

    `say` is called with a word on what takes time. Raises `InputError` for a file that is no design, and for
    a design that does not stand in any phase.
    """
    design = Design.load(file)
    try:
        gait = gait_of(design)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    if gait is not None:
        if gait.period > _LONGEST:
            raise InputError(
                f"the gait of {file} is too slow",
                expected=f"a period of at most {_LONGEST:g} s",
                found=f"{gait.period:g} s",
            )
        return WalkingDesign(file, design, gait, False)
    say(f"all phases of {file}")
    found = screen([design.morphology], springs=springs)[0] if design.morphology.motors else None
    if found is None or found.gait is None or not np.isfinite(found.best):
        why = "no motor" if found is None else found.rejected or "it falls, folds or buckles a coil"
        raise InputError(f"{file} walks in no phase", code="design.no-walk", found=why, remedy="leave it out")
    return WalkingDesign(file, design, found.gait, True)


def other_phases(gait: Gait, count: int) -> list[Gait]:
    """`count` gaits whose motors heat at other times: motor k is later by k j / (`count` + 1) of a period in
    the j-th. None for a single motor, which has no other phases."""
    motors = np.arange(len(gait.phase))
    if len(motors) < 2:
        return []
    return [
        Gait(gait.period, (gait.phase + motors * j / (count + 1)) % 1.0, gait.duty, gait.method)
        for j in range(1, count + 1)
    ]


def steps(designs: Sequence[WalkingDesign], settings: TransferSettings) -> int:
    """How many steps `compare_walks` tells its progress for."""
    return sum(1 + _gaits(d, settings) * settings.samples for d in designs)


def compare_walks(
    designs: Sequence[WalkingDesign],
    settings: TransferSettings,
    progress: Progress = lambda _what, _done: None,
) -> list[ComparedWalk]:
    """Predict each design's walk from samples, and let as many other robots walk in MuJoCo.

    Every design has seeds of its own, from `settings.seed` + 1 on; the samples use `settings.seed` itself,
    so that no robot of one simulation occurs in the other.
    """
    found = []
    for number, one in enumerate(designs):
        body = one.design.morphology
        progress(f"predicting {one.file}", 0)
        gaits = [one.gait, *other_phases(one.gait, settings.phases)]
        robot = RobotParameters(BuiltParameters().with_hubs(), settings.springs)
        robots = NominalRobots(body, robot, one.design.ballast / 2)
        predicted = sampled_walks(robots, gaits, settings.samples, settings.seed)
        progress(f"MuJoCo: {one.file}", 1)
        seeds = first_seeds(number, settings)
        for k, (gait, walks) in enumerate(zip(gaits, predicted, strict=True)):
            there = []
            for found_walk in _side_by_side(one.design, gait, seeds, settings):
                there.append(found_walk)
                progress(f"MuJoCo: {one.file}", 1)
            mujoco = SampledWalks(np.array([walk.displacement for walk in there]))
            faults = tuple(walk.fault for walk in there)
            found.append(ComparedWalk(one.file, gait, k == 0, walks, seeds, mujoco, faults))
    return found


def _side_by_side(
    design: Design, gait: Gait, seeds: Sequence[int], settings: TransferSettings
) -> Iterator[MujocoWalk]:
    """Walks in MuJoCo, one in each thread: it computes without Python's lock. The order is that of the
    seeds."""
    ended = Event()
    with ThreadPoolExecutor(worker_threads()) as pool:
        try:
            yield from pool.map(
                lambda seed: drawn_walk(design, gait, seed, settings.springs, settings.cycles, ended), seeds
            )
        finally:  # after Ctrl-C nobody waits for the others
            ended.set()


def first_seeds(number: int, settings: TransferSettings) -> tuple[int, ...]:
    """Seeds of the robots of design `number` in MuJoCo."""
    first = settings.seed + 1 + number * settings.samples
    return tuple(range(first, first + settings.samples))


def _gaits(one: WalkingDesign, settings: TransferSettings) -> int:
    return 1 + len(other_phases(one.gait, settings.phases))


def _mean(walks: FloatArray) -> float:
    return float(np.where(np.isfinite(walks), walks, 0.0).mean())
