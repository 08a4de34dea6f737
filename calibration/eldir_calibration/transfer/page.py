"""The comparison of predictions with MuJoCo as files: one self-contained page, and every number in JSON."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from matplotlib.figure import Figure
from pydantic import Field

from eldir.built.gait import Gait
from eldir.built.samples import CONFIDENCE_LEVEL
from eldir.built.walking import MAX_TIE_SHARE
from eldir.core.files import new_folder, write_text
from eldir.core.pictures import new_axes, page_templates, png
from eldir.core.records import OMITTED, Array, BoolArray, FileRecord, FloatArray, Record, Rounded, record
from eldir.core.version import __version__
from eldir_calibration.transfer.compared_walks import (
    ComparedWalk,
    SimulationExtent,
    TransferConfig,
    WalkingDesign,
)
from eldir_calibration.transfer.mujoco_walks import WalkFault
from eldir_calibration.transfer.verdict import (
    GOALS,
    ExplainedWalk,
    Goal,
    Number,
    TransferAgreement,
    TransferVerdict,
)

# Okabe and Ito's palette; a form of its own for each kind, so that a grey print reads too.
_UNTIED_STYLE, _TIED_STYLE = ("#0072B2", "o"), ("#D55E00", "D")

Bounds = tuple[float, float]
Count = Annotated[int, Field(ge=0)]


@record
class SettingsNumbers(SimulationExtent):
    """How much was simulated, and with which springs."""

    OPTIONAL = SimulationExtent.OPTIONAL | {"current_limit_a", "rig_file", "rig_digest"}

    interval_probability: Annotated[float, Field(gt=0, lt=1)] = CONFIDENCE_LEVEL
    """Probability of the prediction's interval."""
    tied_above: Annotated[float, Field(ge=0, le=1)] = MAX_TIE_SHARE
    """A larger share of ties flags a prediction as doubtful."""
    current_limit_a: Annotated[float | None, OMITTED] = None
    """Current limit of the supply [A]."""
    rig_file: Annotated[str | None, OMITTED] = None
    """Name of the rig file that springs and tolerances are from; without it they are those of evolution."""
    rig_digest: Annotated[str | None, OMITTED] = None
    """SHA-256 of that file."""


@record
class VerdictRecord(Record):
    """How well the predictions transfer."""

    all: TransferAgreement
    """Agreement of all walks."""
    without_ties: TransferAgreement
    """Agreement of the walks whose prediction is not flagged as doubtful."""
    ties: TransferAgreement
    """Agreement of the walks whose prediction is flagged as doubtful."""
    goals: dict[Goal, Bounds]
    """Goal of each number, from and to: rank correlation of the mean walks; share of the walks that go the
    predicted way; share of the robots within the interval of their prediction; mean absolute difference of
    the mean walks [body lengths per five cycles]."""
    reached: dict[Goal, bool | None]
    """Whether each goal was reached; null: not known. Sign and error leave out walks with
    ties; the other goals count all walks."""
    in_words: Annotated[tuple[str, ...], Field(min_length=1)]
    """The verdict, a sentence for each number."""


@record
class ComparedDesign(Record):
    """A design that was compared."""

    file: str
    """Name of the design file."""
    body: str
    """Digest of the body."""
    gait_by_screening: bool
    """Whether the design file has no gait, so that all phases were tried."""


@record
class EngineWalkNumbers(Record):
    """The walk by eldir."""

    walks: tuple[Number, ...]
    """Each robot [body lengths per five cycles]; null: it fell, folded or buckled a coil."""
    mean: Number
    """Mean of all robots; a fall counts as no motion."""
    interval: tuple[Number, Number] | None
    """Mean +- t s sqrt(1 + 1/n) of the samples that stay upright; null if fewer than two do."""


@record
class InSpaceNumbers(Record):
    """How a robot in MuJoCo leaves its plane; null where the simulation fails."""

    yaw_deg: Number
    """Rotation about the vertical, to the back of the robot's first direction [degrees per five cycles]."""
    roll_deg: Number
    """Largest lean to either side [degrees]."""
    drift: Number
    """Motion to the back [body lengths per five cycles]."""


@record
class MujocoWalkNumbers(Record):
    """The walk in MuJoCo."""

    OPTIONAL = frozenset({"in_space"})
    """Keys that files of version 0.1.0 do not have."""

    seeds: tuple[Count, ...]
    """Random seed of each robot."""
    walks: tuple[Number, ...]
    """Each robot [body lengths per five cycles]; null: it fell, folded or buckled a coil."""
    mean: Number
    """Mean of all robots; a fall counts as no motion."""
    inside: Annotated[BoolArray, Array("?", None)]
    """Whether each robot does what was predicted."""
    faults: tuple[WalkFault, ...]
    """Why a robot did not walk; empty if it did."""
    in_space: Annotated[tuple[InSpaceNumbers, ...], Field(exclude_if=lambda value: not value)] = ()
    """How each robot leaves its plane; only with --dimensions 3."""


@record
class WalkNumbers(Record):
    """A walk in both simulations."""

    file: str
    """Name of the design file."""
    chosen: bool
    """The design's own gait; false: another phase."""
    gait: Gait
    """The gait of this walk."""
    tie_share: Annotated[float, Rounded(9, ge=0, le=1)]
    """Part of the feet's sliding in which both outer feet bear 45 to 55 % of the load; null: no sample stays
    upright."""
    tied: bool
    """Whether ties make the prediction doubtful."""
    predicted: EngineWalkNumbers
    """The walk by eldir."""
    mujoco: MujocoWalkNumbers
    """The walk in MuJoCo."""

    @classmethod
    def of(cls, one: ComparedWalk) -> WalkNumbers:
        """The numbers of one walk."""
        walks, there = one.predicted.displacement, one.mujoco.displacement
        return cls(
            one.file,
            one.is_own_gait,
            one.gait,
            one.predicted.tie_share,
            one.tied,
            EngineWalkNumbers(tuple(walks.tolist()), one.means[0], one.interval),
            MujocoWalkNumbers(
                one.seeds,
                tuple(there.tolist()),
                one.means[1],
                one.within_interval,
                one.faults,
                tuple(
                    InSpaceNumbers(math.degrees(w.yaw), math.degrees(w.roll), w.drift) for w in one.in_space
                ),
            ),
        )


@record
class ExplainedNumbers(ExplainedWalk):
    """Walks of one nominal robot, with feet and slope of a seed, and what they say."""

    in_words: str
    """What was found, as a sentence."""


@record
class TransferNumbers(FileRecord):
    """Every number of a transfer: predicted walks, and those of other robots in MuJoCo."""

    FORMAT = "eldir-transfer/1"

    engine: str
    """Program that predicted, with its version."""
    second_engine: str
    """MuJoCo with its version."""
    settings: SettingsNumbers
    """How much was simulated."""
    verdict: VerdictRecord
    """How well the predictions transfer."""
    designs: Annotated[tuple[ComparedDesign, ...], Field(min_length=1)]
    """The designs that were compared."""
    walks: Annotated[tuple[WalkNumbers, ...], Field(min_length=1)]
    """Each walk in both simulations."""
    explained: tuple[ExplainedNumbers, ...]
    """One nominal robot of each design, with feet and slope of its first seed; empty without --explain."""


@dataclass(frozen=True)
class TransferResult:
    """The content of the page."""

    designs: Sequence[WalkingDesign]
    compared: Sequence[ComparedWalk]
    explained: Sequence[ExplainedWalk]
    settings: TransferConfig
    engine: str
    """MuJoCo with its version."""

    @property
    def verdict(self) -> TransferVerdict:
        """How well the predictions transfer."""
        return TransferVerdict.of(self.compared)

    @property
    def numbers(self) -> TransferNumbers:
        """Every number; falls and unknown values are null in the file."""
        s, verdict = self.settings, self.verdict
        return TransferNumbers(
            f"eldir {__version__}",
            self.engine,
            SettingsNumbers(
                s.samples, s.cycles, s.phases, s.seed, s.dimensions,
                current_limit_a=s.springs.current_limit, rig_file=s.rig_file, rig_digest=s.rig_digest,
            ),
            VerdictRecord(
                verdict.all_walks, verdict.untied, verdict.tied, GOALS, verdict.reached,
                tuple(verdict.sentences),
            ),
            tuple(ComparedDesign(one.file, one.design.body, one.screened) for one in self.designs),
            tuple(map(WalkNumbers.of, self.compared)),
            tuple(
                ExplainedNumbers(**vars(e), in_words=e.finding) for e in self.explained
            ),
        )  # fmt: skip


def write_transfer(result: TransferResult, folder: Path) -> None:
    """Write `transfer.html` and `transfer.json` into a new folder, whole or not at all."""
    templates = page_templates(
        "eldir_calibration.transfer",
        number=_format_signed,
        share=lambda v: f"{v:.0%}" if math.isfinite(v) else "–",
        degrees=lambda v: f"{math.degrees(v):.0f}°" if math.isfinite(v) else "–",
    )
    page = templates.get_template("transfer.html").render(
        verdict=result.verdict,
        result=result,
        settings=result.settings,
        picture=base64.b64encode(png(draw_scatter(result.compared))).decode(),
        versions=f"eldir {__version__}, {result.engine}",
        tied_above=MAX_TIE_SHARE,
    )  # fmt: skip
    with new_folder(folder) as draft:
        write_text(draft / "transfer.html", page)
        result.numbers.save(draft / "transfer.json")


def draw_scatter(compared: Sequence[ComparedWalk]) -> Figure:
    """Predicted walks with their intervals against those of MuJoCo; walks that ties make doubtful have
    another form."""
    figure, axes = new_axes(
        5.8,
        5.6,
        xlabel="predicted (body lengths per five cycles)",
        ylabel="MuJoCo (body lengths per five cycles)",
    )
    named: set[bool] = set()
    for one in compared:
        there = _finite(one.mujoco.displacement)
        if not len(there) or not np.isfinite(one.predicted.mean):
            continue
        colour, form = _TIED_STYLE if one.tied else _UNTIED_STYLE
        name = "flagged as ties" if one.tied else "mean; bars: 95 % interval, and all robots"
        centre = one.predicted.mean
        axes.plot(np.full(len(there), centre), there, form, color=colour, ms=3, alpha=0.5)
        axes.plot([centre, centre], [there.min(), there.max()], "-", color=colour, lw=0.8, alpha=0.6)
        if one.interval is not None:
            axes.plot(one.interval, [there.mean()] * 2, "-", color=colour, lw=1.2, alpha=0.6)
        face = "white" if one.tied else colour
        label = None if one.tied in named else name
        axes.plot(centre, there.mean(), form, color=colour, mfc=face, ms=8, label=label)
        named.add(one.tied)
    low, high = _axis_limits(compared)
    axes.plot([low, high], [low, high], ":", color="#777777", lw=1, label="as predicted")
    for line in (axes.axhline, axes.axvline):
        line(0.0, color="#cccccc", lw=0.8, zorder=0)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.legend(frameon=False, loc="upper left")
    return figure


def _axis_limits(compared: Sequence[ComparedWalk]) -> tuple[float, float]:
    """Ends of both axes: all robots are seen; a wide interval would make them small, and is cut."""
    both = [walks.displacement for one in compared for walks in (one.predicted, one.mujoco)]
    walks = _finite(np.concatenate([*both, [0.0]]))
    room = 0.1 * max(float(np.ptp(walks)), 0.1)
    return float(walks.min()) - room, float(walks.max()) + room


def _finite(walks: FloatArray) -> FloatArray:
    return walks[np.isfinite(walks)]


def _format_signed(value: float) -> str:
    """Two digits with a sign; adding 0.0 takes the sign from a rounded minus zero."""
    return f"{round(value, 2) + 0.0:+.2f}" if math.isfinite(value) else "falls"
