"""A shortlist as files: the designs with their predictions, ranking.json, and pictures side by side."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydantic import Field, NonNegativeInt

from eldir.built.gait import CYCLES, Gait
from eldir.built.ground import begin_on
from eldir.built.robot import build
from eldir.built.samples import SampledWalks
from eldir.built.walking import MAX_TIE_SHARE
from eldir.core.files import new_folder, write_bytes
from eldir.core.pictures import MARK, MOTOR, png
from eldir.core.records import OMITTED, FileRecord, Record, record
from eldir.design import marked_masses
from eldir.morphology import Morphology
from eldir_cad.checks.kinematics import find_hinges
from eldir_cad.checks.lateral_stability import LateralStability
from eldir_cad.checks.violations import BuildReport
from eldir_cad.shortlist.ranking import MAX_SIMILARITY, RankedDesign, Shortlist, spring_overlap

Share = Annotated[float, Field(ge=0, le=1)]
_TITLE_WIDTH = 72  # of a robot's title in the picture [characters]


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
    """Share of the feet's sliding in which both outer feet carry 45 to 55 % of the load."""

    @classmethod
    def of(cls, spread: SampledWalks, body_length: float, period: float) -> WalkStatistics:
        """Statistics of a robot's samples; lengths in metres, the period in seconds."""
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
        """Expected walk with its standard error, the walk of a minute, and falls."""
        if self.expected is None:
            return "all samples fall over"
        fell = f", {self.fell} of {self.samples} fall over" if self.fell else ""
        walk = f"{self.expected:+.2f} body lengths in 5 cycles"
        tied = self.tie_share is not None and self.tie_share > MAX_TIE_SHARE
        ties = f", doubtful: which foot slips is open in {self.tie_share:.0%} of the sliding" if tied else ""
        error, pace = f"standard error {self.standard_error:.2f}", f"{self.mm_per_minute:.0f} mm a minute"
        return f"{walk} ({error}; {pace}){fell}{ties}"

    @property
    def forward(self) -> str:
        """How many samples go forward, in words."""
        return f"forward in {self.probability_forward:.0%} of {self.samples} samples"


@record
class RankedPrediction(Record):
    """Predictions of the models."""

    OPTIONAL = frozenset({"lateral_stability"})

    body_lengths_per_5_cycles: float | None
    """Walk in the screening, with nominal parameters [body lengths per five cycles]; null if it falls."""
    sampled_walks: WalkStatistics
    """Walks of sampled robots in this gait [body lengths per five cycles]."""
    static_margin_mm: float
    """Distance of the centre of mass from the edge of the feet [mm]."""
    lateral_stability: Annotated[LateralStability | None, OMITTED] = None
    """How far it leans if its faces are heated unlike; left out on a terrain and for clamped strips."""

    @classmethod
    def of(cls, ranked: RankedDesign) -> RankedPrediction:
        """The predictions for a ranked design."""
        length = build(ranked.design.morphology).body_length
        walks = WalkStatistics.of(ranked.spread, length, ranked.gait.period)
        best = ranked.screened.best
        return cls(best if np.isfinite(best) else None, walks, 1e3 * ranked.screened.margin, ranked.lateral)


@record
class RankingRow(Record):
    """A design of the shortlist."""

    OPTIONAL = frozenset(
        {"id", "generation", "fitness_m", "same_body_as", "most_similar_to", "spring_overlap"}
    )

    file: str
    """Name of the design file."""
    body: str
    """Name of the body, from its springs and motors: equal for the same body in any run, up to a shift and a
    mirror image."""
    same_body_as: Annotated[str | None, OMITTED]
    """File of a better design with the same springs and motors."""
    most_similar_to: Annotated[str | None, OMITTED]
    """File of the better design with most springs in common; the first design has none."""
    spring_overlap: Annotated[Share | None, OMITTED]
    """Springs in common with it, as a share of all springs of both; 1 if only motors differ, or nothing."""
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
    def of(cls, file: str, ranked: RankedDesign, better: Mapping[str, Morphology]) -> RankingRow:
        """The row of a ranked design. `better`: bodies of the designs before it, by their files."""
        known, body = ranked.design.provenance.get, ranked.design.morphology
        same_body = next((name for name, one in better.items() if one.body_key == body.body_key), None)
        shared = {name: spring_overlap(body, one) for name, one in better.items()}
        similar = max(shared, key=shared.__getitem__, default=None)
        return cls(
            file,
            body.body_name,
            same_body,
            similar,
            None if similar is None else shared[similar],
            known("id"),
            known("generation"),
            known("fitness_m"),
            ranked.gait,
            RankedPrediction.of(ranked),
            ranked.report,
        )

    @property
    def likeness(self) -> str:
        """Which better design has the same or a similar body, in words; empty if none has."""
        if self.same_body_as:
            return f"same body as {self.same_body_as}"
        if self.spring_overlap is None or self.spring_overlap <= MAX_SIMILARITY:
            return ""
        if self.spring_overlap == 1:
            return f"other motors in the springs of {self.most_similar_to}"
        return f"{self.spring_overlap:.0%} of the springs of {self.most_similar_to}"


@record
class Ranking(FileRecord):
    """Format 2 has predicted.sampled_walks.samples. Format 1 called them predicted.ensemble.builds; the
    values are the same."""

    FORMAT = "eldir-ranking/3"

    considered: NonNegativeInt
    """Number of different bodies in the run, mirror images apart."""
    left_out: dict[str, NonNegativeInt]
    """Number of designs that each reason rejected, the most frequent reason first."""
    designs: Annotated[tuple[RankingRow, ...], Field(min_length=1)]
    """The designs of the shortlist, best first."""


def write_shortlist(shortlist: Shortlist, out: Path) -> tuple[RankingRow, ...]:
    """Write design files, best first, `ranking.json` and pictures side by side. Returns the rows of the
    ranking.

    Raises `EldirError` if no design is left.
    """
    shortlist.require_candidates(
        "evolve more, with --objective printed, or with --lattice 6x11 --max-motors 2 --static-margin 20 "
        "--buildable"
    )
    rows: tuple[RankingRow, ...] = ()
    better: dict[str, Morphology] = {}
    with new_folder(out) as folder:
        for number, candidate in enumerate(shortlist.candidates, start=1):
            name = f"design_{number:02d}.json"
            rows += (row := RankingRow.of(name, candidate, better),)
            d = candidate.design
            better[name] = d.morphology
            predicted = {"gait": row.gait.to_json(), "predicted": row.predicted.to_json()}
            replace(d, provenance=d.provenance | predicted).save(folder / name)
        Ranking(shortlist.considered, shortlist.left_out, rows).save(folder / "ranking.json")
        write_bytes(folder / "shortlist.png", png(draw_designs(shortlist.candidates, rows)))
    return rows


def draw_designs(candidates: Sequence[RankedDesign], rows: Sequence[RankingRow]) -> Figure:
    """The bodies side by side with their predictions, from the rows of the ranking."""
    columns = min(len(candidates), 3)
    lines = -(-len(candidates) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.9 * lines), layout="constrained")
    # All at the same scale, each centred where it begins on its ground.
    robots = [build(c.design.morphology) for c in candidates]
    width = max(r.body_length for r in robots)
    begins = [
        begin_on(r, c.design.printed_terrain, (1.1 * width - r.body_length) / 2)
        for r, c in zip(robots, candidates, strict=True)
    ]
    height = max(places[:, 1].max() - surface[:, 1].min() for places, surface in begins)
    for i, (candidate, row) in enumerate(zip(candidates, rows, strict=True)):
        axes = figure.add_subplot(lines, columns, i + 1)
        body, (positions, surface) = candidate.design.morphology, begins[i]
        ends = positions[body.springs]
        axes.add_collection(LineCollection(list(ends[~body.active]), colors="#777777", linewidths=1.2))
        axes.add_collection(LineCollection(list(ends[body.active]), colors=MOTOR, linewidths=3.5))
        x, y = positions[marked_masses(body)].T
        axes.plot(*positions.T, "o", color="black", markersize=3)
        axes.plot(x, y, "o", color=MARK, markersize=6)
        joints = positions[[h.mass for h in find_hinges(body)]].reshape(-1, 2).T
        axes.plot(*joints, "o", mfc="none", mec="black", markersize=9)
        axes.plot(*surface.T, color="#bbbbbb", linewidth=0.8, zorder=0)
        bottom = surface[:, 1].min()
        axes.set_xlim(surface[0, 0], surface[-1, 0])
        axes.set_ylim(bottom - 0.02, bottom + 1.05 * height)
        axes.set_aspect("equal")
        axes.axis("off")
        walks = row.predicted.sampled_walks
        lateral = str(row.predicted.lateral_stability or "")
        parts = [f"{Path(row.file).stem}: {walks}", walks.forward, lateral, row.likeness]
        title = "\n".join(textwrap.fill(part, _TITLE_WIDTH) for part in parts if part)
        axes.set_title(title, fontsize=8)
    handles = [
        Line2D([], [], color=MOTOR, label="motor"),
        Line2D([], [], color=MARK, marker="o", ls="", label="m1 to m5"),
        Line2D([], [], color="black", marker="o", mfc="none", ls="", label="hinge"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8)
    return figure
