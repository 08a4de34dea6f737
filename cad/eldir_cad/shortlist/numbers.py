"""Every number of a ranking: the file ranking.json."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeInt

from eldir.built.gait import CYCLES, Gait
from eldir.built.robot import build
from eldir.built.samples import SampledWalks
from eldir.built.walking import TIED
from eldir.core.records import OMITTED, FileRecord, Record, record
from eldir_cad.checks.violations import BuildReport
from eldir_cad.shortlist.ranking import RankedDesign

Share = Annotated[float, Field(ge=0, le=1)]


@record
class WalkStatistics(Record):
    """Walks of sampled robots in this gait [body lengths per five cycles]."""

    samples: NonNegativeInt
    """Number of simulated robots."""
    fell: NonNegativeInt
    """Number of them that fall over."""
    expected: float | None
    """Mean walk of all samples, a fall counted as 0; null if all fall."""
    standard_error: float | None
    """Standard error of the expected walk."""
    mm_per_cycle: float | None
    """The expected walk of one cycle [mm]."""
    mm_per_minute: float | None
    """The expected walk of one minute [mm]."""
    mean: float | None
    """Mean walk of the samples that stay upright; null if all fall."""
    standard_deviation: float | None
    """Standard deviation of the walks of the samples that stay upright; null if fewer than two do."""
    probability_forward: Share
    """Share of all samples that stay upright and go forward."""
    tie_share: Share | None
    """Part of the feet's sliding in which both outer feet bear 45 to 55 % of the load."""

    @classmethod
    def of(cls, spread: SampledWalks, body_length: float, period: float) -> WalkStatistics:
        """Of a robot's samples; lengths in metres, the period in seconds."""
        samples, upright = len(spread.displacement), int(np.isfinite(spread.displacement).sum())
        cycle = 1e3 * spread.expected * body_length / CYCLES
        return cls(
            samples,
            samples - upright,
            spread.expected if upright else None,
            spread.error if upright else None,
            cycle if upright else None,
            cycle * 60.0 / period if upright else None,
            spread.mean if upright else None,
            spread.spread if upright > 1 else None,
            spread.probability_forward,
            spread.tie_share if np.isfinite(spread.tie_share) else None,
        )

    def __str__(self) -> str:
        """Expected walk with its standard error, falls, and the walk of a minute."""
        if self.expected is None:
            return "all samples fall over"
        fell = f", {self.fell} of {self.samples} fall over" if self.fell else ""
        walk = f"{self.expected:+.2f} ± {self.standard_error:.2f} body lengths in 5 cycles"
        tied = self.tie_share is not None and self.tie_share > TIED
        ties = f", doubtful: ties {self.tie_share:.0%}" if tied else ""
        return f"{walk} ({self.mm_per_minute:.0f} mm a minute){fell}{ties}"

    @property
    def forward(self) -> str:
        """How many samples go forward, in words."""
        return f"forward in {self.probability_forward:.0%} of {self.samples} samples"


@record
class RankedPrediction(Record):
    """Predictions of the models."""

    body_lengths_per_5_cycles: float | None
    """Walk in the screening, with nominal parameters [body lengths per five cycles]; null if it falls."""
    sampled_walks: WalkStatistics
    """Walks of sampled robots in this gait [body lengths per five cycles]."""
    static_margin_mm: float
    """Distance of the centre of mass from the edge of the feet [mm]."""

    @classmethod
    def of(cls, ranked: RankedDesign) -> RankedPrediction:
        """What is predicted for a ranked design."""
        length = build(ranked.design.morphology).body_length
        walks = WalkStatistics.of(ranked.spread, length, ranked.gait.period)
        best = ranked.screened.best
        return cls(best if np.isfinite(best) else None, walks, 1e3 * ranked.screened.margin)


@record
class RankingRow(Record):
    """A design of the shortlist."""

    OPTIONAL = frozenset({"id", "generation", "fitness_m"})

    file: str
    """Name of the design file."""
    id: Annotated[NonNegativeInt | None, OMITTED]
    """Number of the robot in its run."""
    generation: Annotated[NonNegativeInt | None, OMITTED]
    """Generation in which the robot was born."""
    fitness_m: Annotated[float | None, OMITTED]
    """Fitness of the robot in its run [m]."""
    gait: Gait
    """The gait for which the walk is predicted."""
    predicted: RankedPrediction
    """Predictions of the models."""
    build_report: BuildReport
    """Findings of the build filter."""

    @classmethod
    def of(cls, file: str, ranked: RankedDesign) -> RankingRow:
        """The row of a ranked design."""
        of = ranked.design.provenance.get
        predicted = RankedPrediction.of(ranked)
        return cls(file, of("id"), of("generation"), of("fitness_m"), ranked.gait, predicted, ranked.report)


@record
class Ranking(FileRecord):
    """Format 2 has predicted.sampled_walks.samples. Format 1 called them predicted.ensemble.builds; the
    values are the same."""

    FORMAT = "eldir-ranking/3"

    considered: NonNegativeInt
    """Number of different bodies in the run."""
    left_out: dict[str, NonNegativeInt]
    """Number of designs that each reason rejected, the most frequent reason first."""
    designs: Annotated[tuple[RankingRow, ...], Field(min_length=1)]
    """The designs of the shortlist, best first."""
