"""Pictures of a robot: masses, passive springs grey, motors orange-red, m1 to m5 and the ground."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir.core.pictures import GROUND, MARK, MOTOR, MOTOR_LONG, MOTOR_SHORT, PASSIVE
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.printed import BuiltParameters
from eldir.rollout import Rollout
from eldir.terrain import Terrain

if TYPE_CHECKING:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

_LEGEND = ((0.99, "passive", PASSIVE), (0.91, "motor, dark: short", MOTOR), (0.80, "m1 to m5", MARK))
_MARGIN = 0.08  # around everything that is drawn [m]
_MASS = "#303030"
PRINTED_SPEED = 10
"""How many times faster than the robot its film is."""
_PRINTED_MARGIN = 0.03  # around a printed robot [m]
_WIDTH = 12.8  # of the picture [inch]
_DPI = 100


class Drawing:
    """Drawing of one robot on its ground; the view contains all positions at which the robot will be
    drawn."""

    def __init__(
        self,
        design: Design,
        positions: FloatArray,
        outline: Callable[[float, float], FloatArray] | None = None,
        margin: float = _MARGIN,
        mass_diameter: float | None = None,
    ):
        """`positions`: all those at which the robot will be drawn [m], shape (T, M, 2). `outline`: gives the
        corners of the surface of the ground, x and height [m], shape (K, 2), between two places; by default
        that of the scene. `margin`: around everything [m]. `mass_diameter` [m]: by default that of a dot."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection
        from matplotlib.colors import LinearSegmentedColormap, to_rgba
        from matplotlib.figure import Figure

        body = design.morphology
        finite = positions[np.isfinite(positions).all(axis=(1, 2))]
        low, high = finite.min(axis=(0, 1)) - margin, finite.max(axis=(0, 1)) + margin
        outline = design.scene.terrain.outline if outline is None else outline
        ground = outline(low[0], high[0])[:, 1]
        low[1], high[1] = min(low[1], ground.min() - margin), max(high[1], ground.max())
        width, height = high - low
        # Video codecs want even numbers of pixels.
        rows = int(np.clip(_WIDTH * _DPI * height / width, 240, 960)) // 2 * 2
        # What the clipping leaves free is shared by both sides.
        spare = max(0.0, height * _WIDTH * _DPI / rows - width) / 2
        low[0], high[0] = low[0] - spare, high[0] + spare
        x, ground = outline(low[0], high[0]).T
        self._figure = Figure(figsize=(_WIDTH, rows / _DPI), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        axes = self._figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.axis("off")
        axes.fill_between(x, ground, low[1] - 1.0, color=GROUND, lw=0)
        self._springs, self._active = body.springs, body.active
        self._shade = LinearSegmentedColormap.from_list("actuation", [MOTOR_SHORT, MOTOR, MOTOR_LONG], 255)
        self._colours = np.array([to_rgba(PASSIVE)] * len(body.springs))
        hubs = mass_diameter is not None
        motor, passive = (8.0, 3.0) if hubs else (4.0, 1.5)
        self._lines = LineCollection([], linewidths=np.where(body.active, motor, passive))
        axes.add_collection(self._lines, autolim=False)
        points = 4.2 if mass_diameter is None else 72 * _WIDTH * mass_diameter / (high[0] - low[0])
        self._marks = design.marks
        colours = np.full(len(body.positions), _MASS)
        if hubs:
            colours[self._marks] = MARK
        rest = np.zeros(len(colours))
        self._masses = axes.scatter(rest, rest, s=points**2, color=colours, zorder=3)
        size = 16 if hubs else None
        name: dict[str, Any] = {"xytext": (-16, 4), "color": MARK}
        if hubs:
            name = {"xytext": (0, 0), "color": "white", "va": "center", "weight": "bold"}
        self._names = [
            axes.annotate(
                f"m{i + 1}", (0.0, 0.0), textcoords="offset points", ha="center", fontsize=size, **name
            )
            for i in range(len(self._marks))
        ]
        common: dict[str, Any] = {"transform": axes.transAxes, "va": "top", "fontsize": size}
        for place, text, colour in _LEGEND[: 2 if hubs else 3]:
            axes.text(place, 0.97, text, ha="right", color=colour, **common)
        self._time = axes.text(0.01, 0.97, "", family="monospace", **common)

    def at(self, positions: FloatArray, actuation: FloatArray, text: str = "") -> FigureCanvasAgg:
        """The robot with its masses at `positions` [m], shape (M, 2), its motors coloured by `actuation`
        from -1 to 1, shape (A,), and a line of text."""
        self._lines.set_segments(list(positions[self._springs]))
        self._colours[self._active] = self._shade(0.5 + 0.5 * actuation)
        self._lines.set_color(list(self._colours))
        self._masses.set_offsets(positions)
        for name, mass in zip(self._names, self._marks, strict=True):
            name.xy = tuple(positions[mass])
        self._time.set_text(text)
        self._canvas.draw()
        return self._canvas


def picture(design: Design) -> bytes:
    """The robot at rest, as PNG."""
    rest = placed(design)
    canvas = Drawing(design, rest[None]).at(rest, np.zeros(design.morphology.motors))
    buffer = io.BytesIO()
    canvas.print_png(buffer)
    return buffer.getvalue()


def frames(design: Design, rollout: Rollout, rate: int) -> Iterator[np.ndarray]:
    """RGB frames (height, width, 3) uint8 of a rollout, `rate` a second of simulated time; a robot
    that diverged is shown until then."""
    drawing = Drawing(design, rollout.positions)
    start = rollout.positions[0, :, 0].mean()
    duration = (len(rollout.positions) - 1) * design.scene.dt
    for t in np.arange(0.0, duration + 1e-9, 1.0 / rate):
        state = round(t / design.scene.dt)
        positions = rollout.positions[state]
        if not np.isfinite(positions).all():
            return
        actuation = rollout.activations[min(state, len(rollout.activations) - 1)]  # the last state has none
        canvas = drawing.at(positions, actuation, f"{t:5.2f} s  {positions[:, 0].mean() - start:+.3f} m")
        yield np.asarray(canvas.buffer_rgba())[..., :3]


def printed_frames(
    design: Design, times: FloatArray, positions: FloatArray, begin: float, body_length: float, rate: int
) -> Iterator[np.ndarray]:
    """RGB frames (height, width, 3) uint8 of a printed robot, `PRINTED_SPEED` times as fast as it is, `rate`
    a second, from `begin` on, when the cycles that count begin.

    `times` [s], shape (T,); `positions` of its masses [m], shape (T, M, 2), whose heights count from where
    the centre of a mass is that stands; `body_length` [m]. A motor is dark where it is shortest in the film.
    """
    shown = times >= begin
    times, positions = times[shown], positions[shown]
    corner = BuiltParameters().with_hubs().corner
    terrain = design.printed_terrain or Terrain(np.zeros(1), np.zeros(1), np.zeros(1))
    lengths = np.linalg.norm(np.subtract(*np.moveaxis(positions[:, design.morphology.springs], 2, 0)), axis=2)
    lengths = lengths[:, design.morphology.active]
    stroke = np.maximum(np.ptp(lengths, axis=0), 1e-9)
    actuation = 2 * (lengths - lengths.min(axis=0)) / stroke - 1
    drawing = Drawing(
        design, positions, lambda a, b: terrain.outline(a, b) - [0.0, corner], _PRINTED_MARGIN, 2 * corner
    )
    start = positions[0, design.marks, 0].mean()
    for t in np.arange(times[0], times[-1] + 1e-9, PRINTED_SPEED / rate):
        now = int(np.abs(times - t).argmin())
        walked = (positions[now, design.marks, 0].mean() - start) / body_length
        text = f"{t - begin:3.0f} s  {walked:+.2f} body lengths  ({PRINTED_SPEED} x)"
        canvas = drawing.at(positions[now], actuation[now], text)
        yield np.asarray(canvas.buffer_rgba())[..., :3]


def placed(design: Design) -> FloatArray:
    """Rest positions [m], lifted until no mass is below the ground, shape (M, 2)."""
    rest = design.morphology.positions.copy()
    below = design.scene.terrain.height(rest[:, 0]) - rest[:, 1]
    rest[:, 1] += max(0.0, float(below.max()))
    return rest
