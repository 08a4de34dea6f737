"""Figures as bytes; the same figure gives the same bytes. Colours of a robot's parts in every picture, from
the palette of Okabe and Ito for colour-blind readers."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOTOR = "#D55E00"
"""Active springs, also where they are drawn at rest."""
MOTOR_SHORT, MOTOR_LONG = "#6B2F00", "#F5B98A"
"""A motor wholly contracted, wholly expanded: darker and lighter, so that a grey print tells them too."""
PASSIVE = "#9A9A9A"
MARK = "#0072B2"
"""Marked masses m1 to m5."""
GROUND = "#D9CDB8"


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
