"""Figures as bytes, and a page of HTML with its figures and tables as one folder.

The same figure gives the same bytes. The colours of a robot's parts are the same in every picture, from the
palette of Okabe and Ito for colour-blind readers.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from eldir.core.files import new_folder, write_bytes, write_text

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOTOR = "#D55E00"
"""Active springs, also where they are drawn at rest."""
MOTOR_SHORT, MOTOR_LONG = "#6B2F00", "#F5B98A"
"""A motor wholly contracted, wholly expanded: darker and lighter, so that a grey print tells them too."""
PASSIVE = "#9A9A9A"
MARK = "#0072B2"
"""Marked masses m1 to m5."""
GROUND = "#D9CDB8"


class Plot(NamedTuple):
    """A figure of a page, or why it is left out."""

    caption: str
    draw: Callable[[], Figure]
    missing: str = ""
    """What it would show, and why there is nothing to draw; empty if it is drawn."""


def draw_plots(plots: Mapping[str, Plot]) -> tuple[dict[str, Figure], list[str]]:
    """The figures by name, and what is left out, each reason once."""
    drawn = {name: plot.draw() for name, plot in plots.items() if not plot.missing}
    return drawn, list(dict.fromkeys(plot.missing for plot in plots.values() if plot.missing))


def new_axes(width: float, height: float, **labels: str) -> tuple[Figure, Axes]:
    """An empty figure of this size [inch] with one pair of axes; `labels` such as xlabel."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.add_subplot(**labels)
    hide_frame(axes)
    return figure, axes


def hide_frame(*plots: Axes) -> None:
    """Leave out the frame above and to the right."""
    for axes in plots:
        axes.spines[["top", "right"]].set_visible(False)


def png(figure: Figure, dpi: int = 120) -> bytes:
    """The figure as PNG, with `dpi` dots an inch."""
    return _written(figure, "png", dpi, {"Software": None})


def svg(figure: Figure) -> bytes:
    """The figure as SVG, with identifiers that are the same every time."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "eldir"}):
        return _written(figure, "svg", 150, {"Date": None})


def pdf(figures: Iterable[Figure]) -> bytes:
    """The figures as pages of a PDF without dates; the same figures give the same bytes."""
    from matplotlib.backends.backend_pdf import PdfPages

    buffer = io.BytesIO()
    with PdfPages(buffer, metadata={"CreationDate": None}) as pages:
        for figure in figures:
            pages.savefig(figure)
    return buffer.getvalue()


def _written(figure: Figure, kind: str, dpi: int, metadata: dict[str, None]) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def page_templates(package: str, **filters: Callable[[float], str]) -> Environment:
    """The templates of a package, and `page.css`, the style of all pages. Values are escaped, and a name that
    the values do not have is an error."""
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("eldir.core")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(filters)
    return environment


def write_figures(folder: Path, page: str, figures: Mapping[str, Figure], tables: Mapping[str, str]) -> None:
    """Write `index.html`, every figure as SVG and PNG, and every table as CSV into a new folder, whole or
    not at all. Raises `EldirError` where the folder exists."""
    with new_folder(folder) as draft:
        for name, figure in figures.items():
            write_bytes(draft / f"{name}.svg", svg(figure))
            write_bytes(draft / f"{name}.png", png(figure, dpi=150))
        for name, table in tables.items():
            write_text(draft / f"{name}.csv", table)
        write_text(draft / "index.html", page)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table as CSV; numbers with seven digits."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([_plain(v) for v in row] for row in rows)
    return buffer.getvalue()


def _plain(value: Any) -> Any:
    return float(f"{value:.7g}") if isinstance(value, float | np.floating) else value
