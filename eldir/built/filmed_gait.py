"""Filmed gaits: gaits that a robot was driven with, and the displacement that the camera measured."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field

from eldir.built.gait import Gait
from eldir.core.records import Array, FloatArray, Record, record

_SAME = 1e-4  # of a period: schedules are rounded to milliseconds
_WALK = 0.1  # body lengths per five cycles: less counts as standing still


@record
class FilmedGait(Record):
    """A gait, and the walk that was filmed with it."""

    log: str
    """File name of the log."""
    period_s: Annotated[float, Field(gt=0)]
    """Period of the gait [s]."""
    phase: Annotated[FloatArray, Array("f8", None)]
    """Start of heating of each motor, as a part of the period."""
    duty: Annotated[FloatArray, Array("f8", None)]
    """Duration of heating of each motor, as a part of the period."""
    cycles: Annotated[int, Field(ge=1)]
    """Number of complete cycles in the film."""
    walked: Annotated[float, Field(alias="body_lengths_per_5_cycles")]
    """Displacement that the camera measured [body lengths per five cycles]."""
    upright: bool
    """Whether the robot stayed upright: its marks were rotated by more than 45 degrees for less than a second
    in all."""

    def __post_init__(self) -> None:
        _ = self.gait  # which refuses what is no gait

    @classmethod
    def of(cls, gait: Gait, walked: float, upright: bool, cycles: int, log: str) -> FilmedGait:
        """The film of a gait."""
        return cls(log, gait.period, gait.phase, gait.duty, cycles, walked, upright)

    @cached_property
    def gait(self) -> Gait:
        """The gait that was filmed."""
        return Gait(self.period_s, self.phase, self.duty)

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
