"""Process sheet and order of work, as PDF: the steps in order, each with a box to sign."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Sequence

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from eldir_cad.packet.content import Content

_PAGE = (8.27, 11.69)  # A4 upright [inches]
_LEFT, _TOP, _LINE, _WRAP = 0.08, 0.93, 0.0175, 92
_NOTES = 12  # that are printed


def pdf(figures: Sequence[Figure]) -> bytes:
    """Pages as PDF without dates; the same figures give the same bytes."""
    file = io.BytesIO()
    with PdfPages(file, metadata={"CreationDate": None}) as pages:
        for figure in figures:
            pages.savefig(figure)
    return file.getvalue()


def stamped(pages: Sequence[Figure], text: str) -> list[Figure]:
    """The pages with a line at the bottom that says which robot they are for, and their numbers."""
    for i, page in enumerate(pages, start=1):
        page.text(_LEFT, 0.006, f"{text}   page {i} of {len(pages)}", fontsize=6.5, color="#444444")
    return list(pages)


def traveller(c: Content) -> list[Figure]:
    """Process sheet: from the printer to parts that are ready to be assembled."""
    printer, wash = c.printer, c.printer.wash
    steps = [
        "Once for this printer: print the fit coupon (eldir coupon) and set `allowance` in its profile",
        *(
            f"Print {plate.name}: {len(plate.items)} parts, {plate.height:.1f} mm high, "
            f"layers of {printer.layer:g} mm, {printer.material.name}"
            for plate in c.plates
        ),
        f"Wash on the build plate: {wash.on_plate_min:g} min in {wash.solvent}",
        f"Take the parts off the plate; wash {wash.off_plate_min:g} min in {wash.rinse}",
        "Dry until no solvent is left in the sockets",
        "Clip supports: " + (_supported(c) or "there are none"),
        f"Post-cure {printer.cure_min:g} min",
        "Put one passive spring into one mass by hand. It must rotate a little to either side. If not, "
        "correct `allowance` and write the packet again",
        "Count the parts against bom.csv; weigh one mass and one passive spring",
    ]
    page = _Page("Traveller")
    page.table([f"{i}. {step}" for i, step in enumerate(steps, start=1)])
    page.heading("Warnings")
    page.list(
        [
            "Heat: coils reach 60 C and more where they sit in the resin. The heat-deflection temperature of "
            "the resin is not known. Look at the mounts after every run; stop if one has moved or softened.",
            f"Never connect a coil to a supply without a current limit ({c.spec.coil.current_limit_a:g} A at "
            "most) and an independent cut-off. A coil that stays on damages itself and the parts by heat.",
            "Uncured resin and its solvents: wear gloves and glasses, and ventilate the room.",
        ]
    )
    page.heading("Findings of the build filter")
    page.list(_shortened([f"{v.severity}: {v}" for v in c.report.violations]) or ["none"])
    return [page.figure]


def order_of_work(c: Content) -> list[Figure]:
    """From parts to a wired robot, beside the assembly map."""
    discs = ", ".join(f"m{i + 1} on mass {mass}" for i, mass in enumerate(c.assembly.marks))
    steps = [
        "Lay out the front masses (one line under the number), floors down and sockets up, as in the lower "
        "drawing of the assembly map",
        "Press every passive spring into its two sockets, from above, until it sits on the floor",
        f"Push each coil over two spring ends, {c.spec.fitting.stud_length:g} mm deep; lead its wire out "
        "through the guide; press the ends into the sockets of the motors' masses",
        "Press a cap on every mass with six springs, a connector on every other mass",
        "Build the back plane in the same way (two lines under the number; upper drawing of the map). Press "
        "it on the connectors; glue the pegs with a drop of resin and cure it",
        f"Stick the discs into their seats on the front face: {discs}",
        "Measure the resistance of every coil; write it into wiring.csv and into the rig file",
        "Wire each coil to its relay channel (wiring.csv); lead the wires outwards and up, at "
        "least as long as listed",
    ]
    if c.variant.ballast is not None:
        steps.append(
            f"Glue a ballast holder over the outside of mass {c.variant.ballast.mass}, on both faces; glue "
            f"{c.filling:.2f} g of steel shot into each, {c.variant.ballast.grams:g} g with the holders"
        )
    page = _Page("Order of work")
    page.table([f"{i}. {step}" for i, step in enumerate(steps, start=1)])
    return [page.figure]


def _supported(c: Content) -> str:
    names: dict[str, list[str]] = {}
    for name, found in c.inspections.items():
        if found.support_levels:
            levels = " and ".join(f"{z:g}" for z in found.support_levels)
            names.setdefault(f"{levels} mm above the plate", []).append(name)
    return "; ".join(f"{where}: {', '.join(parts)}" for where, parts in names.items())


def _shortened(notes: list[str]) -> list[str]:
    if len(notes) <= _NOTES:
        return notes
    return [*notes[:_NOTES], f"and {len(notes) - _NOTES} more in manifest.json"]


class _Page:
    """A page of text, filled from the top."""

    def __init__(self, title: str):
        self.figure = Figure(figsize=_PAGE)
        self.figure.text(_LEFT, 0.955, title, fontsize=16, weight="bold")
        self.figure.text(0.92, 0.955, "robot: ____________________", fontsize=9, ha="right")
        self._y = _TOP

    def heading(self, text: str) -> None:
        self._y -= 1.5 * _LINE
        self.figure.text(_LEFT, self._y, text, fontsize=11, weight="bold", va="top")
        self._y -= 1.5 * _LINE

    def list(self, items: Sequence[str]) -> None:
        for item in items:
            self._lines("- " + item, _WRAP + 8)
            self._y -= 0.4 * _LINE

    def table(self, steps: Sequence[str]) -> None:
        """Steps with a box to tick and room for date and initials."""
        self.figure.text(0.70, self._y, "done     date            initials", fontsize=8, va="top")
        self._y -= 1.6 * _LINE
        for step in steps:
            top = self._y
            box = Rectangle(
                (0.705, top - 0.013), 0.018, 0.0127, fill=False, transform=self.figure.transFigure
            )
            self.figure.add_artist(box)
            self.figure.text(0.75, top, "____________  ________", fontsize=8, va="top")
            self._lines(step, _WRAP - 24)
            self._y -= 0.6 * _LINE

    def _lines(self, text: str, width: int) -> None:
        lines = textwrap.wrap(text, width, subsequent_indent="   ")
        self.figure.text(_LEFT, self._y, "\n".join(lines), fontsize=9, va="top", linespacing=1.3)
        self._y -= _LINE * len(lines) * 0.85
