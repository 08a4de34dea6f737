"""Figures of an identification: intervals, held-out cycle, what explains the ranges, what to film next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from eldir.built.scene import PrintedScene
from eldir.core.pictures import new_axes
from eldir_calibration.dynamics.identifiability import Experiment, RangeAttribution

_ZERO_CHANGE = 0.05  # changes that print as zero [mm]
_BEFORE, _AFTER, _CAMERA = "#E69F00", "#0072B2", "#000000"


def draw_intervals(scene: PrintedScene) -> Figure:
    """Every quantity over its nominal value, with its 95 % interval; open circles were not identified."""
    listed = {n: q for n, q in scene.identification.quantities.items() if n != "transition"}
    figure, axes = new_axes(7.0, 0.28 * len(listed) + 0.9, xlabel="value / nominal value")
    for row, (name, q) in enumerate(reversed(listed.items())):
        low, high = (v / q.nominal for v in q.interval)
        axes.plot([low, high], [row, row], color=_AFTER, lw=2, alpha=1 if q.identified else 0.3)
        axes.plot(
            q.value / q.nominal,
            row,
            "o",
            color=_AFTER,
            mfc=_AFTER if q.identified else "white",
            ms=5,
        )
        axes.text(
            -0.01,
            row,
            _to_words(name),
            ha="right",
            va="center",
            fontsize=8,
            transform=axes.get_yaxis_transform(),
        )
    axes.axvline(1, color="#999999", lw=0.8)
    axes.set_xscale("log")
    ends = np.array([np.array(q.interval) / q.nominal for q in listed.values()])
    low, high = 0.93 * min(0.5, float(ends.min())), 1.07 * max(2.0, float(ends.max()))
    ticks = [t for t in (0.1, 0.2, 0.5, 0.7, 1, 1.5, 2, 5, 10) if low <= t <= high]
    axes.set_xticks(ticks, [f"{t:g}" for t in ticks], minor=False)
    axes.minorticks_off()
    axes.set_xlim(low, high)
    axes.set_yticks([])
    axes.set_title("Identified values with 95 % intervals; open: not identified", fontsize=9)
    axes.spines["left"].set_visible(False)
    return figure


def draw_attribution(found: RangeAttribution) -> Figure:
    """Change of the vertical range of motion by parameter: per standard deviation of its prior, and from
    nominal to identified."""
    figure = Figure(figsize=(8.0, 0.3 * len(found.parameters) + 1.9), layout="constrained")
    rest = found.change - found.shares.sum(axis=0)
    rows = (*(_to_words(name) for name in found.parameters), "not linear", "all")
    unknown = np.full((2, len(found.markers)), np.nan)  # so that a parameter has one row in both tables
    tables = (
        ("per standard deviation of the prior (mm)", np.vstack([found.sensitivities, unknown])),
        ("from nominal to identified (mm)", np.vstack([found.shares, rest, found.change])),
    )
    for axes, (title, values) in zip(figure.subplots(1, 2, sharey=True), tables, strict=True):
        limit = max(1e-9, float(np.nanmax(np.abs(values)))) * 1e3
        axes.imshow(1e3 * values, cmap="PuOr", vmin=-limit, vmax=limit, aspect="auto")
        for (i, j), value in np.ndenumerate(1e3 * values):
            axes.text(
                j, i, _format_millimetres(value), ha="center", va="center", fontsize=7,
                color="white" if abs(value) > 0.6 * limit else "black",
            )  # fmt: skip
        axes.set_yticks(range(len(rows)), rows, fontsize=8)
        axes.set_xticks(range(len(found.markers)), found.markers, fontsize=8)
        axes.set_title(title, fontsize=9)
    figure.suptitle(
        "Change of the vertical range of motion of each marker, by parameter\n"
        "violet: more, orange: less; each side has its own scale of colours",
        fontsize=9,
    )
    return figure


def _format_millimetres(value: float) -> str:
    """A change in millimetres; empty if unknown."""
    if np.isnan(value):
        return ""
    return "0" if abs(value) < _ZERO_CHANGE else f"{value:+.1f}"


def _to_words(name: str) -> str:
    return name.replace("_", " ")


def draw_experiments(found: Sequence[Experiment]) -> Figure:
    """Expected information of a film of each gait."""
    figure, axes = new_axes(6.0, 0.3 * len(found) + 0.9)
    labels = [", ".join(f"{p:g}" for p in e.gait.phase) for e in found]
    axes.barh(range(len(found)), [e.information for e in found], color=_AFTER)
    axes.set_yticks(range(len(found)), labels, fontsize=8)
    axes.invert_yaxis()
    axes.set_ylabel("phases of the motors (periods)")
    axes.set_xlabel("expected information of one more cycle (bit)")
    axes.set_title("What to film next: expected information of each gait", fontsize=9)
    return figure


def draw_held_out(scene: PrintedScene, markers: Sequence[str]) -> Figure:
    """Vertical ranges in the held-out cycle, which the fit never saw."""
    figure, axes = new_axes(6.0, 3.0, ylabel="vertical range of motion (mm)")
    ranges = scene.identification.held_out_cycle.vertical_range_m
    x = np.arange(len(markers))
    for i, (kind, label, colour) in enumerate(
        (("before", "nominal", _BEFORE), ("after", "identified", _AFTER), ("tracked", "camera", _CAMERA))
    ):
        values = [np.nan if v is None else 1e3 * v for v in ranges[kind]]
        axes.bar(x + 0.27 * (i - 1), values, 0.25, label=label, color=colour, hatch=("//", "..", None)[i])
    axes.set_xticks(x, markers)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    figure.suptitle("Held-out cycle, which the fit did not see", fontsize=9)
    return figure
