"""Pages of the PDF files: findings of the build filter, process sheet, and order of work with boxes to
sign."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from eldir.built.robot import PrintedRobot, feet
from eldir.core.pictures import GROUND, MARK, MOTOR
from eldir.core.records import FloatArray, IntArray
from eldir.morphology import Morphology
from eldir.parameters.wiring import Wiring, is_in_series
from eldir_cad.checks.kinematics import find_hinges, find_mechanisms
from eldir_cad.checks.violations import BuildReport
from eldir_cad.geometry.ground import Ground
from eldir_cad.packet._drawing import CONNECTOR
from eldir_cad.packet._kit import describe_current
from eldir_cad.packet._layout import Page, Sign, cover_page, draw_legend
from eldir_cad.packet.manifest import Content

_MAX_MOTIONS = 4  # that are drawn of a kind
_ARROW = 0.03  # length of the longest arrow [m]
_MAX_NOTES = 12
_MASS: dict[str, Any] = {"color": "#444444", "markersize": 4, "zorder": 3}
_NAMED_MASS: dict[str, Any] = {"color": "black", "markersize": 8, "zorder": 4}
_HINGE: dict[str, Any] = {"mfc": "none", "mec": MARK, "mew": 2, "markersize": 13, "zorder": 5}
_FOOT: dict[str, Any] = {"color": "black", "markersize": 6}
_CENTRE: dict[str, Any] = {"color": CONNECTOR, "mec": "black", "markersize": 11, "zorder": 6}


def draw_findings(morphology: Morphology, robot: PrintedRobot, report: BuildReport) -> Figure:
    """The body with its hinges, feet and faulty parts, the centre of mass of its `robot`, and the motions by
    which it can fold."""
    at, springs = morphology.positions, morphology.springs
    folding = find_mechanisms(at, springs)
    driven = find_mechanisms(at, springs[~morphology.active])
    panels: list[tuple[str, FloatArray | None]] = [("hinges, feet and faults", None)]
    panels += [
        (f"folds with all springs ({i + 1} of {len(folding)})", u)
        for i, u in enumerate(folding[:_MAX_MOTIONS])
    ]
    panels += [
        (f"folds without its motors ({i + 1} of {len(driven)})", u)
        for i, u in enumerate(driven[:_MAX_MOTIONS])
    ]
    columns = len(panels) if len(panels) <= 3 else 2 if len(panels) == 4 else 3
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Findings of the build filter", fontsize=14, weight="bold", va="top")
    grid = figure.add_gridspec(rows, columns, left=0.02, right=0.98, bottom=0.2, top=0.88, hspace=0.25)
    for i, (title, motion) in enumerate(panels):
        axes = figure.add_subplot(grid[i // columns, i % columns])
        _draw_body(axes, morphology, _faulty_parts(report))
        if motion is None:
            _draw_symbols(axes, morphology, robot)
        else:
            velocities = _mostly_at_rest(at, springs, motion)
            arrows = _ARROW * velocities / np.linalg.norm(velocities, axis=1).max()
            axes.quiver(
                *at.T, *arrows.T, color=MARK, angles="xy", scale_units="xy", scale=1,
                width=0.006, zorder=5, clip_on=False,
            )  # fmt: skip
        axes.set_title(title, fontsize=9)
    draw_legend(cover_page(figure, 0.17), _LEGEND, 3.2, columns=3)
    return figure


_LEGEND: tuple[tuple[Sign, str], ...] = (
    (lambda axes, x, y: axes.plot(x, y, "o", **_MASS), "mass, with its number"),
    (lambda axes, x, y: axes.plot(x, y, "X", **_NAMED_MASS), "mass that a finding of the traveller names"),
    (lambda axes, x, y: axes.plot(x, y, "o", **_HINGE), "hinge: parts of the body share only this mass"),
    (lambda axes, x, y: axes.plot(x, y, "^", **_FOOT), "foot"),
    (lambda axes, x, y: axes.plot([x - 0.7, x + 0.7], [y, y], color="#888888", lw=1.2), "passive spring"),
    (lambda axes, x, y: axes.plot([x - 0.7, x + 0.7], [y, y], color=MOTOR, lw=3.5), "motor"),
    (
        lambda axes, x, y: axes.plot([x - 0.7, x + 0.7], [y, y], "--", color="black", lw=2),
        "spring that a finding names",
    ),
    (lambda axes, x, y: axes.plot(x, y, "P", **_CENTRE), "centre of mass, dotted down to the table"),
    (
        lambda axes, x, y: axes.annotate(
            "",
            (x + 0.7, y),
            (x - 0.7, y),
            arrowprops={"fc": MARK, "ec": MARK, "width": 1, "headwidth": 5, "headlength": 6},
        ),
        "motion that changes no spring's length, at first",
    ),
)


def _mostly_at_rest(at: FloatArray, springs: IntArray, motion: FloatArray) -> FloatArray:
    """The motion relative to the spring for which most of the body is at rest."""
    best, moving = motion, len(motion) + 1
    for a, b in springs:
        along = at[b] - at[a]
        u = motion[b] - motion[a]
        spin = (along[0] * u[1] - along[1] * u[0]) / (along @ along)
        arm = at - at[a]
        relative = motion - motion[a] - spin * np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        speeds = np.linalg.norm(relative, axis=1)
        if (count := int((speeds > 1e-6 * speeds.max()).sum())) < moving:
            best, moving = relative, count
    return best


def _draw_body(axes: Axes, morphology: Morphology, faulty: set[str]) -> None:
    lines = morphology.positions[morphology.springs]
    active = morphology.active
    axes.add_collection(LineCollection(list(lines[~active]), colors="#888888", linewidths=1.2))
    axes.add_collection(LineCollection(list(lines[active]), colors=MOTOR, linewidths=3.5))
    faulty_lines = [line for i, line in enumerate(lines) if f"spring {i}" in faulty]
    axes.add_collection(
        LineCollection(faulty_lines, colors="black", linewidths=2.0, linestyles="dashed", zorder=4)
    )
    is_sound = np.array([f"mass {i}" not in faulty for i in range(len(morphology.positions))])
    x, y = morphology.positions.T
    axes.plot(x[is_sound], y[is_sound], "o", **_MASS)
    axes.plot(x[~is_sound], y[~is_sound], "X", **_NAMED_MASS)
    axes.set_aspect("equal")
    axes.margins(0.12)
    axes.axis("off")


def _draw_symbols(axes: Axes, morphology: Morphology, robot: PrintedRobot) -> None:
    x, y = morphology.positions.T
    rings = [h.mass for h in find_hinges(morphology)]
    axes.plot(x[rings], y[rings], "o", **_HINGE)
    for i, (px, py) in enumerate(morphology.positions):
        axes.annotate(str(i), (px, py), (4, 4), textcoords="offset points", fontsize=6)
    ground = feet(robot)
    axes.plot(x[ground], y[ground] - 0.012, "^", **_FOOT)
    centre = robot.masses @ morphology.positions / robot.masses.sum()
    axes.plot(*centre, "P", **_CENTRE)
    axes.plot([centre[0]] * 2, [centre[1], y.min() - 0.012], ":", color="black", linewidth=0.8)


def _faulty_parts(report: BuildReport) -> set[str]:
    """Masses and springs of all violations except hinges, as 'mass 3' or 'spring 5'."""
    names: Iterable[str] = (part for v in report.violations if v.kind != "hinge" for part in v.parts)
    return {" ".join(part.split()[:2]) for part in names}


def draw_ground(c: Content, ground: Ground) -> Figure:
    """The ground from the front with its pieces, the robot where it begins, and a table of the pieces."""
    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Ground", fontsize=14, weight="bold", va="top")
    axes = figure.add_axes((0.06, 0.5, 0.91, 0.4))
    for i, piece in enumerate(ground.pieces, start=1):
        x, height = piece.surface.T
        axes.fill_between(x, height, piece.block, color=GROUND, ec="#8a7a5c", lw=0.8)
        if piece.block:
            axes.fill_between([x[0], x[-1]], piece.block, 0.0, color="#eeeeee", ec="#aaaaaa", lw=0.8)
        axes.text((x[0] + x[-1]) / 2, piece.block + 3.0, str(i), ha="center", va="bottom", fontsize=10)
    body, masses = c.assembly.morphology, c.assembly.centres.copy()
    surface = np.concatenate([piece.surface for piece in ground.pieces])
    # It touches the ground where it is highest under it; corners point down.
    lift = (np.interp(masses[:, 0], *surface.T) - masses[:, 1]).max() + c.spec.mass.across_corners / 2
    masses[:, 1] += lift
    ends = masses[body.springs]
    axes.add_collection(LineCollection(list(ends[~body.active]), colors="#666666", linewidths=1.0))
    axes.add_collection(LineCollection(list(ends[body.active]), colors=MOTOR, linewidths=2.5))
    for x in ground.marks:
        axes.axvline(x, color=MARK, ls=":", lw=1.0)
    axes.axhline(0.0, color="black", lw=0.8)
    axes.set_aspect("equal")
    axes.set_ylim(-8.0, None)
    axes.set_xlabel("mm from the rearmost mass, travel to the right; front face")
    axes.set_ylabel("mm over the table")
    axes.spines[["top", "right"]].set_visible(False)
    density = c.printer.material.density * 1e-3
    rows = [
        [str(i), f"{p.start:.0f} to {p.end:.0f}", f"{p.height:.0f}", f"{p.block:g}" if p.block else "none",
         f"{p.part.volume * density:.0f}"]
        for i, p in enumerate(ground.pieces, start=1)
    ]  # fmt: skip
    header = ["piece", "from, to [mm]", "height [mm]", "block under it [mm]", "weight [g]"]
    for k, column in enumerate(zip(header, *rows, strict=True)):
        figure.text(0.05 + 0.11 * k, 0.4, "\n".join(column), fontsize=8, va="top", linespacing=1.35)
    weight = sum(p.part.volume for p in ground.pieces) * density
    notes = (
        f"{len(ground.pieces)} pieces, {ground.width:.0f} mm deep, {weight:.0f} g of resin. The number of "
        "each is at the front, at its end.",
        "Lay them on the table side by side, number 1 at the rear, each tongue in the next groove, on blocks "
        "where the table says so. Glue or tape them down: they must not move.",
        "Place the robot in the middle of the depth, its rearmost mass over the first mark, its foremost "
        "over the second (dotted lines).",
        "Predictions take the friction of the table for that of the ground; it is not measured. Cover the "
        "pieces with what the table is covered with.",
    )
    text = "\n\n".join(textwrap.fill(note, 66) for note in notes)
    figure.text(0.62, 0.4, text, fontsize=8, va="top", linespacing=1.35)
    return figure


def draw_traveller(c: Content) -> list[Figure]:
    """Process sheet: from the printer to parts that are ready to be assembled."""
    printer, wash = c.printer, c.printer.wash
    steps = [
        "Once for this printer: print the fit coupon (eldir coupon) and set `allowance` in its profile",
        "Open each plate (plates/*.3mf) in the slicer. " + _describe_slicing(c),
        *(
            f"Print {plate.name}: {len(plate.items)} parts, {plate.height:.1f} mm high, "
            f"layers of {printer.layer:g} mm, {printer.material.name}"
            for plate in (*c.plates, *c.ground_plates)
        ),
        f"Wash on the build plate: {wash.on_plate_min:g} min in {wash.solvent}",
        f"Take the parts off the plate; wash {wash.off_plate_min:g} min in {wash.rinse}",
        "Dry until no solvent is left in the sockets",
        "Clip the supports off",
        f"Post-cure {printer.cure_min:g} min",
        "Put one passive spring into one mass by hand. It must rotate a little to either side. If not, "
        "correct `allowance` and write the packet again",
        "Count the parts against bom.csv; weigh one mass and one passive spring",
    ]
    page = Page("Traveller")
    page.table([f"{i}. {step}" for i, step in enumerate(steps, start=1)])
    page.heading("Warnings")
    page.list(
        [
            "Heat: coils reach 60 C and more where they sit in the resin. The heat-deflection temperature of "
            "the resin is not known. Look at the mounts after every run; stop if one has moved or softened.",
            "Never connect a coil to a supply without a current limit and an independent cut-off. At most "
            f"{describe_current(c)}. A coil that stays on damages itself and the parts by heat.",
            "Uncured resin and its solvents: wear gloves and glasses, and ventilate the room.",
        ]
    )
    page.heading("Findings of the build filter")
    page.list(_shorten([f"{v.severity}: {v}" for v in c.report.violations]) or ["none"])
    return page.figures


def draw_order_of_work(c: Content, connections: Wiring, picture: bytes) -> list[Figure]:
    """From parts to a wired robot, beside the assembly map. `picture`: the assembled robot, as PNG."""
    discs = ", ".join(f"m{i + 1} on mass {mass}" for i, mass in enumerate(c.assembly.marks))
    steps = [
        "Measure every coil as kit.pdf says, and choose the two of each motor; write the resistances into "
        "wiring.csv and into the rig file",
        "Lay out the front masses (one line under the number), floors down and sockets up. You look at them "
        "from inside, so they lie as in the drawing of the back face",
        "Press every passive spring into its two sockets, from above, until it sits on the floor",
        f"Push each coil over two spring ends, {c.spec.fitting.stud_length:g} mm deep; lead its wire out "
        "through the guide; press the ends into the sockets of the motors' masses. Without load it has "
        f"{c.spec.motor_range[0]:g} mm from mass to mass, so here, at {c.spec.pitch:g} mm, it is stretched",
        "Press a cap on every mass with six springs, a connector on every other mass",
        "Build the back plane in the same way (two lines under the number; drawing of the front face). Press "
        "it on the connectors; glue the pegs with a drop of resin and cure it",
        f"Cut the markers out of markers.pdf (or eldir markers); stick them on the front face: {discs}",
    ]
    if is_in_series(connections):
        steps.append(
            "The coils of a motor are in series: at the top of the robot, join one lead of the front coil "
            "with that of the back coil at the same end"
        )
    steps.append(
        "Join leads and coils as kit.pdf says. Wire each coil to its relay channel by wiring.csv of this "
        "packet, whose digest is on the assembly map; lead the wires outwards and up, at least as long as "
        "listed"
    )
    if c.ground is not None:
        steps.append(
            f"Lay the {len(c.ground.pieces)} pieces of the ground on the table as the last page shows, and "
            "place the robot on it, its rearmost mass over the first mark"
        )
    if c.variant.ballast is not None:
        steps.append(
            f"Glue a ballast holder over the outside of mass {c.variant.ballast.mass}, on both faces; glue "
            f"{c.filling:.2f} g of steel shot into each, {c.variant.ballast.grams:g} g with the holders"
        )
    page = Page("Order of work")
    page.table([f"{i}. {step}" for i, step in enumerate(steps, start=1)])
    page.picture(picture, "Front face. Blue: masses of m1 to m5; yellow: connectors; orange: coils.")
    return page.figures


def _describe_slicing(c: Content) -> str:
    if not (places := _describe_supports(c)):
        return "No part needs supports"
    return f"The plates have no supports: let the slicer add them, {places}"


def _describe_supports(c: Content) -> str:
    names: dict[str, list[str]] = {}
    for name, inspection in c.inspections.items():
        if inspection.support_levels:
            levels = " and ".join(f"{z:g}" for z in inspection.support_levels)
            names.setdefault(f"{levels} mm above the plate", []).append(name)
    return "; ".join(f"{where}: {', '.join(parts)}" for where, parts in names.items())


def _shorten(notes: list[str]) -> list[str]:
    if len(notes) <= _MAX_NOTES:
        return notes
    return [*notes[:_MAX_NOTES], f"and {len(notes) - _MAX_NOTES} more in manifest.json"]
