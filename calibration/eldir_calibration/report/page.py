"""The report: one self-contained HTML page, a PNG of each figure, and every number in JSON."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import Plot, draw_plots, page_templates, png
from eldir.core.records import BoolArray, FloatArray
from eldir.parameters.wiring import Wiring
from eldir_calibration.report import _figures as figures
from eldir_calibration.report.comparison import (
    MOTION_KINDS,
    NOT_COMPARABLE,
    Motion,
    MotionReport,
    best_lag,
    compare_motions,
)
from eldir_calibration.report.controls import (
    PAPER_DISPLACEMENTS,
    FilmedRun,
    OtherDesigns,
    comparable_runs,
    mean_ranges,
    pool_displacements,
    summarise_controls,
)
from eldir_calibration.report.numbers import (
    IdentificationGain,
    MassNumbers,
    OutOfPlaneNumbers,
    PredictionErrors,
    ReportNumbers,
    RunNumbers,
    VerdictNumbers,
    WiringNumbers,
    to_interval,
)
from eldir_calibration.report.verdict import (
    ComparedQuantity,
    ReportVerdict,
    SampledMotions,
    evaluate_prediction,
    with_sample_intervals,
)
from eldir_hardware.camera.plane import Image, Plane
from eldir_hardware.vision.tracking_quality import TrackingQuality

PAPER = {"simulated": 0.6, "tracked": 0.8}
"""Body lengths per five cycles of the paper's robot (Sect. Sim2Real)."""
_FRAME_CAPTION = "A frame of the log with the path that the tracker found for each mass"


@dataclass(frozen=True)
class HeatingRecord:
    """Contacts and temperatures in the log."""

    relay_times: FloatArray
    relays: BoolArray
    channels: tuple[str, ...]
    temperature_times: FloatArray
    temperatures: FloatArray
    springs: tuple[str, ...]
    max_temperature_c: float
    """Maximum temperature of a spring, from the rig file [C]."""


@dataclass(frozen=True)
class ReportInput:
    """The content of a report."""

    title: str
    simulated: Motion
    predicted: Motion
    tracked: Motion
    heating: HeatingRecord
    before: Motion | None = None
    """The prediction of the nominal robot, where `predicted` is of an identified one."""
    no_test: str = ""
    """Why an agreement would be no test; empty if it is one."""
    overlay: bytes | None = None
    """PNG of a frame with the tracks drawn in."""
    remarks: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)
    samples: SampledMotions | None = None
    """Motions of samples of the predicted robot."""
    runs: tuple[FilmedRun, ...] = ()
    """Every log, that of the three motions first."""
    others: OtherDesigns | None = None
    quality: TrackingQuality | None = None
    frame: Image | None = None
    """The frame of the first log at the start of the cycles that count."""
    plane: Plane | None = None
    film: bytes | None = None
    """WebM of the first log's cycles that count, with the predicted body over the camera's picture."""
    departure: OutOfPlaneNumbers | None = None
    """How far the robot was out of its plane; None if unknown."""
    wiring: Wiring = ()
    """Which relay channel heated which spring; empty if unknown."""

    @cached_property
    def verdict(self) -> ReportVerdict:
        """The main finding."""
        departure = self.departure
        error = 0.0 if departure is None else departure.certain_walk_error
        loss = self.runs[0].loss if self.runs else None
        return evaluate_prediction(
            self.predicted, self.tracked, self.samples, error, loss=loss, no_test=self.no_test
        )


def write_report(content: ReportInput, folder: Path) -> MotionReport:
    """Write `index.html`, `report.json` and the figures into a new folder, whole or not at all.

    Raises `InputError` where the folder exists, or where the motions are of different masses.
    """
    motions = dict(zip(MOTION_KINDS, (content.simulated, content.predicted, content.tracked), strict=True))
    report = compare_motions(*motions.values())
    if content.samples is not None:
        report = with_sample_intervals(report, content.verdict)
    gain = None
    if content.before is not None:
        gain = IdentificationGain(
            _prediction_errors(content.before, content.tracked),
            _prediction_errors(content.predicted, content.tracked),
        )
    lag = best_lag(content.simulated.by_phase(), content.tracked.by_phase())
    plots = _plots(content, motions, report, lag)
    drawn, left_out = draw_plots(plots)
    pictures = {name: (plots[name].caption, png(figure)) for name, figure in drawn.items()}
    if content.overlay is not None:
        pictures = {"frame": (_FRAME_CAPTION, content.overlay), **pictures}
    page = _render_page(content, report, pictures, left_out, gain)
    with new_folder(folder) as draft:
        write_text(draft / "index.html", page)
        _report_numbers(report, content, gain).save(draft / "report.json")
        for name, (_, data) in pictures.items():
            write_bytes(draft / f"{name}.png", data)
        if content.film is not None:
            write_bytes(draft / "film.webm", content.film)
    return report


def _render_page(
    content: ReportInput,
    report: MotionReport,
    pictures: dict[str, tuple[str, bytes]],
    left_out: list[str],
    gain: IdentificationGain | None,
) -> str:
    comparable = comparable_runs(content.runs)
    # Adding 0.0 takes the sign from a rounded minus zero.
    templates = page_templates(
        "eldir_calibration.report",
        percent=lambda v: f"{100 * v:.1f} %" if math.isfinite(v) else "–",
        mm=lambda v: f"{round(v * 1e3, 1) + 0.0:.1f}" if math.isfinite(v) else "unknown",
        number=lambda v: f"{round(v, 2) + 0.0:+.2f}" if math.isfinite(v) else "unknown",
        fine=lambda v: f"{round(v, 3) + 0.0:+.3f}" if math.isfinite(v) else "?",
    )
    return templates.get_template("report.html").render(
        title=content.title,
        report=report,
        verdict=content.verdict,
        scale=_headline_positions(content.verdict.walk),
        film=None if content.film is None else base64.b64encode(content.film).decode(),
        alternatives=figures.ALT_TEXTS,
        sampled=content.samples is not None,
        kinds=MOTION_KINDS,
        labels=figures.LABELS,
        not_comparable=NOT_COMPARABLE,
        paper=PAPER,
        warnings=[*report.warnings, *content.remarks],
        runs=content.runs,
        together={k: e for k, e in pool_displacements(content.runs).items() if len(comparable[k]) > 1},
        paper_runs=PAPER_DISPLACEMENTS,
        conclusions=summarise_controls(content.runs),
        others=content.others,
        quality=content.quality,
        departure=content.departure,
        pictures=[(n, c, base64.b64encode(b).decode()) for n, (c, b) in pictures.items()],
        left_out=left_out,
        provenance=content.provenance,
        gain=gain,
    )  # fmt: skip


def _headline_positions(walk: ComparedQuantity) -> dict[str, float] | None:
    """Places on the headline's axis, in hundredths of its width; None where there is no interval."""
    known = [walk.predicted.low, walk.predicted.high, walk.tracked.mean]
    if not np.isfinite(known).all():
        return None
    own = [v for v in (walk.tracked.low, walk.tracked.high) if math.isfinite(v)]
    low, high = min(0.0, *known, *own), max(0.0, *known, *own)
    low, high = low - 0.08 * (high - low), high + 0.08 * (high - low)
    places = {"zero": 0.0, "low": known[0], "high": known[1], "mean": walk.predicted.mean, "filmed": known[2]}
    places |= {"film_low": min(own, default=known[2]), "film_high": max(own, default=known[2])}
    return {name: round(100 * (v - low) / (high - low), 2) for name, v in places.items()}


def _plots(
    content: ReportInput, motions: dict[str, Motion], report: MotionReport, lag: int
) -> dict[str, Plot]:
    """The figures; those with nothing to draw say why."""
    seen = any(math.isfinite(mass.mean) for mass in report.ranges["tracked"])
    unseen = "" if seen else "vertical ranges, paths and heights: no marker was seen over a cycle"
    plots = {
        "ranges": Plot(
            "Vertical range of motion, mean and 95 % interval over cycles",
            partial(figures.draw_ranges, report),
            unseen,
        ),
        "advance": Plot("Forward motion of the marked masses", partial(figures.draw_advance, motions)),
    }
    if len(content.runs) > 1:
        plots["runs"] = Plot(
            "Each robot beside its prediction; camera with 95 % interval over cycles, or over the runs of a "
            "robot with several",
            partial(figures.draw_runs, content.runs),
        )
    if content.frame is not None and content.plane is not None:
        plots["cycles"] = Plot(
            "Mean cycles without the steady walk, on the frame at the start of the cycles that count. A ring "
            "marks phase zero. The learned cycle is stretched, and shifted to where it fits best",
            partial(figures.draw_cycles, content.frame, content.plane, motions, lag),
            unseen,
        )
    plots["paths"] = Plot(
        "Paths of the marked masses over the cycles that count", partial(figures.draw_paths, motions), unseen
    )
    plots["heights"] = Plot(
        "Height over a cycle, without its mean. Bands span all cycles. The learned cycle is "
        "stretched, and shifted to where it fits best",
        partial(figures.draw_heights, motions, lag),
        unseen,
    )
    if (others := content.others) is not None:
        own, alike = others.profile_correlation, others.profile_correlation_of_others
        plots["profiles"] = Plot(
            "Correlation of vertical-range profiles with the camera's, also for other bodies",
            partial(figures.draw_profiles, own, alike),
            "" if np.isfinite([*own.values(), *alike]).any() else "correlation of profiles: none is known",
        )
    heating, lacking = content.heating, []
    if not heating.relays.any():
        lacking.append("contacts")
    if not np.isfinite(heating.temperatures).any():
        lacking.append("temperatures")
    plots["heating"] = Plot(
        "The motion, the contacts as read back, and the modelled temperatures",
        partial(figures.draw_heating, content.tracked, **vars(heating)),
        f"motion and heating over time: the log has no {' and no '.join(lacking)}" if lacking else "",
    )
    return plots


def _report_numbers(
    report: MotionReport, content: ReportInput, gain: IdentificationGain | None
) -> ReportNumbers:
    """Every number of the report."""
    masses = {
        name: MassNumbers(
            {kind: report.ranges[kind][k].mean for kind in MOTION_KINDS},
            {kind: to_interval(report.ranges[kind][k]) for kind in MOTION_KINDS},
            {kind: report.ranges[kind][k].mean / report.body_length for kind in MOTION_KINDS},
            {kind: both[k] for kind, both in report.agreement.items()},
            float(report.visible_share[k]),
        )
        for k, name in enumerate(report.names)
    }
    runs = (
        RunNumbers(
            run.log, run.robot, run.detail, run.displacement.mean, to_interval(run.displacement),
            run.predicted_displacement, run.tracked.cycles, run.fingerprint or None, run.loss,
        )
        for run in content.runs
    )  # fmt: skip
    return ReportNumbers(
        VerdictNumbers.of(content.verdict),
        masses,
        report.displacement,
        {kind: to_interval(walked) for kind, walked in report.displacement_intervals.items()},
        PAPER,
        tuple(runs),
        content.others,
        content.quality,
        report.body_length,
        WiringNumbers.of(content.wiring) if content.wiring else None,
        (*report.warnings, *content.remarks),
        content.provenance,
        gain,
        content.departure,
    )


def _prediction_errors(motion: Motion, filmed: Motion) -> PredictionErrors:
    """A prediction compared with the camera."""
    tracked, ranges = mean_ranges(filmed), motion.vertical_ranges().mean(axis=0)
    difference = motion.by_phase() - filmed.by_phase()
    errors = np.abs(ranges - tracked)
    return PredictionErrors(
        dict(zip(filmed.trajectory.names, ranges.tolist(), strict=True)),
        float(np.nanmean(errors) / np.nanmean(tracked)),
        float(np.sqrt(np.nanmean(difference[..., 1] ** 2))),
        motion.displacement(),
    )
