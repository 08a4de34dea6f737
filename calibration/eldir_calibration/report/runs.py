"""Runs side by side: the robot as designed, without one motor, and without one motor with ballast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldir_calibration.report.comparison import CycleMean, Motion

INTACT = "intact"
PAPER = {INTACT: 0.8, "without a motor": 0.0, "without a motor, with ballast": -0.4}
"""Displacement of the paper's robot and its controls, in body lengths per five cycles."""


@dataclass(frozen=True)
class FilmedRun:
    """One log: the filmed motion and its prediction."""

    log: str
    """Name of the log file."""
    robot: str
    """`INTACT`, or how it differs from the design: a key of `PAPER`, or in words."""
    detail: str
    """Detail, such as which motor is missing; empty for the intact robot."""
    tracked: Motion
    predicted: Motion
    fingerprint: str = ""
    """Tells the log from others; empty if it was not read from a file."""

    @property
    def walked(self) -> CycleMean:
        """Filmed displacement in body lengths per five cycles, with its interval over cycles."""
        return CycleMean.of(self.tracked.displacements())

    @property
    def expected(self) -> float:
        """Predicted displacement of this robot under this schedule, in body lengths per five cycles."""
        return self.predicted.displacement()


def pooled(runs: Sequence[FilmedRun]) -> dict[str, CycleMean]:
    """Filmed displacement of each kind of robot over the cycles of all its runs, in the order of the runs."""
    kinds = dict.fromkeys(run.robot for run in runs)
    return {
        kind: CycleMean.of(np.concatenate([r.tracked.displacements() for r in runs if r.robot == kind]))
        for kind in kinds
    }


def conclusions(runs: Sequence[FilmedRun]) -> list[str]:
    """Sentences about the control robots: whether their intervals differ from the intact robot's."""
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
            said.append(
                f"The robot {kind} walks {other.mean:+.2f}, the intact one {whole.mean:+.2f}: they differ."
            )
        else:
            said.append(
                f"The robot {kind} walks {other.mean:+.2f}, the intact one {whole.mean:+.2f}: their "
                "intervals overlap, so these runs do not distinguish them."
            )
    return said
