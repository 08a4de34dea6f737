"""Filmed gaits: gaits that a robot was driven with, and the displacement that the camera measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eldir.built.gait import Gait
from eldir.core.records import Record

_SAME = 1e-4  # of a period: schedules are rounded to milliseconds
_WALK = 0.1  # body lengths per five cycles: less counts as standing still


@dataclass(frozen=True, eq=False)
class FilmedGait(Record):
    """A gait, and the walk that was filmed with it."""

    gait: Gait
    walked: float
    """Displacement that the camera measured [body lengths per five cycles]."""
    upright: bool
    """Whether the robot stayed upright."""
    cycles: int
    """Number of cycles in the film."""
    log: str
    """File name of the log."""

    @property
    def walks(self) -> bool:
        """Whether the robot went forward without a fall."""
        return self.upright and self.walked >= _WALK

    @property
    def in_words(self) -> str:
        """The measured displacement, as a sentence for the user."""
        how = f"{self.walked:+.2f} body lengths per five cycles"
        return f"{how}, upright" if self.upright else f"{how}, and it fell"

    def is_of(self, gait: Gait) -> bool:
        """Whether the film shows this gait, up to the rounding of a schedule."""
        mine, other = (
            np.concatenate([[1e-3 * g.period], (g.phase + 0.5 * _SAME) % 1, g.duty])
            for g in (self.gait, gait)
        )
        return bool(np.allclose(mine, other, rtol=0, atol=_SAME))

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        return {
            "log": self.log,
            "period_s": self.gait.period,
            "phase": self.gait.phase.tolist(),
            "duty": self.gait.duty.tolist(),
            "cycles": self.cycles,
            "body_lengths_per_5_cycles": self.walked,
            "upright": self.upright,
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> FilmedGait:
        """The inverse of `to_json`."""
        gait = Gait(float(values["period_s"]), values["phase"], values["duty"])
        walked, upright = float(values["body_lengths_per_5_cycles"]), values["upright"] is True
        return cls(gait, walked, upright, int(values["cycles"]), str(values["log"]))
