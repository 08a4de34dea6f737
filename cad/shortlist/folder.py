"""A shortlist as files: the designs with their predictions, and their pictures side by side."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from cad.checks.rigidity import hinges
from cad.shortlist.ranking import RankedDesign, Shortlist
from eldir.built.gait import CYCLES
from eldir.built.robot import build
from eldir.built.validity.ties import TIED
from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import MARK, MOTOR, png
from eldir.marks import marked_masses

FORMAT = "eldir-ranking/3"


def write_shortlist(shortlist: Shortlist, out: Path) -> list[dict[str, Any]]:
    """Write design files, best first, `ranking.json` and pictures side by side. Returns the rows of the
    ranking.

    Raises `EldirError` where no design is left.
    """
    shortlist.require_candidates(
        "evolve more, with --lattice 6x11 --max-motors 2 --static-margin 20 --buildable"
    )
    rows = []
    with new_folder(out) as folder:
        for number, candidate in enumerate(shortlist.candidates, start=1):
            name = f"design_{number:02d}.json"
            predicted = _prediction(candidate)
            d = candidate.design
            replace(d, provenance=d.provenance | predicted).save(folder / name)
            origin: dict[str, Any] = {
                k: d.provenance[k] for k in ("id", "generation", "fitness_m") if k in d.provenance
            }
            rows.append({"file": name} | origin | predicted | {"build_report": candidate.report.to_json()})
        ranking = {
            "format": FORMAT,
            "considered": shortlist.considered,
            "left_out": shortlist.left_out,
            "designs": rows,
        }
        write_text(folder / "ranking.json", json.dumps(ranking, indent=1) + "\n")
        write_bytes(folder / "shortlist.png", png(_pictures(shortlist.candidates)))
    return rows


def _prediction(candidate: RankedDesign) -> dict[str, Any]:
    gait, walks = candidate.gait, candidate.spread.displacement
    upright = walks[np.isfinite(walks)]
    cycle = 1e3 * candidate.spread.expected * build(candidate.design.morphology).body_length / CYCLES
    return {"gait": gait.to_json()} | {
        "predicted": {
            "body_lengths_per_5_cycles": candidate.screened.best,
            "sampled_walks": {
                "samples": len(walks),
                "fell": int(len(walks) - len(upright)),
                "expected": candidate.spread.expected if len(upright) else None,
                "standard_error": candidate.spread.error if len(upright) else None,
                "mm_per_cycle": cycle if len(upright) else None,
                "mm_per_minute": cycle * 60.0 / gait.period if len(upright) else None,
                "mean": float(upright.mean()) if len(upright) else None,
                "standard_deviation": float(upright.std(ddof=1)) if len(upright) > 1 else None,
                "probability_forward": candidate.spread.probability_forward,
                "tie_share": candidate.spread.tie_share if len(upright) else None,
            },
            "static_margin_mm": 1e3 * candidate.screened.margin,
        },
    }


def described(walks: dict[str, Any]) -> str:
    """`sampled_walks` of a ranking in words: expected walk with its standard error, falls, and the walk of a
    minute."""
    if walks["expected"] is None:
        return "all samples fall over"
    error = walks["standard_error"]
    fell = f", {walks['fell']} of {walks['samples']} fall over" if walks["fell"] else ""
    walk = f"{walks['expected']:+.2f} ± {error:.2f} body lengths in 5 cycles"
    return f"{walk} ({walks['mm_per_minute']:.0f} mm a minute){fell}{_doubt(walks)}"


def _doubt(walks: dict[str, Any]) -> str:
    share = walks["tie_share"]
    return f", doubtful: ties {share:.0%}" if share is not None and share > TIED else ""


def _pictures(candidates: Sequence[RankedDesign]) -> Figure:
    """The bodies side by side with their predictions."""
    columns = min(len(candidates), 3)
    rows = -(-len(candidates) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.9 * rows), layout="constrained")
    # All at one scale, each centred above the ground.
    widest, tallest = np.max([np.ptp(c.design.morphology.positions, axis=0) for c in candidates], axis=0)
    for i, candidate in enumerate(candidates):
        axes = figure.add_subplot(rows, columns, i + 1)
        body = candidate.design.morphology
        lines = body.positions[body.springs]
        axes.add_collection(LineCollection(list(lines[~body.active]), colors="#777777", linewidths=1.2))
        axes.add_collection(LineCollection(list(lines[body.active]), colors=MOTOR, linewidths=3.5))
        x, y = body.positions[marked_masses(body)].T
        axes.plot(*body.positions.T, "o", color="black", markersize=3)
        axes.plot(x, y, "o", color=MARK, markersize=6)
        joints = body.positions[[h.mass for h in hinges(body)]].reshape(-1, 2).T
        axes.plot(*joints, "o", mfc="none", mec="black", markersize=9)
        axes.axhline(float(body.positions[:, 1].min()), color="#bbbbbb", linewidth=0.8, zorder=0)
        left, bottom = body.positions.min(axis=0)
        middle = left + body.body_length / 2
        axes.set_xlim(middle - 0.55 * widest, middle + 0.55 * widest)
        axes.set_ylim(bottom - 0.02, bottom + 1.05 * tallest)
        axes.set_aspect("equal")
        axes.axis("off")
        walks = _prediction(candidate)["predicted"]["sampled_walks"]
        axes.set_title(
            f"design_{i + 1:02d}: {described(walks)}\n"
            f"forward in {walks['probability_forward']:.0%} of {walks['samples']} samples",
            fontsize=8,
        )
    handles = [
        Line2D([], [], color=MOTOR, label="motor"),
        Line2D([], [], color=MARK, marker="o", ls="", label="m1 to m5"),
        Line2D([], [], color="black", marker="o", mfc="none", ls="", label="hinge"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8)
    return figure
