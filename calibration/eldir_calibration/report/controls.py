"""What a filmed robot is compared with: control robots, and other bodies (the null comparison).

The profile of vertical ranges over m1 to m5 fits nearly any robot of that shape, so it is shown beside the
profiles of other bodies under the same schedule.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.robot import PrintedRobot, build
from eldir.core.records import FloatArray, IntArray, Record, Rounded, record
from eldir.design import MARKS, Design, marked_masses
from eldir.genotype import random_genotypes
from eldir.morphology import develop
from eldir.parameters.robot import RobotParameters
from eldir.trajectory import mean_known
from eldir_calibration.report.comparison import CycleMean, Motion, agreements
from eldir_calibration.report.verdict import RobotLoss

INTACT = "intact"
PAPER_DISPLACEMENTS = {INTACT: 0.8, "without a motor": 0.0, "without a motor, with ballast": -0.4}
"""Displacement of the paper's robot and its controls, in body lengths per five cycles."""
DIRECTIONS = ("horizontal", "vertical")
OTHER_COUNT = 5
"""How many other robots a report simulates: as many as it has time for."""
_SEED = 1


@dataclass(frozen=True)
class FilmedRun:
    """One log: the filmed motion and its prediction."""

    log: str
    """Name of the log file."""
    robot: str
    """`INTACT`, or how it differs from the design: a key of `PAPER_DISPLACEMENTS`, or in words."""
    detail: str
    """Detail, such as which motor is missing; empty for the intact robot."""
    tracked: Motion
    predicted: Motion
    fingerprint: str = ""
    """Identifies the log; empty if it was not read from a file."""
    loss: RobotLoss | None = field(default=None, kw_only=True)
    """When the robot fell or got out of sight; None where it did not."""
    film_error: float = field(default=0.0, kw_only=True)
    """By how much the filmed walk may be wrong because the robot left its plane [body lengths per five
    cycles]."""
    other_heating: str = field(default="", kw_only=True)
    """How it was heated otherwise than the first log, in words; empty if it was not."""

    @property
    def displacement(self) -> CycleMean:
        """Filmed displacement in body lengths per five cycles, with its interval over cycles, wider by the
        film's error."""
        return _with_error(CycleMean.of(self.tracked.displacements()), self.film_error)

    @property
    def predicted_displacement(self) -> float:
        """Predicted displacement of this robot under this schedule, in body lengths per five cycles."""
        return self.predicted.displacement()


def pool_displacements(runs: Sequence[FilmedRun]) -> dict[str, CycleMean]:
    """Filmed displacement of each kind of robot, in the order of the runs. With several runs, the interval is
    that of the runs' means: cycles of one run are alike, and their scatter shows nothing of other runs."""
    return {kind: _mean_over_runs(own) for kind, own in comparable_runs(runs).items()}


def comparable_runs(runs: Sequence[FilmedRun]) -> dict[str, list[FilmedRun]]:
    """The runs of each kind of robot that count together, in the order of the runs: those that were heated as
    the first log; of a kind without one the first run."""
    found: dict[str, list[FilmedRun]] = {}
    for kind in dict.fromkeys(run.robot for run in runs):
        own = [run for run in runs if run.robot == kind]
        found[kind] = [run for run in own if not run.other_heating] or own[:1]
    return found


def _mean_over_runs(runs: list[FilmedRun]) -> CycleMean:
    """Mean displacement of runs of one kind, without those that show no walk."""
    seen = [run for run in runs if np.isfinite(run.displacement.mean)]
    if len(seen) < 2:
        return (seen or runs)[0].displacement
    means = np.array([run.displacement.mean for run in seen])
    return _with_error(CycleMean.of(means), _mean([run.film_error for run in seen]))


def _with_error(mean: CycleMean, error: float) -> CycleMean:
    return CycleMean(mean.mean, mean.low - error, mean.high + error)


def summarise_controls(runs: Sequence[FilmedRun]) -> list[str]:
    """Sentences about the control robots: whether their intervals differ from the intact robot's. "In these
    runs", where the interval of one is only over cycles."""
    displacements, comparable = pool_displacements(runs), comparable_runs(runs)
    if INTACT not in displacements or len(displacements) == 1:
        return []
    counts = Counter(
        run.robot for own in comparable.values() for run in own if np.isfinite(run.displacement.mean)
    )
    sentences = []
    whole = displacements[INTACT]
    for kind, other in displacements.items():
        if kind == INTACT:
            continue
        walks = f"The robot {kind} walks {other.mean:+.2f}, the intact one {whole.mean:+.2f}: "
        if comparable[kind][0].other_heating:
            sentences.append(
                f"The robot {kind} was heated otherwise than the intact one, so their walks are not compared."
            )
        elif not np.isfinite([whole.low, other.low]).all():
            sentences.append(
                f"It is unknown whether the robot {kind} and the intact one walk differently: of one of them "
                "fewer than two cycles or runs show its walk."
            )
        elif other.high < whole.low or other.low > whole.high:
            scope = "" if min(counts[kind], counts[INTACT]) > 1 else " in these runs"
            sentences.append(f"{walks}they differ{scope}.")
        else:
            sentences.append(f"{walks}their intervals overlap, so these runs do not distinguish them.")
    return sentences


Number = Annotated[float, Rounded(9)]


@record
class OtherDesigns(Record):
    """Agreement of other bodies' motions with the camera's."""

    count: Annotated[int, Field(ge=0)]
    """Number of other bodies."""
    profile_correlation: dict[str, Number]
    """Correlation of the mean vertical ranges over the markers with the camera's, for each motion of the
    robot itself."""
    profile_correlation_of_others: tuple[Number, ...]
    """The same correlation for each other body."""
    correlation_of_others: dict[str, dict[str, Number]]
    """Mean absolute correlation of the other bodies with the camera over a mean cycle, for each marker and
    direction."""
    body_lengths_per_5_cycles_of_others: tuple[Number, ...]
    """Displacement of each other body [body lengths per five cycles]."""


def compare_with_others(own: dict[str, Motion], tracked: Motion, others: Sequence[Motion]) -> OtherDesigns:
    """Compare the camera with our own motions, such as simulated and predicted, and with `others`."""
    folded = tracked.by_phase()
    matches = [agreements(other.by_phase(), folded) for other in others]
    correlation = {
        name: {d: _mean([abs(match[k][d].correlation) for match in matches]) for d in DIRECTIONS}
        for k, name in enumerate(tracked.trajectory.names)
    }
    return OtherDesigns(
        len(others),
        {kind: _profile_correlation(motion, tracked) for kind, motion in own.items()},
        tuple(_profile_correlation(other, tracked) for other in others),
        correlation,
        tuple(other.displacement() for other in others),
    )


def _profile_correlation(motion: Motion, tracked: Motion) -> float:
    a, b = (mean_ranges(m) for m in (motion, tracked))
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 3 or np.ptp(a[good]) == 0 or np.ptp(b[good]) == 0:
        return float("nan")
    return float(np.corrcoef(a[good], b[good])[0, 1])


def mean_ranges(motion: Motion) -> FloatArray:
    """Vertical range of each mass, mean over the cycles in which it is known [m], shape (K,); NaN if it is in
    none."""
    return mean_known(motion.vertical_ranges(), axis=0)


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def sample_other_robots(
    design: Design, robot: RobotParameters | None = None
) -> list[tuple[PrintedRobot, IntArray]]:
    """Random printed robots, as in a first generation, of the same lattice with as many motors, and their
    markers; the same bodies for every report. `robot`: joints and springs of all of them, by default pins and
    the kit's springs."""
    rng = np.random.default_rng(_SEED)
    motors = design.morphology.motors
    robots: list[tuple[PrintedRobot, IntArray]] = []
    for _ in range(20):
        for genotype in random_genotypes(design.lattice, 4 * OTHER_COUNT, rng, motors):
            body = develop(design.lattice, genotype)
            marks = marked_masses(body)
            if body.motors == motors and len(marks) == MARKS and len(robots) < OTHER_COUNT:
                robots.append((build(body, robot), marks))
    return robots
