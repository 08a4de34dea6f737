"""The report's figures, in colours that colour-blind readers can distinguish."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from eldir.core.pictures import hide_frame, new_axes
from eldir.core.records import BoolArray, FloatArray
from eldir.trajectory import mean_known
from eldir_calibration.report.comparison import (
    MOTION_KINDS,
    MOTION_NAMES,
    PHASE_SAMPLES,
    Motion,
    MotionReport,
    mean_cycle,
)
from eldir_calibration.report.controls import (
    PAPER_DISPLACEMENTS,
    FilmedRun,
    comparable_runs,
    pool_displacements,
)
from eldir_hardware.camera.plane import Image, Plane

# Okabe and Ito's palette, and a line of its own for each kind, so that a grey print reads too.
COLOURS = {"simulated": "#0072B2", "predicted": "#E69F00", "tracked": "#000000"}
STYLES = {"simulated": ":", "predicted": "--", "tracked": "-"}
LABELS = MOTION_NAMES | {"simulated": "learned (paper's scene)", "predicted": "predicted (this schedule)"}
ALT_TEXTS = {
    "frame": "Picture of the camera: the robot between reference tags, with a coloured line for the path of "
    "each marker.",
    "ranges": "Bars for each marker: learned, predicted and filmed vertical range, with error bars. "
    "The table of vertical ranges has their values.",
    "advance": "Three lines that rise from cycle to cycle: how far the learned, the predicted and the filmed "
    "robot have walked. The table of displacement has where they end.",
    "runs": "Bars for each robot: filmed and predicted displacement; beside them a line for each run. The "
    "table of robots has the values.",
    "cycles": "Picture of the camera: around each marker three closed curves, its mean cycle as learned, "
    "predicted and filmed.",
    "paths": "Height of each marker over its forward motion, three lines each: learned, predicted, filmed.",
    "heights": "One row for each marker: its height over a cycle as learned, predicted and filmed. The "
    "table of agreement has how well they match.",
    "profiles": "Marks on an axis from minus one to one: correlation with the film of the learned and the "
    "predicted profile, and of other bodies'.",
    "heating": "Three rows over time: forward motion, closed contacts as bands, modelled temperature of each "
    "spring, and a line at the rig's maximum.",
}
"""What each picture shows, for those who do not see it."""
_CYCLES_ASPECT = 1.5  # of the part of the picture that is shown
_CHANNELS = ["#0072B2", "#56B4E9", "#D55E00", "#E69F00", "#009E73", "#CC79A7", "#000000", "#999999"]


def draw_ranges(report: MotionReport) -> Figure:
    """Vertical range of motion of every mass, bars with 95 % intervals."""
    figure, axes = new_axes(7.0, 3.2, ylabel="vertical range (mm)")
    x = np.arange(len(report.names))
    for i, kind in enumerate(MOTION_KINDS):
        estimates = report.ranges[kind]
        mean = np.array([e.mean for e in estimates]) * 1e3
        low, high = (np.array([getattr(e, end) for e in estimates]) * 1e3 for end in ("low", "high"))
        # The interval of samples need not contain the nominal robot's value.
        arms = np.maximum(np.nan_to_num([mean - low, high - mean]), 0.0)
        axes.bar(
            x + 0.27 * (i - 1), mean, 0.25, yerr=arms, capsize=3,
            color=COLOURS[kind], label=LABELS[kind], hatch=("//", "..", None)[i], edgecolor="white",
            ecolor="#777777",
        )  # fmt: skip
    axes.set_xticks(x, report.names)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_paths(motions: dict[str, Motion]) -> Figure:
    """Path of each mass from its position at the start of the first cycle, where the marker has its name."""
    figure, axes = new_axes(7.0, 3.4, xlabel="forward (mm)", ylabel="height (mm)")
    names = motions["tracked"].trajectory.names
    for kind in MOTION_KINDS:
        motion = motions[kind]
        folded = motion.by_phase().reshape(-1, len(motion.trajectory.names), 2)
        origin = np.nan_to_num(mean_known(folded[0, :, 0], axis=0))
        for k in range(folded.shape[1]):
            axes.plot(
                *(1e3 * (folded[:, k] - [origin, 0.0])).T, STYLES[kind], color=COLOURS[kind], lw=1.0,
                label=LABELS[kind] if k == 0 else None,
            )  # fmt: skip
        if kind == "tracked":
            begins = (1e3 * (folded[0, k] - [origin, 0.0]) for k in range(len(names)))
            for name, place in zip(names, begins, strict=True):
                if np.isfinite(place).all():
                    axes.annotate(
                        name, place, (-6, 3), textcoords="offset points", ha="right", fontsize=8,
                        bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.5}, zorder=5,
                    )  # fmt: skip
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_heights(motions: dict[str, Motion], lag: int) -> Figure:
    """Height over the phase of a cycle: mean, and the band of all cycles in which the marker has a place
    throughout."""
    names = motions["tracked"].trajectory.names
    figure = Figure(figsize=(7.0, 1.5 * len(names) + 0.6), layout="constrained")
    rows = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    phase = (np.arange(PHASE_SAMPLES) + 0.5) / PHASE_SAMPLES
    for kind in MOTION_KINDS:
        y = motions[kind].by_phase()[..., 1] * 1e3
        y = np.roll(y, lag if kind == "simulated" else 0, axis=1)
        y = y - y.mean(axis=1, keepdims=True)
        for k, axes in enumerate(rows):
            whole = np.isfinite(y[:, :, k]).all(axis=1)
            one = y[whole, :, k] if whole.any() else y[:, :, k]  # the latter is drawn as nothing
            axes.plot(phase, one.mean(axis=0), STYLES[kind], color=COLOURS[kind], label=LABELS[kind])
            axes.fill_between(phase, one.min(axis=0), one.max(axis=0), color=COLOURS[kind], alpha=0.15, lw=0)
    for name, axes in zip(names, rows, strict=True):
        axes.set_ylabel(f"{name} (mm)")
    hide_frame(*rows)
    rows[-1].set_xlabel("phase of the actuation cycle")
    rows[0].legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_advance(motions: dict[str, Motion]) -> Figure:
    """Forward motion over the cycles, in body lengths."""
    figure, axes = new_axes(7.0, 2.8, xlabel="actuation cycles", ylabel="forward (body lengths)")
    for kind in MOTION_KINDS:
        axes.plot(*motions[kind].advance(), STYLES[kind], color=COLOURS[kind], label=LABELS[kind])
    axes.axhline(0, color="#999999", lw=0.6)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_cycles(image: Image, plane: Plane, motions: dict[str, Motion], lag: int) -> Figure:
    """Mean cycles of every motion on the frame at the start of the first cycle, each around the point that
    puts the camera's phase zero, a ring, onto the mass; the learned cycle is shifted by its lag."""
    folded = {kind: motions[kind].by_phase() for kind in MOTION_KINDS}
    places = folded["tracked"][0, 0] - mean_cycle(folded["tracked"])[0]
    figure, axes = new_axes(7.0, 7.0 / _CYCLES_ASPECT + 0.35)  # with the names above
    axes.imshow(image[..., ::-1], interpolation="lanczos")
    seen = []
    for kind in MOTION_KINDS:
        cycle = np.roll(mean_cycle(folded[kind]), lag if kind == "simulated" else 0, axis=0)
        for k in range(cycle.shape[1]):
            pixels = plane.to_pixels(places[k] + cycle[:, k])
            closed = np.concatenate([pixels, pixels[:1]])
            label = LABELS[kind] if k == 0 else None
            axes.plot(*closed.T, color="white", lw=2.4, alpha=0.8)
            axes.plot(*closed.T, STYLES[kind], color=COLOURS[kind], lw=1.2, label=label)
            axes.plot(*pixels[0], "o", ms=5, mfc="none", mec=COLOURS[kind])
            seen.append(pixels[np.isfinite(pixels).all(axis=1)])
    around = np.concatenate(seen)
    if len(around):
        low, high = around.min(axis=0), around.max(axis=0)
        margin = 0.35 * (high - low).max() + 10
        left, right = low[0] - margin, high[0] + 2.5 * margin
        # As wide as the figure, so that no white is beside the picture.
        spare = max(0.0, _CYCLES_ASPECT * (high[1] - low[1] + 2 * margin) - (right - left)) / 2
        axes.set_xlim(max(left - spare, min(left, 0.0)), min(right + spare, max(right, image.shape[1] - 1.0)))
        axes.set_ylim(high[1] + margin, low[1] - margin)
    axes.set_axis_off()
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_runs(runs: Sequence[FilmedRun]) -> Figure:
    """Displacement of each robot with its interval, beside its prediction and the paper's robots."""
    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    hide_frame(left, right)
    kinds, comparable = pool_displacements(runs), comparable_runs(runs)
    for i, (kind, walked) in enumerate(kinds.items()):
        half = 0.0 if np.isnan(walked.high) else walked.high - walked.mean
        left.bar(i - 0.2, walked.mean, 0.36, yerr=half, capsize=3, color=COLOURS["tracked"], ecolor="#777777",
                 label=LABELS["tracked"] if i == 0 else None)  # fmt: skip
        expected = float(np.mean([run.predicted_displacement for run in comparable[kind]]))
        left.bar(i + 0.2, expected, 0.36, color=COLOURS["predicted"], hatch="..", edgecolor="white",
                 label=LABELS["predicted"] if i == 0 else None)  # fmt: skip
        if kind in PAPER_DISPLACEMENTS:
            left.plot([i - 0.42, i + 0.42], [PAPER_DISPLACEMENTS[kind]] * 2, color="#D55E00", lw=1.5,
                      label="the paper's robot" if i == 0 else None)  # fmt: skip
    left.axhline(0, color="#999999", lw=0.6)
    left.set_xticks(
        range(len(kinds)), [k.replace(" a ", "\na ").replace(", ", ",\n") for k in kinds], fontsize=7
    )
    left.set_ylabel("body lengths per five cycles")
    left.legend(frameon=False, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
    for i, run in enumerate(runs):
        name = run.detail or run.robot
        alone = sum((other.detail or other.robot) == name for other in runs) == 1
        right.plot(*run.tracked.advance(), ("-", "--", ":", "-.")[i % 4], color=_CHANNELS[i % 8],
                   label=name if alone else f"{name}: {run.log}")  # fmt: skip
    right.axhline(0, color="#999999", lw=0.6)
    right.set_xlabel("actuation cycles")
    right.set_ylabel("forward, camera (body lengths)")
    right.legend(frameon=False, fontsize=7, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_profiles(own: dict[str, float], others: Sequence[float]) -> Figure:
    """Correlation of the profile of vertical ranges with the camera's: own motions and other bodies."""
    label = "correlation of the markers' vertical ranges with the camera's"
    figure, axes = new_axes(7.0, 1.6, xlabel=label)
    axes.plot(others, np.zeros(len(others)), "o", ms=7, mfc="none", mec="#777777", label="other bodies")
    for kind, value in own.items():
        axes.plot([value, value], [-0.4, 0.4], STYLES[kind], color=COLOURS[kind], lw=2, label=LABELS[kind])
    axes.set_xlim(-1.05, 1.05)
    axes.set_ylim(-0.6, 0.6)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure


def draw_heating(
    motion: Motion,
    relay_times: FloatArray,
    relays: BoolArray,
    channels: tuple[str, ...],
    temperature_times: FloatArray,
    temperatures: FloatArray,
    springs: tuple[str, ...],
    max_temperature_c: float,
) -> Figure:
    """The filmed motion, and under it the contacts as read back and the modelled temperatures with their
    maximum."""
    figure = Figure(figsize=(7.0, 5.2), layout="constrained")
    walk, top, bottom = figure.subplots(3, 1, sharex=True, height_ratios=[1.5, 1, 2])
    cycles, forward = motion.advance()
    walk.plot(motion.start + cycles * motion.period, forward, color=COLOURS["tracked"])
    walk.set_ylabel("forward\n(body lengths)")
    used = np.flatnonzero(relays.any(axis=0)) if len(relays) else np.zeros(0, int)
    for row, c in enumerate(used):
        top.fill_between(
            relay_times, row, row + 0.8 * relays[:, c], step="post", color=_CHANNELS[c % 8], lw=0
        )
    top.set_yticks(np.arange(len(used)) + 0.4, [channels[c] for c in used], fontsize=7)
    top.set_ylabel("closed")
    for s, spring in enumerate(springs):
        bottom.plot(
            temperature_times, temperatures[:, s], ("-", "--", "-.", ":")[s % 4], color=_CHANNELS[s % 8],
            label=spring,
        )  # fmt: skip
    bottom.axhline(max_temperature_c, color="#D55E00", lw=0.8)
    bottom.annotate(
        "maximum", (0.01, max_temperature_c), (0, 2), bottom.get_yaxis_transform(), "offset points",
        color="#D55E00", fontsize=7,
    )  # fmt: skip
    bottom.set_ylabel("spring (°C), modelled")
    bottom.set_xlabel("time (s)")
    if springs:
        bottom.legend(
            frameon=False,
            fontsize=7,
            ncols=4,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            borderaxespad=0.2,
        )
    hide_frame(walk, top, bottom)
    return figure
