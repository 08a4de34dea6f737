"""The wiring diagram of the bench, drawn from the connections of a packet: a row for each relay channel."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from eldir.core.pictures import MARK, MOTOR
from eldir.parameters.bench import TIMER_S
from eldir.parameters.wiring import Connection, Wiring, wiring_digest
from eldir_cad.packet._circuit import Circuit
from eldir_cad.packet._layout import Sign, cover_page, draw_legend

_ROWS = 6  # on a page; all places are in centimetres
_SUPPLY, _FUSE, _RELAY, _NODE, _TIMER, _TERMINAL, _COIL, _END = 5.6, 8.2, 11.2, 13.7, 16.6, 19.2, 20.9, 28.6
_TOP, _BOTTOM = 18.2, 4.6
_RETURN = 0.75  # of a row's return line, below the row
_HALF = 0.45  # half a symbol's width
_COIL_WIDTH = 2.6


def draw_wiring(connections: Wiring, circuits: dict[int, Circuit]) -> list[Figure]:
    """Pages with the circuit of every relay channel. `circuits`: the ratings of each, by channel."""
    pages = [connections[i : i + _ROWS] for i in range(0, len(connections), _ROWS)]
    return [_draw_page(page, connections, circuits) for page in pages]


def _draw_page(rows: Wiring, connections: Wiring, circuits: dict[int, Circuit]) -> Figure:
    figure = Figure(figsize=(11.7, 8.3))
    figure.text(0.03, 0.965, "Wiring diagram", fontsize=14, weight="bold", va="top")
    digest = f"wiring {wiring_digest(connections)[:8]}"
    figure.text(0.97, 0.965, digest, fontsize=8, va="top", ha="right")
    axes = cover_page(figure)
    pitch = min(5.0, (_TOP - _BOTTOM) / len(rows))
    heights = [_TOP - 0.8 - pitch * i for i in range(len(rows))]
    _draw_source(axes, heights, circuits[rows[0].channel])
    for y, connection in zip(heights, rows, strict=True):
        _draw_channel(axes, y, connection, circuits[connection.channel])
    _draw_board(axes, heights, rows)
    draw_legend(axes, _LEGEND, 3.3)
    return figure


def _draw_source(axes: Axes, heights: list[float], circuit: Circuit) -> None:
    """Mains, switch, contact of the fan's interlock and the supply with its outputs, on the left."""
    top, bottom = heights[0] + 0.7, heights[-1] - _RETURN - 0.5
    axes.add_patch(Rectangle((3.6, bottom), _SUPPLY - 3.6, top - bottom, fc="#f2f2f2", ec="black", lw=1.0))
    springs = circuit.springs
    text = f"supply\n{springs.supply_voltage:g} V\nlimit\n{circuit.current_limit:g} A\neach"
    _write(axes, 4.25, (top + bottom) / 2, text, 8, weight="bold")
    y = top - 0.5
    axes.plot([0.6, 1.0], [y, y], color="black", lw=1.2)
    axes.plot(0.6, y, "o", color="black", ms=4)
    _write(axes, 0.6, y + 0.45, "input", 7)
    _contact(axes, 1.45, y)
    _write(axes, 1.45, y - 0.35, "S1", 7)
    axes.plot([1.9, 2.1], [y, y], color="black", lw=1.2)
    _contact(axes, 2.55, y)
    _write(axes, 2.55, y - 0.35, "K0", 7)
    axes.plot([3.0, 3.6], [y, y], color="black", lw=1.2)
    low = y - 1.9
    axes.add_patch(Rectangle((1.75, low - 0.5), 1.6, 1.0, fc="white", ec="black", lw=1.0))
    _write(axes, 2.55, low, "fan", 8)
    _link(axes, (2.55, 2.55), (low + 0.5, y - 0.6))
    _write(axes, 1.75, low - 0.85, "K0 is closed only\nwhile the fan turns", 6.5)


def _draw_channel(axes: Axes, y: float, connection: Connection, circuit: Circuit) -> None:
    """From an output through fuse, contact, timer and coils, and back."""
    n = connection.channel
    axes.plot([_SUPPLY, _END], [y, y], color="black", lw=1.2, zorder=1)
    below = y - _RETURN
    axes.plot([_END, _END, _SUPPLY], [y, below, below], color="black", lw=1.2, zorder=1)
    _write(axes, _SUPPLY - 0.35, y, f"{n}+", 8)
    _write(axes, _SUPPLY - 0.35, below, f"{n}-", 8)
    _fuse(axes, _FUSE, y)
    _write(axes, _FUSE, y + 0.42, f"F{n}  {circuit.fuse:g} A F", 7)
    _contact(axes, _RELAY, y)
    _write(axes, _RELAY, y - 0.32, f"K{n}", 7)
    axes.add_patch(Circle((_NODE, y), 0.09, color="black", zorder=3))
    axes.add_patch(Circle((_NODE + 0.8, below), 0.09, color="black", zorder=3))
    middle = y - _RETURN / 2
    axes.plot([_NODE, _NODE], [y, middle + 0.18], color="black", lw=0.8)
    axes.plot([_NODE, _NODE + 0.8, _NODE + 0.8], [middle - 0.18, middle - 0.18, below], color="black", lw=0.8)
    _box(axes, _NODE - 0.35, middle - 0.18, 1.5, 0.36)
    _write(axes, _NODE + 0.4, middle, f"T{n}", 6.5, zorder=5)
    _contact(axes, _TIMER, y, opens=True)
    _write(axes, _TIMER, y + 0.5, f"T{n}  {TIMER_S:g} s", 7)
    for at in (y, below):
        _terminal(axes, _TERMINAL, at)
    _write(axes, _TERMINAL, y + 0.42, f"X{n}", 7)
    faces = connection.faces
    for i, face in enumerate(faces):
        left = _COIL + i * (_COIL_WIDTH + 1.2)
        _coil(axes, left, y)
        for end in (left, left + _COIL_WIDTH):
            _crimp(axes, end, y)
        label = f"S{connection.spring} {face}"
        _write(axes, left + _COIL_WIDTH / 2, y + 0.5, label, 8, weight="bold", color=MOTOR)
    series = " in series" if len(faces) > 1 else ""
    total = f"{circuit.resistance:.2f} Ohm{series}, {circuit.loaded_voltage:.1f} V while it heats"
    _write(axes, _END - 0.1, below - 0.3, total, 6.5, ha="right")


def _draw_board(axes: Axes, heights: list[float], rows: Wiring) -> None:
    """The relay board, whose contacts the rows show."""
    y = heights[-1] - _RETURN - 1.2
    axes.add_patch(Rectangle((_RELAY - 1.7, y - 0.5), 3.4, 0.8, fc="#f2f2f2", ec="black", lw=1.0))
    names = f"K{rows[0].channel}" + (f" to K{rows[-1].channel}" if len(rows) > 1 else "")
    _write(axes, _RELAY, y - 0.1, f"relay board, {names}", 7)
    _link(axes, (_RELAY + 1.7, _RELAY + 2.7), (y - 0.1, y - 0.1))
    _write(axes, _RELAY + 2.8, y - 0.1, "USB to the computer", 7, ha="left")
    _link(axes, (_RELAY, _RELAY), (y + 0.3, heights[-1] - 0.5))


def _box(axes: Axes, left: float, bottom: float, width: float, height: float) -> None:
    axes.add_patch(Rectangle((left, bottom), width, height, fc="white", ec="black", lw=0.8, zorder=4))


def _terminal(axes: Axes, x: float, y: float) -> None:
    axes.plot(x, y, "s", mfc="white", mec="black", ms=6, zorder=4)


def _crimp(axes: Axes, x: float, y: float) -> None:
    axes.plot(x, y, "D", color=MARK, ms=4, zorder=5)


def _link(axes: Axes, x: tuple[float, float], y: tuple[float, float]) -> None:
    axes.plot(x, y, color="black", lw=0.8, ls=(0, (3, 2)))


def _fuse(axes: Axes, x: float, y: float) -> None:
    axes.plot([x - _HALF - 0.2, x + _HALF + 0.2], [y, y], color="black", lw=1.2, zorder=3)
    axes.add_patch(Rectangle((x - _HALF, y - 0.16), 2 * _HALF, 0.32, fc="none", ec="black", lw=1.2, zorder=3))


def _contact(axes: Axes, x: float, y: float, opens: bool = False) -> None:
    """A contact at rest: open, or, if it `opens`, closed."""
    white = Rectangle((x - _HALF, y - 0.1), 2 * _HALF, 0.2, fc="white", ec="none", zorder=2)
    axes.add_patch(white)
    rise = 0.12 if opens else 0.38
    axes.plot([x - _HALF, x + _HALF - 0.02], [y, y + rise], color="black", lw=1.4, zorder=3)
    if opens:  # it lies against its fixed contact
        axes.plot(
            [x + _HALF - 0.1, x + _HALF - 0.1, x + _HALF], [y + 0.3, y, y], color="black", lw=1.4, zorder=3
        )
    axes.plot(x - _HALF, y, "o", color="black", ms=2.5, zorder=4)


def _coil(axes: Axes, left: float, y: float, width: float = _COIL_WIDTH) -> None:
    axes.add_patch(Rectangle((left, y - 0.1), width, 0.2, fc="white", ec="none", zorder=2))
    t = np.linspace(0.0, 1.0, 161)
    axes.plot(left + width * t, y + 0.26 * np.abs(np.sin(6 * np.pi * t)), color=MOTOR, lw=1.6, zorder=3)


def _write(
    axes: Axes,
    x: float,
    y: float,
    text: str,
    size: float,
    ha: str = "center",
    weight: str = "normal",
    color: str = "black",
    zorder: int = 6,
) -> None:
    axes.text(
        x,
        y,
        text,
        fontsize=size,
        ha=ha,
        va="center",
        weight=weight,
        color=color,
        zorder=zorder,
        linespacing=1.3,
    )


_LEGEND: tuple[tuple[Sign, str], ...] = (
    (_fuse, "F: fuse, quick-acting"),
    (
        _contact,
        "S1: main switch within reach; K: contact that is open at rest",
    ),
    (
        lambda axes, x, y: _contact(axes, x, y, opens=True),
        "T: contact of the timer relay, closed at rest; opens when its time is up",
    ),
    (
        lambda axes, x, y: _box(axes, x - 0.6, y - 0.18, 1.2, 0.36),
        "T: control input of the timer relay, which has a supply of its own",
    ),
    (_terminal, "X: terminal over the robot"),
    (_crimp, "crimp: lead and Nitinol wire in a ferrule"),
    (lambda axes, x, y: _coil(axes, x - 0.7, y, 1.4), "S: shape-memory coil, motor and face"),
    (
        lambda axes, x, y: _link(axes, (x - 0.7, x + 0.7), (y, y)),
        "acts on, not a wire of the heating circuit",
    ),
)
