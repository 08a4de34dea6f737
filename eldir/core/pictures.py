"""Figures as bytes; the same figure gives the same bytes."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def png(figure: Figure, dpi: int = 120) -> bytes:
    """The figure as PNG, with `dpi` dots an inch."""
    return _written(figure, "png", dpi, {"Software": None})


def svg(figure: Figure) -> bytes:
    """The figure as SVG, with identifiers that are the same every time."""
    from matplotlib import rc_context

    with rc_context({"svg.hashsalt": "eldir"}):
        return _written(figure, "svg", 150, {"Date": None})


def _written(figure: Figure, kind: str, dpi: int, metadata: dict[str, None]) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()
