"""How well predicted walks transfer to another simulation, in four numbers and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.stats import spearmanr

from eldir.core.records import Record, Rounded, record
from eldir_calibration.transfer.transfer import ComparedWalk

Goal = Literal["spearman", "right_sign", "coverage", "mean_error"]
GOALS: dict[Goal, tuple[float, float]] = {
    "spearman": (0.9, 1.0),
    "right_sign": (0.95, 1.0),
    "coverage": (0.85, 0.99),
    "mean_error": (0.0, 0.1),
}
"""Goal of each number of an `Agreement`, from and to."""
_FEWEST = 3  # walks that can be ranked
_FEW = 10  # walks with which a rank correlation is still uncertain


Share = Annotated[float, Rounded(9, ge=0, le=1)]


@record
class Agreement(Record):
    """Agreement of some compared walks; unknown where there are too few: NaN, and null in a file."""

    walks: Annotated[int, Field(ge=0)]
    """Number of compared walks: designs with a gait."""
    spearman: Annotated[float, Rounded(9, ge=-1, le=1)]
    """Spearman's rank correlation of the mean walks."""
    right_sign: Share
    """Share of the walks whose mean goes in MuJoCo the way that was predicted."""
    coverage: Share
    """Share of the robots in MuJoCo that walk within the interval of their prediction, or fall where a sample
    fell too."""
    mean_error: Annotated[float, Rounded(9, ge=0)]
    """Mean absolute difference of the mean walks [body lengths per five cycles]."""

    @classmethod
    def of(cls, compared: Sequence[ComparedWalk]) -> Agreement:
        """The agreement of these walks; a fall counts as no motion in means."""
        if not compared:
            return cls(0, np.nan, np.nan, np.nan, np.nan)
        predicted, there = np.array([one.means for one in compared]).T
        ranked = len(compared) >= _FEWEST and np.ptp(predicted) > 0 and np.ptp(there) > 0
        return cls(
            len(compared),
            float(np.clip(spearmanr(predicted, there).statistic, -1.0, 1.0)) if ranked else np.nan,
            float((np.sign(predicted) == np.sign(there)).mean()),
            float(np.concatenate([one.inside for one in compared]).mean()),
            float(np.abs(predicted - there).mean()),
        )


@dataclass(frozen=True)
class TransferVerdict:
    """Agreement of all walks, and apart of those whose prediction ties make doubtful."""

    every: Agreement
    sure: Agreement
    """Walks that are not flagged as ties."""
    tied: Agreement
    """Walks that are."""

    @classmethod
    def of(cls, compared: Sequence[ComparedWalk]) -> TransferVerdict:
        """The verdict on these walks."""
        sure = [one for one in compared if not one.tied]
        tied = [one for one in compared if one.tied]
        return cls(Agreement.of(compared), Agreement.of(sure), Agreement.of(tied))

    @property
    def judged(self) -> dict[Goal, float]:
        """What is held against `GOALS`: direction and error of walks without ties, the rest of all walks."""
        every = self.every
        return {
            "spearman": every.spearman,
            "right_sign": self.sure.right_sign,
            "coverage": every.coverage,
            "mean_error": self.sure.mean_error,
        }

    @property
    def reached(self) -> dict[Goal, bool | None]:
        """Whether each goal was reached; None where the number is not known."""
        return {
            name: bool(GOALS[name][0] <= round(value, 9) <= GOALS[name][1]) if np.isfinite(value) else None
            for name, value in self.judged.items()
        }

    @property
    def in_words(self) -> list[str]:
        """The verdict, a sentence for each number."""
        every, sure, tied = self.every, self.sure, self.tied
        flagged = f", {tied.walks} of them flagged as ties" if tied.walks else ""
        said = [f"{every.walks} {'walk' if every.walks == 1 else 'walks'} compared{flagged}."]
        if np.isfinite(every.spearman):
            ranks = f"Order: Spearman's rank correlation of the mean walks is {every.spearman:.2f}"
            said.append(f"{ranks} ({self._goal('spearman', 'at least 0.9')}).")
        else:
            said.append(f"Order: no rank correlation; that takes {_FEWEST} different walks.")
        if sure.walks:
            right = round(sure.right_sign * sure.walks)
            way = f"Direction: {right} of {sure.walks} walks go the predicted way"
            goal = self._goal("right_sign", "at least 95 %")
            said.append(f"{way} ({goal}){self._of_ties}.")
        else:
            said.append("Direction: all walks are flagged as ties.")
        inside = f"Interval: {every.coverage:.0%} of the robots in MuJoCo walk within the 95 % interval"
        said.append(f"{inside} of their prediction ({self._goal('coverage', '85 to 99 %')}).")
        if sure.walks:
            error = f"Error: the mean walks differ by {sure.mean_error:.2f} body lengths per five cycles"
            others = f"; those flagged as ties by {tied.mean_error:.2f}" if tied.walks else ""
            said.append(f"{error} on average ({self._goal('mean_error', 'at most 0.1')}){others}.")
        else:
            said.append(f"Error: flagged as ties, the mean walks differ by {tied.mean_error:.2f} on average.")
        if every.walks < _FEW:
            said.append("These are few walks: compare more designs before you rely on the numbers.")
        return said

    @property
    def _of_ties(self) -> str:
        if not self.tied.walks:
            return ""
        right = round(self.tied.right_sign * self.tied.walks)
        return f"; of those flagged as ties {right} of {self.tied.walks}"

    def _goal(self, name: Goal, words: str) -> str:
        if self.judged[name] > GOALS[name][1] and name == "coverage":
            return f"goal: {words}; more means that the intervals are wide"
        return f"goal: {words}, {'reached' if self.reached[name] else 'missed'}"
