"""Runs side by side: the robot as designed, without one motor, and that robot with ballast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.report.comparison import CycleMean, Motion

INTACT = "intact"
PAPER = {INTACT: 0.8, "without a motor": 0.0, "without a motor, with ballast": -0.4}
"""What the paper's robot and its controls walked, in body lengths per five cycles."""


@dataclass(frozen=True)
class FilmedRun:
    """One log."""

    log: str
    """Its file's name."""
    robot: str
    """`INTACT`, or how it differs from the design: a key of `PAPER`, or in words."""
    detail: str
    """Such as which motor is missing; empty for the intact robot."""
    tracked: Motion
    predicted: Motion

    @property
    def walked(self) -> CycleMean:
        """Body lengths per five cycles as filmed, over its cycles."""
        return CycleMean.of(self.tracked.displacements())

    @property
    def expected(self) -> float:
        """Body lengths per five cycles as predicted for this very robot and schedule."""
        return self.predicted.displacement()


def pooled(runs: Sequence[FilmedRun]) -> dict[str, CycleMean]:
    """Of each kind of robot, over the cycles of all its runs, in the order in which they come."""
    kinds = dict.fromkeys(run.robot for run in runs)
    return {
        kind: CycleMean.of(np.concatenate([r.tracked.displacements() for r in runs if r.robot == kind]))
        for kind in kinds
    }


def conclusions(runs: Sequence[FilmedRun]) -> list[str]:
    """What the controls say, where there are any: a motor matters only if the robot walks less without it."""
    walked = pooled(runs)
    if INTACT not in walked or len(walked) == 1:
        return []
    said = []
    whole = walked[INTACT]
    for kind, other in walked.items():
        if kind == INTACT:
            continue
        if np.isfinite([whole.low, whole.high, other.low, other.high]).all() and (
            other.high < whole.low or other.low > whole.high
        ):
            said.append(f"The robot {kind} walks {other.mean:+.2f}, the intact one {whole.mean:+.2f}: apart.")
        else:
            said.append(
                f"The robot {kind} walks {other.mean:+.2f}, the intact one {whole.mean:+.2f}: their "
                "intervals overlap, so these runs do not tell them apart."
            )
    return said
