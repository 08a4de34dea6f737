"""Options of an adaptation, and the records of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import Field

from eldir.built.gait import CYCLES
from eldir.built.samples import SAMPLES
from eldir.core.records import OMITTED, FileRecord, Record, record
from eldir_calibration.dynamics.belief import BeliefConfig
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG


@dataclass(frozen=True)
class AdaptationConfig:
    """Options of an adaptation."""

    runs: int = 5
    """Number of runs at most."""
    minutes: float | None = None
    """No run begins that would end later than this after the start [min]; None: no limit."""
    seed: int = 0
    """Random seed of beliefs and samples."""
    samples: int = SAMPLES
    """Sampled robots of each prediction."""
    cycles: int = CYCLES
    """Cycles of a run that count."""
    belief: BeliefConfig = field(default_factory=BeliefConfig)
    """Numbers of the beliefs."""
    min_gain: float = 0.05
    """A gait is tried if it is expected to improve the best filmed walk by this [body lengths per five
    cycles]."""


@record
class AdaptationRun(Record):
    """A run of an adaptation."""

    schedule: str
    """Path of its schedule in the folder."""
    log: str
    """Path of its log in the folder."""
    current_limit_a: float
    """Current limit of the supply in this run [A]."""
    predicted: float | None
    """Predicted walk before the run, samples that fall counted as no motion, less what the belief predicted
    too much for the runs before [body lengths per five cycles]; null if all samples fell."""
    deviation: float | None
    """Standard deviation of that prediction, with the error of the belief in the runs before
    [body lengths per five cycles]."""
    misfit: Annotated[float, Field(ge=0)] | None
    """Mean square of what the belief before this run leaves of the films, in assumed standard deviations;
    above 1 the robot moves as no simulated one does. null for the first run: nothing was filmed before."""
    filmed: float
    """Walk that was filmed [body lengths per five cycles]."""
    upright: bool
    """Whether the robot was seen upright to the end."""
    cycles: Annotated[Annotated[int, Field(ge=0)] | None, OMITTED] = None
    """Cycles in which the film shows the walk: fewer than the schedule's where the markers were lost; missing
    in older files."""
    impossible_motion: Annotated[str | None, OMITTED] = None
    """What the robot of a virtual rig did that a printed one cannot do; missing where nothing was seen."""
    lost_at_s: Annotated[Annotated[float, Field(ge=0)] | None, OMITTED] = None
    """When all markers vanished for good without a sign of a fall [s since the start of the run]: the robot
    fell, left the picture or was covered. Missing where they did not, and in older files."""

    @property
    def has_fallen(self) -> bool:
        """Whether the film shows a fall."""
        return not self.upright and self.lost_at_s is None


@record
class Fault(Record):
    """Why the robot does not walk, as a film shows it."""

    run: Annotated[int, Field(ge=1)]
    """Number of the run, from 1."""
    kind: Literal["fall", "supply", "motor", "cold", "stuck", "hot"]
    """fall: it falls; supply: it gives less current than it is set to; motor: one does nothing; cold: the
    springs use little of their stroke; stuck: a foot does not leave its place; hot: the springs get hotter
    than the rig file's limit."""
    text: str
    """What the film shows."""
    remedy: str
    """What to change."""
    lower_current_a: Annotated[Annotated[float, Field(gt=0)] | None, OMITTED] = None
    """For the kind "hot": the highest current limit of the supply with which the springs keep the rig file's
    limit in the same schedule [A]; missing where there is none, and in older files."""


@record
class SpringHeat(Record):
    """How hot the springs get in a run and how far they move, as believed after its film: the means over the
    robots that may be the filmed one, and their standard deviations."""

    peak_c: float
    """Highest temperature of a spring [C]."""
    peak_deviation_c: Annotated[float, Field(ge=0)]
    """Standard deviation of that temperature [K]."""
    stroke_used: Annotated[float, Field(ge=0)]
    """Used part of the stroke."""
    stroke_used_deviation: Annotated[float, Field(ge=0)]
    """Standard deviation of that part."""

    @property
    def peak_interval(self) -> tuple[float, float]:
        """95 % interval of the highest temperature [C]."""
        arm = DEFAULT_CONFIG.interval * self.peak_deviation_c
        return self.peak_c - arm, self.peak_c + arm


@record
class SupplyAdvice(Record):
    """A current limit with which the springs get more current than now, which needs narrower tolerances in
    the rig file, and its predicted walk."""

    current: float
    """Relative tolerance of the current."""
    ambient_min_c: float
    """Least temperature of the air around the springs [C]."""
    ambient_max_c: float
    """Highest temperature of the air around the springs [C]."""
    current_limit_a: float
    """Highest current limit of the supply with which the best schedule keeps the limits, also with the
    believed springs [A]."""
    predicted: float | None
    """Walk that the belief predicts for it [body lengths per five cycles]; null if all samples fall."""
    deviation: float | None
    """Standard deviation of that prediction, with the error of the belief in the filmed gaits [body lengths
    per five cycles]."""


@record
class Adaptation(FileRecord):
    """Runs of an adaptation, and the best of them. JSON "eldir-adaptation/1"."""

    FORMAT = "eldir-adaptation/1"
    OPTIONAL = frozenset({"faults", "heat"})

    runs: tuple[AdaptationRun, ...]
    """The runs, in the order in which they were made."""
    best: Annotated[int, Field(ge=1)] | None
    """Number of the run in which the robot walked farthest without a fall, from 1, of those with the present
    current limit and without springs above their limit; null if there is none. One in which it was lost only
    if there is no other."""
    ended: str
    """Why no further run was made; empty while runs are left."""
    advice: tuple[SupplyAdvice, ...] = ()
    """What a higher current would bring; empty while runs are left."""
    faults: tuple[Fault, ...] = ()
    """Why the robot does not walk, as the films show it; empty where they do not."""
    heat: SpringHeat | None = None
    """Heat of the springs in the last run; null before its film was read, and where the belief does not
    explain the films."""

    @property
    def stands_still(self) -> bool:
        """Whether the robot hardly moved in the last run, and the belief explains why."""
        return self.heat is None and any(f.kind == "cold" and f.run == len(self.runs) for f in self.faults)


def repeatable_runs(
    runs: Sequence[AdaptationRun], faults: Sequence[Fault], current_limit_a: float
) -> list[int]:
    """Numbers of the runs, from 1, whose walk can be had again with this current limit of the supply: those
    with the same one, and without springs above their limit."""
    hot = {fault.run for fault in faults if fault.kind == "hot"}
    return [
        number
        for number, run in enumerate(runs, start=1)
        if run.current_limit_a == current_limit_a and number not in hot
    ]


def best_run(runs: Sequence[AdaptationRun], faults: Sequence[Fault], current_limit_a: float) -> int | None:
    """Number of the repeatable run in which the robot walked farthest without a fall, from 1. A run in which
    it was lost comes after all in which it was not."""
    counted = [n for n in repeatable_runs(runs, faults, current_limit_a) if not runs[n - 1].has_fallen]
    return max(counted, key=lambda n: (runs[n - 1].upright, runs[n - 1].filmed), default=None)
