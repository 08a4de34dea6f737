"""The report's figures: PNG bytes that repeat, colours that the colour-blind tell apart."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.comparison import KINDS, PHASES, Motion, MotionReport
from eldir.frozen import BoolArray, FloatArray

# Okabe and Ito's palette, and a line of its own for each kind, so that a grey print reads too.
COLOURS = {"simulated": "#0072B2", "predicted": "#E69F00", "tracked": "#000000"}
STYLES = {"simulated": ":", "predicted": "--", "tracked": "-"}
LABELS = {
    "simulated": "evolved (closed loop)",
    "predicted": "predicted (this schedule)",
    "tracked": "camera",
}
_CHANNELS = ["#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#009E73", "#CC79A7", "#000000", "#999999"]


def png(figure: Figure) -> bytes:
    """The same figure gives the same bytes."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=120, bbox_inches="tight", metadata={"Software": None})
    return buffer.getvalue()


def ranges(report: MotionReport) -> Figure:
    """Vertical range of motion of every mass, bars with 95 % intervals over cycles."""
    figure, axes = _figure(7.0, 3.2)
    x = np.arange(len(report.names))
    for i, kind in enumerate(KINDS):
        estimates = report.ranges[kind]
        mean = np.array([e.mean for e in estimates]) * 1e3
        high = np.array([e.high for e in estimates]) * 1e3
        axes.bar(
            x + 0.27 * (i - 1), mean, 0.25, yerr=np.nan_to_num(high - mean), capsize=3,
            color=COLOURS[kind], label=LABELS[kind], hatch=("//", "..", None)[i], edgecolor="white",
            ecolor="#777777",
        )  # fmt: skip
    axes.set_xticks(x, report.names)
    axes.set_ylabel("vertical range (mm)")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def paths(motions: dict[str, Motion]) -> Figure:
    """Where each mass went, from its place at the first cycle's start."""
    figure, axes = _figure(7.0, 3.4)
    for kind in KINDS:
        motion = motions[kind]
        folded = motion.by_phase().reshape(-1, len(motion.trajectory.names), 2)
        origin = folded[0].mean(axis=0)
        for k in range(folded.shape[1]):
            axes.plot(
                *(1e3 * (folded[:, k] - [origin[0], 0.0])).T, STYLES[kind], color=COLOURS[kind], lw=1.0,
                label=LABELS[kind] if k == 0 else None,
            )  # fmt: skip
    axes.set_xlabel("forward (mm)")
    axes.set_ylabel("height (mm)")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def heights(motions: dict[str, Motion], lag: int) -> Figure:
    """Height over the phase of a cycle: mean, and the band of all cycles."""
    names = motions["tracked"].trajectory.names
    figure = Figure(figsize=(7.0, 1.5 * len(names) + 0.6), layout="constrained")
    rows = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    phase = (np.arange(PHASES) + 0.5) / PHASES
    for kind in KINDS:
        y = motions[kind].by_phase()[..., 1] * 1e3
        y = np.roll(y, lag if kind == "simulated" else 0, axis=1)
        y = y - y.mean(axis=1, keepdims=True)
        for k, axes in enumerate(rows):
            axes.plot(phase, y[:, :, k].mean(axis=0), STYLES[kind], color=COLOURS[kind], label=LABELS[kind])
            axes.fill_between(
                phase, y[:, :, k].min(axis=0), y[:, :, k].max(axis=0), color=COLOURS[kind], alpha=0.15, lw=0
            )
    for name, axes in zip(names, rows, strict=True):
        axes.set_ylabel(f"{name} (mm)")
        _plain(axes)
    rows[-1].set_xlabel("phase of the actuation cycle")
    rows[0].legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def advance(motions: dict[str, Motion]) -> Figure:
    """Forward motion over the cycles, in body lengths."""
    figure, axes = _figure(7.0, 2.8)
    for kind in KINDS:
        axes.plot(*motions[kind].advance(), STYLES[kind], color=COLOURS[kind], label=LABELS[kind])
    axes.axhline(0, color="#999999", lw=0.6)
    axes.set_xlabel("actuation cycles")
    axes.set_ylabel("forward (body lengths)")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def heating(
    relay_times: FloatArray,
    relays: BoolArray,
    channels: tuple[str, ...],
    temperature_times: FloatArray,
    temperatures: FloatArray,
    springs: tuple[str, ...],
) -> Figure:
    """Relay contacts as read back, and modelled temperatures."""
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1, 2])
    for c, channel in enumerate(channels):
        top.fill_between(
            relay_times, c, c + 0.8 * relays[:, c], step="post", color=_CHANNELS[c % 8], lw=0, label=channel
        )
    top.set_yticks(np.arange(len(channels)) + 0.4, channels, fontsize=7)
    top.set_ylabel("closed")
    for s, spring in enumerate(springs):
        bottom.plot(
            temperature_times, temperatures[:, s], ("-", "--", "-.", ":")[s % 4], color=_CHANNELS[s % 8],
            label=spring,
        )  # fmt: skip
    bottom.axhline(90, color="#D55E00", lw=0.8)
    bottom.text(0.01, 91, "ceiling", color="#D55E00", fontsize=7, transform=bottom.get_yaxis_transform())
    bottom.set_ylabel("spring (°C), modelled")
    bottom.set_xlabel("time (s)")
    if springs:
        bottom.legend(frameon=False, fontsize=7, ncols=4, loc="upper right")
    _plain(top)
    _plain(bottom)
    return figure


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots()
    _plain(axes)
    return figure, axes


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
