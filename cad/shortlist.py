"""Which designs of a run to build: the build filter, then what the built scene predicts.

Paper fitness does not rank them (docs/reference/built.md): displacement over all phases of the
built robot does, then the median over slightly different builds of the same design: a mean is
carried by the few builds that happen to run.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from cad import drawing
from cad.buildability import check
from cad.fit import fit
from cad.law import built_parameters, spring_parameters
from cad.printer import Printer, load_printer
from cad.rigidity import hinges
from cad.specification import Specification, load_specification
from cad.violations import BuildReport
from eldir.built_parameters import BuiltParameters
from eldir.built_scene import BuiltScene
from eldir.design import Design
from eldir.errors import EldirError
from eldir.files import new_folder, write_bytes, write_text
from eldir.gait import Gait
from eldir.marks import marked_masses
from eldir.pictures import png
from eldir.screening import Ensemble, Screened, ensemble, screen
from eldir.sma_parameters import SpringParameters

FORMAT = "eldir-ranking/1"
_BEATEN = "walks less far than others"
_ENSEMBLES = 2  # for each place on the list: the order changes among them
MOST = 400  # fit designs that are driven, in the run's order; more take too long
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Candidate:
    """A design on the shortlist, and why."""

    design: Design
    report: BuildReport
    screened: Screened
    gait: Gait
    spread: Ensemble

    @property
    def median(self) -> float:
        """Body lengths per five cycles that half of the builds reach; minus infinity where they fall."""
        return float(np.quantile(self.spread.displacement, 0.5, method="lower"))


@dataclass(frozen=True)
class Shortlist:
    """The best designs, best first, and what became of the others."""

    candidates: tuple[Candidate, ...]
    considered: int
    """Different bodies in the run."""
    left_out: dict[str, int]
    """How many fell to each reason, the most frequent first."""


def rank(
    designs: Sequence[Design],
    top: int,
    specification: Specification | None = None,
    printer: Printer | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    known: BuiltScene | None = None,
) -> Shortlist:
    """The `top` designs by median displacement of an ensemble of builds in their best gait.

    With what is `known` from films of an earlier robot, builds are drawn from that.
    """
    tell = progress or (lambda _stage, _share: None)
    printer = printer or load_printer()
    spec = fit(specification or load_specification(), printer)
    different = _different(designs)
    reasons: Counter[str] = Counter()
    sound = _filtered(different, spec, printer, reasons, tell)
    scene = (built_parameters(spec, printer), spring_parameters(spec)) if known is None else known.specimen
    standing = _standing([d for d, _ in sound], scene, reasons, tell)[: _ENSEMBLES * top]
    candidates = []
    for i, (s, gait) in enumerate(standing):
        design, report = sound[s.index]
        builds = ensemble(
            design.morphology, gait, seed=seed, parameters=scene[0], springs=scene[1], scene=known
        )
        candidates.append(Candidate(design, report, s, gait, builds))
        tell("ensembles", (i + 1) / len(standing))
    candidates.sort(key=lambda c: -c.median)
    reasons[_BEATEN] += len(candidates[top:])
    left_out = {kind: n for kind, n in reasons.most_common() if n}
    return Shortlist(tuple(candidates[:top]), len(different), left_out)


def _filtered(
    different: Sequence[Design], spec: Specification, printer: Printer, reasons: Counter[str], tell: Progress
) -> list[tuple[Design, BuildReport]]:
    """What passes the build filter; the others are counted in `reasons`."""
    sound: list[tuple[Design, BuildReport]] = []
    for i, design in enumerate(different):
        report = check(design.morphology, spec, printer)
        against = next((v.kind for v in report.violations if v.severity != "note"), None)
        if against is not None:
            reasons[against] += 1
        elif len(sound) >= MOST:
            reasons["not driven: enough others"] += 1
        else:
            sound.append((design, report))
        tell("build filter", (i + 1) / len(different))
    return sound


def _standing(
    designs: Sequence[Design],
    scene: tuple[BuiltParameters, SpringParameters],
    reasons: Counter[str],
    tell: Progress,
) -> list[tuple[Screened, Gait]]:
    """What stays upright in its best gait, the farthest first; the others are counted in `reasons`."""
    found = []
    bodies = [d.morphology for d in designs]
    for s in screen(bodies, *scene, progress=lambda share: tell("all phases", share)):
        if s.rejected:
            # Its reason names the number of mechanisms; together they count as one.
            reasons["mechanism" if s.freedoms else "static margin"] += 1
        elif not np.isfinite(s.best):
            reasons["falls over"] += 1
        elif not s.exact or s.gait is None:
            reasons[_BEATEN] += 1
        else:
            found.append((s, s.gait))
    return sorted(found, key=lambda pair: -pair[0].best)


def write_shortlist(shortlist: Shortlist, out: Path) -> list[dict[str, Any]]:
    """Design files, best first, `ranking.json` and pictures side by side; returns the ranking.

    Raises `EldirError` where no design is left.
    """
    if not shortlist.candidates:
        reasons = ", ".join(f"{n} {kind}" for kind, n in shortlist.left_out.items()) or "no designs"
        raise EldirError(
            "no design of this run can be built and stands",
            expected="at least one",
            found=f"{shortlist.considered} bodies: {reasons}",
            remedy="evolve more, with --lattice 6x11 --max-motors 2 --static-margin 20",
        )
    rows = []
    with new_folder(out) as folder:
        for number, candidate in enumerate(shortlist.candidates, start=1):
            name = f"design_{number:02d}.json"
            predicted = _prediction(candidate)
            provenance = candidate.design.provenance | predicted
            d = candidate.design
            Design(d.lattice, d.genotype, d.controller, d.scene, provenance).save(folder / name)
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


def _different(designs: Sequence[Design]) -> list[Design]:
    """One design, the first, of each body."""
    seen: dict[bytes, Design] = {}
    for design in designs:
        body = design.morphology
        key = body.positions.tobytes() + body.springs.tobytes() + body.active.tobytes()
        seen.setdefault(key, design)
    return list(seen.values())


def _prediction(candidate: Candidate) -> dict[str, Any]:
    gait, walks = candidate.gait, candidate.spread.displacement
    upright = walks[np.isfinite(walks)]
    return {
        "gait": {
            "period_s": gait.period,
            "phase": gait.phase.tolist(),
            "duty": gait.duty.tolist(),
            "method": gait.method,
        },
        "predicted": {
            "body_lengths_per_5_cycles": candidate.screened.best,
            "ensemble": {
                "builds": len(walks),
                "fell": int(len(walks) - len(upright)),
                "median": candidate.median if np.isfinite(candidate.median) else None,
                "mean": float(upright.mean()) if len(upright) else None,
                "standard_deviation": float(upright.std(ddof=1)) if len(upright) > 1 else None,
                "probability_forward": candidate.spread.probability_forward,
            },
            "static_margin_mm": 1e3 * candidate.screened.margin,
        },
    }


def told(ensemble: dict[str, Any]) -> str:
    """An ensemble in words."""
    if ensemble["median"] is None:
        return "most builds fall over"
    spread = ensemble["standard_deviation"] or 0.0
    fell = f", {ensemble['fell']} of {ensemble['builds']} fall over" if ensemble["fell"] else ""
    return f"{ensemble['median']:+.2f} ± {spread:.2f} body lengths in 5 cycles{fell}"


def _pictures(candidates: Sequence[Candidate]) -> Figure:
    """The bodies side by side with what is predicted of them."""
    columns = min(len(candidates), 3)
    rows = -(-len(candidates) // columns)
    figure = Figure(figsize=(4 * columns, 2.9 * rows))
    # All at one scale, each centred above the ground.
    widest, tallest = np.max([np.ptp(c.design.morphology.positions, axis=0) for c in candidates], axis=0)
    for i, candidate in enumerate(candidates):
        axes = figure.add_subplot(rows, columns, i + 1)
        body = candidate.design.morphology
        lines = body.positions[body.springs]
        axes.add_collection(LineCollection(list(lines[~body.active]), colors="#777777", linewidths=1.2))
        axes.add_collection(LineCollection(list(lines[body.active]), colors=drawing.MOTOR, linewidths=3.5))
        x, y = body.positions[marked_masses(body)].T
        axes.plot(*body.positions.T, "o", color="black", markersize=3)
        axes.plot(x, y, "o", color=drawing.MARK, markersize=6)
        joints = body.positions[[h.mass for h in hinges(body)]].reshape(-1, 2).T
        axes.plot(*joints, "o", mfc="none", mec="black", markersize=9)
        axes.axhline(float(body.positions[:, 1].min()), color="#bbbbbb", linewidth=0.8, zorder=0)
        left, bottom = body.positions.min(axis=0)
        middle = left + body.body_length / 2
        axes.set_xlim(middle - 0.55 * widest, middle + 0.55 * widest)
        axes.set_ylim(bottom - 0.02, bottom + 1.05 * tallest)
        axes.set_aspect("equal")
        axes.axis("off")
        e = _prediction(candidate)["predicted"]["ensemble"]
        axes.set_title(
            f"design_{i + 1:02d}: {told(e)}\n"
            f"forward in {e['probability_forward']:.0%} of {e['builds']} builds",
            fontsize=8,
        )
    figure.tight_layout()
    return figure
