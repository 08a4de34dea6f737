"""A page with the findings of the build filter: hinges, feet, faults, and mechanisms."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from eldir.built.robot import build
from eldir.built.statics import feet
from eldir.core.pictures import MARK, MOTOR
from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology
from eldir_cad.checks.rigidity import hinges, mechanisms
from eldir_cad.checks.violations import BuildReport
from eldir_cad.packet.drawing import CONNECTOR

_MOST = 4  # motions drawn of a kind
_REACH = 0.03  # of the longest arrow [m]


def findings_page(morphology: Morphology, report: BuildReport) -> Figure:
    """The page: the body with its hinges, feet and faulty parts, and every mechanism by which it folds."""
    at, springs = morphology.positions, morphology.springs
    held = mechanisms(at, springs)
    driven = mechanisms(at, springs[~morphology.active])
    panels: list[tuple[str, FloatArray | None]] = [("hinges, feet and faults", None)]
    panels += [(f"folds with all springs ({i + 1} of {len(held)})", u) for i, u in enumerate(held[:_MOST])]
    panels += [
        (f"folds without its motors ({i + 1} of {len(driven)})", u) for i, u in enumerate(driven[:_MOST])
    ]
    columns = 2 if len(panels) <= 4 else 3
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Findings of the build filter", fontsize=14, weight="bold", va="top")
    grid = figure.add_gridspec(rows, columns, left=0.02, right=0.98, bottom=0.1, top=0.88, hspace=0.25)
    for i, (title, motion) in enumerate(panels):
        axes = figure.add_subplot(grid[i // columns, i % columns])
        _body(axes, morphology, _faulty(report))
        if motion is None:
            _marks(axes, morphology)
        else:
            seen = _mostly_still(at, springs, motion)
            arrows = _REACH * seen / np.linalg.norm(seen, axis=1).max()
            axes.quiver(
                *at.T, *arrows.T, color=MARK, angles="xy", scale_units="xy", scale=1,
                width=0.006, zorder=5, clip_on=False,
            )  # fmt: skip
        axes.set_title(title, fontsize=9)
    figure.text(
        0.03,
        0.045,
        "ring: hinge; triangle: foot; cross: centre of mass; thick line: motor; dashed: faulty part. "
        "Arrows: a motion in which no spring changes its length, to first order.",
        fontsize=8,
    )
    return figure


def _mostly_still(at: FloatArray, springs: IntArray, motion: FloatArray) -> FloatArray:
    """The motion relative to a spring, chosen so that most of the body does not move."""
    best, moving = motion, len(motion) + 1
    for a, b in springs:
        along = at[b] - at[a]
        u = motion[b] - motion[a]
        spin = (along[0] * u[1] - along[1] * u[0]) / (along @ along)
        arm = at - at[a]
        seen = motion - motion[a] - spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        speeds = np.linalg.norm(seen, axis=1)
        if (count := int((speeds > 1e-6 * speeds.max()).sum())) < moving:
            best, moving = seen, count
    return best


def _body(axes: Axes, morphology: Morphology, faulty: set[str]) -> None:
    lines = morphology.positions[morphology.springs]
    active = morphology.active
    axes.add_collection(LineCollection(list(lines[~active]), colors="#888888", linewidths=1.2))
    axes.add_collection(LineCollection(list(lines[active]), colors=MOTOR, linewidths=3.5))
    wrong = [line for i, line in enumerate(lines) if f"spring {i}" in faulty]
    axes.add_collection(LineCollection(wrong, colors="black", linewidths=2.0, linestyles="dashed", zorder=4))
    sound = np.array([f"mass {i}" not in faulty for i in range(len(morphology.positions))])
    x, y = morphology.positions.T
    axes.plot(x[sound], y[sound], "o", color="#444444", markersize=4, zorder=3)
    axes.plot(x[~sound], y[~sound], "X", color="black", markersize=8, zorder=4)
    axes.set_aspect("equal")
    axes.margins(0.12)
    axes.axis("off")


def _marks(axes: Axes, morphology: Morphology) -> None:
    x, y = morphology.positions.T
    robot = build(morphology)
    rings = [h.mass for h in hinges(morphology)]
    axes.plot(x[rings], y[rings], "o", mfc="none", mec=MARK, mew=2, markersize=13, zorder=5)
    for i, (px, py) in enumerate(morphology.positions):
        axes.annotate(str(i), (px, py), (4, 4), textcoords="offset points", fontsize=6)
    stands = feet(robot)
    axes.plot(x[stands], y[stands] - 0.012, "^", color="black", markersize=6)
    centre = robot.masses @ morphology.positions / robot.masses.sum()
    axes.plot(*centre, "P", color=CONNECTOR, mec="black", markersize=11, zorder=6)
    axes.plot([centre[0]] * 2, [centre[1], y.min() - 0.012], ":", color="black", linewidth=0.8)


def _faulty(report: BuildReport) -> set[str]:
    """Masses and springs of all violations except hinges, as 'mass 3' or 'spring 5'."""
    names: Iterable[str] = (part for v in report.violations if v.kind != "hinge" for part in v.parts)
    return {" ".join(part.split()[:2]) for part in names}
