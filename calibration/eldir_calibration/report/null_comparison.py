"""Null comparison: the same comparison with other robots than the filmed one.

The profile of vertical ranges over m1 to m5 fits nearly any robot of that shape, so it is shown beside the
profiles of other bodies under the same schedule.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.robot import BuiltRobot, build
from eldir.core.records import FloatArray, IntArray, Record, Rounded, record
from eldir.design import Design
from eldir.genotype import random_genotypes
from eldir.marks import MARKS, marked_masses
from eldir.morphology import develop
from eldir_calibration.report.comparison import Motion, agreements

DIRECTIONS = ("horizontal", "vertical")


Number = Annotated[float, Rounded(9)]
OTHERS = 5
"""How many other robots a report simulates: as many as it has time for."""
_SEED = 1


@record
class OtherDesigns(Record):
    """Agreement of other bodies' motions with the camera's."""

    count: Annotated[int, Field(ge=0)]
    """Number of other bodies."""
    profile_correlation: dict[str, Number]
    """Correlation of the mean vertical ranges over the marks with the camera's, for each motion of the robot
    itself."""
    profile_correlation_of_others: tuple[Number, ...]
    """The same correlation for each other body."""
    correlation_of_others: dict[str, dict[str, Number]]
    """Mean absolute correlation of the other bodies with the camera over a mean cycle, for each mark and
    direction."""
    body_lengths_per_5_cycles_of_others: tuple[Number, ...]
    """Displacement of each other body [body lengths per five cycles]."""


def against_others(own: dict[str, Motion], tracked: Motion, others: Sequence[Motion]) -> OtherDesigns:
    """Compare the camera with our own motions, such as simulated and predicted, and with `others`."""
    folded = tracked.by_phase()
    matches = [agreements(other.by_phase(), folded) for other in others]
    correlation = {
        name: {d: _mean([abs(match[k][d].correlation) for match in matches]) for d in DIRECTIONS}
        for k, name in enumerate(tracked.trajectory.names)
    }
    return OtherDesigns(
        len(others),
        {kind: _profile(motion, tracked) for kind, motion in own.items()},
        tuple(_profile(other, tracked) for other in others),
        correlation,
        tuple(other.displacement() for other in others),
    )


def _profile(motion: Motion, tracked: Motion) -> float:
    a, b = (_ranges(m) for m in (motion, tracked))
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < 3 or np.ptp(a[good]) == 0 or np.ptp(b[good]) == 0:
        return float("nan")
    return float(np.corrcoef(a[good], b[good])[0, 1])


def _ranges(motion: Motion) -> FloatArray:
    ranges = motion.vertical_ranges()
    some = np.isfinite(ranges).any(axis=0)
    means = np.full(ranges.shape[1], np.nan)
    means[some] = np.nanmean(ranges[:, some], axis=0)
    return means


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def other_robots(design: Design) -> list[tuple[BuiltRobot, IntArray]]:
    """Built random robots, as in a first generation, of the same lattice with as many motors, and their
    marks; the same for every report."""
    rng = np.random.default_rng(_SEED)
    motors = design.morphology.motors
    found: list[tuple[BuiltRobot, IntArray]] = []
    for _ in range(20):
        for genotype in random_genotypes(design.lattice, 4 * OTHERS, rng, motors):
            body = develop(design.lattice, genotype)
            marks = marked_masses(body)
            if body.motors == motors and len(marks) == MARKS and len(found) < OTHERS:
                found.append((build(body), marks))
    return found
