"""A shortlist as files: the designs with their predictions, and their pictures side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from eldir.core.files import new_folder, write_bytes
from eldir.core.pictures import MARK, MOTOR, png
from eldir.marks import marked_masses
from eldir_cad.checks.rigidity import hinges
from eldir_cad.shortlist.numbers import RankedPrediction, Ranking, RankingRow
from eldir_cad.shortlist.ranking import RankedDesign, Shortlist


def write_shortlist(shortlist: Shortlist, out: Path) -> tuple[RankingRow, ...]:
    """Write design files, best first, `ranking.json` and pictures side by side. Returns the rows of the
    ranking.

    Raises `EldirError` where no design is left.
    """
    shortlist.require_candidates(
        "evolve more, with --lattice 6x11 --max-motors 2 --static-margin 20 --buildable"
    )
    rows: tuple[RankingRow, ...] = ()
    with new_folder(out) as folder:
        for number, candidate in enumerate(shortlist.candidates, start=1):
            name = f"design_{number:02d}.json"
            rows += (row := RankingRow.of(name, candidate),)
            d = candidate.design
            predicted = {"gait": row.gait.to_json(), "predicted": row.predicted.to_json()}
            replace(d, provenance=d.provenance | predicted).save(folder / name)
        Ranking(shortlist.considered, shortlist.left_out, rows).save(folder / "ranking.json")
        write_bytes(folder / "shortlist.png", png(_pictures(shortlist.candidates)))
    return rows


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
        walks = RankedPrediction.of(candidate).sampled_walks
        axes.set_title(f"design_{i + 1:02d}: {walks}\n{walks.forward}", fontsize=8)
    handles = [
        Line2D([], [], color=MOTOR, label="motor"),
        Line2D([], [], color=MARK, marker="o", ls="", label="m1 to m5"),
        Line2D([], [], color="black", marker="o", mfc="none", ls="", label="hinge"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=8)
    return figure
