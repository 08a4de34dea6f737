"""Pages of HTML; and a page with its figures and tables as one folder."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.files import new_folder, write_bytes, write_text
from eldir.core.pictures import png, svg

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure


def page_templates(package: str, **filters: Callable[[float], str]) -> Environment:
    """The templates of a package. Values are escaped, and a name that the values do not have is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader(package),
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
