"""The report: one self-contained HTML page, a PNG of each figure, and every number in JSON."""

from __future__ import annotations

import base64
import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from calibration import figures
from calibration.comparison import KINDS, Motion, MotionReport, best_lag, compare
from eldir.files import new_folder, write_bytes, write_text
from eldir.frozen import BoolArray, FloatArray

FORMAT = "eldir-report/1"
PAPER = {"simulated": 0.6, "tracked": 0.8}
"""Body lengths per five cycles of the paper's robot (Sect. Sim2Real)."""


@dataclass(frozen=True)
class Heating:
    """What the log says of contacts and temperatures."""

    relay_times: FloatArray
    relays: BoolArray
    channels: tuple[str, ...]
    temperature_times: FloatArray
    temperatures: FloatArray
    springs: tuple[str, ...]


@dataclass(frozen=True)
class ReportInput:
    """All that a report shows."""

    title: str
    simulated: Motion
    predicted: Motion
    tracked: Motion
    heating: Heating
    overlay: bytes | None = None
    """PNG of a frame with the tracks drawn in."""
    remarks: tuple[str, ...] = ()
    provenance: dict[str, Any] = field(default_factory=dict)


def write_report(content: ReportInput, folder: Path) -> MotionReport:
    """Write `index.html`, `report.json` and the figures into a new folder, whole or not at all."""
    motions = dict(zip(KINDS, (content.simulated, content.predicted, content.tracked), strict=True))
    report = compare(*motions.values())
    lag = best_lag(content.simulated.by_phase(), content.tracked.by_phase())
    drawn = {
        "ranges": ("Vertical range of motion, mean and 95 % interval over cycles", figures.ranges(report)),
        "advance": ("Forward motion of the marked masses", figures.advance(motions)),
        "paths": ("Paths of the marked masses over the cycles that count", figures.paths(motions)),
        "heights": (
            "Height over a cycle, without its mean; bands span all cycles. The evolved robot's cycle is "
            "stretched, and shifted to where it fits best",
            figures.heights(motions, lag),
        ),
        "heating": (
            "Contacts as read back, and modelled temperatures",
            figures.heating(**vars(content.heating)),
        ),
    }
    pictures = {name: (caption, figures.png(figure)) for name, (caption, figure) in drawn.items()}
    if content.overlay is not None:
        caption = "A frame of the log with the path that the tracker found for each mass"
        pictures = {"frame": (caption, content.overlay), **pictures}
    page = _environment().get_template("report.html").render(
        title=content.title,
        report=report,
        kinds=KINDS,
        labels=figures.LABELS,
        paper=PAPER,
        warnings=[*report.warnings, *content.remarks],
        pictures=[(n, c, base64.b64encode(b).decode()) for n, (c, b) in pictures.items()],
        provenance=content.provenance,
    )  # fmt: skip
    with new_folder(folder) as draft:
        write_text(draft / "index.html", page)
        write_text(draft / "report.json", json.dumps(to_json(report, content), indent=1) + "\n")
        for name, (_, data) in pictures.items():
            write_bytes(draft / f"{name}.png", data)
    return report


def to_json(report: MotionReport, content: ReportInput) -> dict[str, Any]:
    """Every number of the report; what is unknown is null."""
    masses = {}
    for k, name in enumerate(report.names):
        masses[name] = {
            "vertical_range_m": {kind: _number(report.ranges[kind][k].mean) for kind in KINDS},
            "vertical_range_interval_m": {
                kind: [_number(report.ranges[kind][k].low), _number(report.ranges[kind][k].high)]
                for kind in KINDS
            },
            "vertical_range_body_lengths": {
                kind: _number(report.ranges[kind][k].mean / report.body_length) for kind in KINDS
            },
            "agreement_with_camera": {
                kind: {axis: {n: _number(v) for n, v in asdict(a).items()} for axis, a in both[k].items()}
                for kind, both in report.agreement.items()
            },
            "seen": _number(float(report.seen[k])),
        }
    return {
        "format": FORMAT,
        "masses": masses,
        "body_lengths_per_5_cycles": {k: _number(v) for k, v in report.displacement.items()},
        "paper_body_lengths_per_5_cycles": PAPER,
        "body_length_m": _number(report.body_length),
        "warnings": [*report.warnings, *content.remarks],
        "provenance": content.provenance,
    }


def _number(value: float) -> float | None:
    return round(float(value), 9) if math.isfinite(value) else None


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("calibration"), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["mm"] = lambda v: f"{v * 1e3:.1f}" if math.isfinite(v) else "not seen"
    environment.filters["number"] = lambda v: f"{v:+.2f}" if math.isfinite(v) else "not seen"
    return environment
