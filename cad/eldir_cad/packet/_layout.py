"""Layout of the PDF files: pages of text, tables and steps to sign, and their footers."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import Rectangle

_PAGE = (8.27, 11.69)  # A4 upright [inches]
_WIDE, _HIGH = 29.7, 21.0  # A4 on its side [cm]
_LEFT, _TOP, _BOTTOM, _LINE, _WRAP = 0.08, 0.93, 0.03, 0.0175, 92
_MIN_PICTURE = 0.3  # of the page's height


def add_footer(pages: Sequence[Figure], text: str) -> list[Figure]:
    """The pages with a line at the bottom that says which robot they are for, and their numbers."""
    for i, page in enumerate(pages, start=1):
        page.text(_LEFT, 0.006, f"{text}   page {i} of {len(pages)}", fontsize=6.5, color="#444444")
    return list(pages)


Sign = Callable[[Axes, float, float], object]
"""Draws a sign of a drawing at a place [cm]."""


def draw_legend(axes: Axes, entries: Sequence[tuple[Sign, str]], top: float, columns: int = 2) -> None:
    """A legend with the signs themselves, on axes in centimetres that are as wide as the page. `top`: height
    of its first row."""
    rows = -(-len(entries) // columns)
    for i, (draw, meaning) in enumerate(entries):
        column, row = divmod(i, rows)
        x, y = 1.6 + (_WIDE - 0.6) / columns * column, top - 0.65 * row
        draw(axes, x, y)
        axes.text(x + 1.1, y, meaning, fontsize=8, va="center")


def cover_page(figure: Figure, height: float = 1.0) -> Axes:
    """Axes in centimetres over the lower part of a page on its side, of this height."""
    axes = figure.add_axes((0, 0, 1, height))
    axes.set_xlim(0, _WIDE)
    axes.set_ylim(0, height * _HIGH)
    axes.axis("off")
    return axes


class Page:
    """A page of text, filled from the top; what does not fit continues on another page."""

    def __init__(self, title: str):
        self.figures: list[Figure] = []
        """The pages, the last one being filled."""
        self._title = title
        self._begin(title)

    @property
    def figure(self) -> Figure:
        """The page that is being filled."""
        return self.figures[-1]

    def _begin(self, title: str) -> None:
        self.figures.append(Figure(figsize=_PAGE))
        self.figure.text(_LEFT, 0.955, title, fontsize=16, weight="bold")
        self.figure.text(0.92, 0.955, "robot: ____________________", fontsize=9, ha="right")
        self._y = _TOP

    def _make_room(self, height: float) -> None:
        """Begin another page where this one has less than this part of a page's height left."""
        if self._y - height < _BOTTOM:
            self._begin(f"{self._title}, continued")

    def heading(self, text: str) -> None:
        self._make_room(6 * _LINE)  # with the lines below it
        self._y -= 1.5 * _LINE
        self.figure.text(_LEFT, self._y, text, fontsize=11, weight="bold", va="top")
        self._y -= 1.5 * _LINE

    def list(self, items: Sequence[str]) -> None:
        for item in items:
            self._write("- " + item, _WRAP + 8)
            self._y -= 0.4 * _LINE

    def table(self, steps: Sequence[str]) -> None:
        """Steps with a box to tick and room for date and initials."""
        self.figure.text(0.70, self._y, "done     date            initials", fontsize=8, va="top")
        self._y -= 1.6 * _LINE
        for step in steps:
            self._make_room(_height(_wrap(step, _WRAP - 24)))
            top = self._y
            box = Rectangle(
                (0.705, top - 0.013), 0.018, 0.0127, fill=False, transform=self.figure.transFigure
            )
            self.figure.add_artist(box)
            self.figure.text(0.75, top, "____________  ________", fontsize=8, va="top")
            self._write(step, _WRAP - 24)
            self._y -= 0.6 * _LINE

    def rows(
        self, rows: Sequence[Sequence[str]], columns: Sequence[tuple[float, int]], size: float = 8
    ) -> None:
        """A table without lines. `columns`: the left edge of each, as a part of the page's width, and the
        number of characters after which its text is wrapped."""
        for row in rows:
            cells = [textwrap.wrap(text, width) for text, (_, width) in zip(row, columns, strict=True)]
            height = _LINE * (0.85 * size / 9 * max(map(len, cells)) + 0.3)
            self._make_room(height)
            for lines, (left, _) in zip(cells, columns, strict=True):
                self.figure.text(left, self._y, "\n".join(lines), fontsize=size, va="top", linespacing=1.3)
            self._y -= height

    def reserve(self, height: float) -> float:
        """Leave room for a drawing of this height; its upper edge. Both are parts of the page's height."""
        self._make_room(height)
        self._y -= height
        return self._y + height

    def picture(self, png: bytes, caption: str) -> None:
        """A picture over the rest of the page, as large as it fits, with its caption."""
        self._make_room(_MIN_PICTURE)
        self.figure.text(_LEFT, self._y - _LINE, caption, fontsize=9, va="top")
        height = self._y - 2.5 * _LINE - _BOTTOM
        axes = self.figure.add_axes((_LEFT, _BOTTOM, 1 - 2 * _LEFT, height))
        axes.imshow(imread(io.BytesIO(png)), interpolation="none")
        axes.axis("off")

    def _write(self, text: str, width: int) -> None:
        lines = _wrap(text, width)
        self._make_room(_height(lines))
        self.figure.text(_LEFT, self._y, "\n".join(lines), fontsize=9, va="top", linespacing=1.3)
        self._y -= _height(lines)


def _wrap(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width, subsequent_indent="   ")


def _height(lines: Sequence[str]) -> float:
    """Height of lines of text [page]."""
    return _LINE * len(lines) * 0.85
