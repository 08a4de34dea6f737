"""The comparison of predictions with MuJoCo as files: one self-contained page, and every number in JSON."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from calibration.report.sampled_motions import LEVEL
from eldir.built.validity.ties import TIED
from eldir.core.figure_folder import page_templates
from eldir.core.files import new_folder, write_text
from eldir.core.pictures import png
from eldir.core.records import FloatArray
from eldir.core.version import __version__
from hardware.analysis.transfer import ComparedWalk, TransferSettings, WalkingDesign
from hardware.analysis.transfer_explained import ExplainedWalk
from hardware.analysis.transfer_verdict import GOALS, Verdict

FORMAT = "eldir-transfer/1"
# Okabe and Ito's palette; a form of its own for each kind, so that a grey print reads too.
_SURE, _TIED = ("#0072B2", "o"), ("#D55E00", "D")


@dataclass(frozen=True)
class TransferResult:
    """The content of the page."""

    designs: Sequence[WalkingDesign]
    compared: Sequence[ComparedWalk]
    explained: Sequence[ExplainedWalk]
    settings: TransferSettings
    engine: str
    """MuJoCo with its version."""

    @property
    def verdict(self) -> Verdict:
        """How well the predictions transfer."""
        return Verdict.of(self.compared)

    def to_json(self) -> dict[str, Any]:
        """Every number; falls and unknown values are null."""
        s, verdict = self.settings, self.verdict
        return {
            "format": FORMAT,
            "engine": f"eldir {__version__}",
            "second_engine": self.engine,
            "settings": {
                "samples": s.samples,
                "cycles": s.cycles,
                "phases": s.phases,
                "seed": s.seed,
                "interval_probability": LEVEL,
                "tied_above": TIED,
            },
            "verdict": verdict.to_json()
            | {
                "goals": {name: list(ends) for name, ends in GOALS.items()},
                "reached": verdict.reached,
                "in_words": verdict.in_words,
            },
            "designs": [
                {"file": one.file, "body": one.design.body, "gait_by_screening": one.screened}
                for one in self.designs
            ],
            "walks": [_walk_json(one) for one in self.compared],
            "explained": [
                {
                    "file": one.file,
                    "seed": one.seed,
                    "engine": _number(one.engine),
                    "mujoco": _number(one.mujoco),
                    "without": {name: _number(walk) for name, walk in one.without.items()},
                    "in_words": one.in_words,
                }
                for one in self.explained
            ],
        }


def write_transfer(result: TransferResult, folder: Path) -> None:
    """Write `transfer.html` and `transfer.json` into a new folder, whole or not at all."""
    text = json.dumps(result.to_json(), indent=1) + "\n"
    templates = page_templates(
        "hardware.analysis", number=_signed, share=lambda v: f"{v:.0%}" if math.isfinite(v) else "–"
    )
    page = templates.get_template("transfer.html").render(
        verdict=result.verdict,
        result=result,
        settings=result.settings,
        picture=base64.b64encode(png(scatter(result.compared))).decode(),
        versions=f"eldir {__version__}, {result.engine}",
        tied_above=TIED,
    )  # fmt: skip
    with new_folder(folder) as draft:
        write_text(draft / "transfer.html", page)
        write_text(draft / "transfer.json", text)


def scatter(compared: Sequence[ComparedWalk]) -> Figure:
    """Predicted walks with their intervals against those of MuJoCo; walks that ties make doubtful have
    another form."""
    figure = Figure(figsize=(5.8, 5.6), layout="constrained")
    axes = figure.subplots()
    named: set[bool] = set()
    for one in compared:
        there = _upright(one.mujoco.displacement)
        if not len(there) or not np.isfinite(one.predicted.mean):
            continue
        colour, form = _TIED if one.tied else _SURE
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
    low, high = _ends(compared)
    axes.plot([low, high], [low, high], ":", color="#777777", lw=1, label="as predicted")
    for line in (axes.axhline, axes.axvline):
        line(0.0, color="#cccccc", lw=0.8, zorder=0)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    axes.set_aspect("equal")
    axes.set_xlabel("predicted (body lengths per five cycles)")
    axes.set_ylabel("MuJoCo (body lengths per five cycles)")
    axes.legend(frameon=False, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _ends(compared: Sequence[ComparedWalk]) -> tuple[float, float]:
    """Ends of both axes: all robots are seen; a wide interval would make them small, and is cut."""
    both = [walks.displacement for one in compared for walks in (one.predicted, one.mujoco)]
    walks = _upright(np.concatenate([*both, [0.0]]))
    room = 0.1 * max(float(np.ptp(walks)), 0.1)
    return float(walks.min()) - room, float(walks.max()) + room


def _walk_json(one: ComparedWalk) -> dict[str, Any]:
    predicted, there, gait = one.predicted, one.mujoco, one.gait
    return {
        "file": one.file,
        "chosen": one.chosen,
        "gait": {
            "period_s": gait.period,
            "phase": gait.phase.tolist(),
            "duty": gait.duty.tolist(),
            "method": gait.method,
        },
        "tie_share": _number(predicted.tie_share),
        "tied": one.tied,
        "predicted": {
            "walks": [_number(v) for v in predicted.displacement],
            "mean": _number(one.means[0]),
            "interval": None if one.interval is None else [_number(v) for v in one.interval],
        },
        "mujoco": {
            "seeds": list(one.seeds),
            "walks": [_number(v) for v in there.displacement],
            "mean": _number(one.means[1]),
            "inside": one.inside.tolist(),
            "faults": list(one.faults),
        },
    }


def _upright(walks: FloatArray) -> FloatArray:
    return walks[np.isfinite(walks)]


def _number(value: float) -> float | None:
    return round(float(value), 9) if math.isfinite(value) else None


def _signed(value: float) -> str:
    """Two digits with a sign; adding 0.0 takes the sign from a rounded minus zero."""
    return f"{round(value, 2) + 0.0:+.2f}" if math.isfinite(value) else "falls"
