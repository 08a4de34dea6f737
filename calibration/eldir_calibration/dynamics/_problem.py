"""An identification as a least-squares problem: residuals, their scales and their derivatives.

A problem is fixed and has no state: the same question gives the same answer. Its residuals are camera minus
prediction, in the frames that can be predicted.

A robot slips a little differently in every step, and the difference stays from then on. So the common motion
of the markers counts from second to second, and the motion of each marker relative to the others from frame
to frame. Where exactly a marker was glued on, and where the plane lies, only changes the mean, which is
removed.

A landing goes one way or the other by the last micrometre. Mostly that does not matter: slightly perturbed
simulations agree again within a second. Where one of them tumbles and another does not, they diverge by
millimetres, and such frames say nothing about the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.core.records import BoolArray, FloatArray
from eldir.parameters.robot import RobotParameters, perturb_robot
from eldir.parameters.uncertain import is_unobservable
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG, IdentificationConfig
from eldir_calibration.dynamics.recording import (
    NOT_MEASURED,
    FilmedBody,
    Measurements,
    Recording,
    predict_markers,
)

_SECOND = 1.0


@dataclass(frozen=True)
class Residual:
    """Residual of one recording: linear in the difference of positions; leading axes are kept."""

    shape: FloatArray
    """Heights, and forward places relative to the markers' mean, less their means over time [m],
    shape (..., frames, 2 markers); 0 where a marker was not seen."""
    walk: FloatArray
    """How far the markers' mean went forward in each second [m], shape (..., seconds)."""

    def scale(self, shape: float, walk: float) -> FloatArray:
        """One vector, in standard deviations, shape (..., values)."""
        flat = self.shape.reshape(*self.shape.shape[:-2], -1)
        return np.concatenate([flat / shape, self.walk / walk], axis=-1)


def compute_residual(recording: Recording, differences: FloatArray) -> Residual:
    """The residual of the differences (..., frames, markers, 2) [m] between tracked and predicted
    markers."""
    seen: BoolArray = np.isfinite(recording.tracked.positions[..., 0])  # (frames, markers)
    differences = np.where(seen[..., None], differences, 0.0)
    counts = np.maximum(seen.sum(axis=1), 1)
    forward = differences[..., 0].sum(axis=-1) / counts  # of the markers' mean, (..., frames)
    parts = np.concatenate([differences[..., 0] - forward[..., None], differences[..., 1]], axis=-1)
    visible = np.concatenate([seen, seen], axis=1)
    parts = np.where(visible, parts, 0.0)
    mean = parts.sum(axis=-2, keepdims=True) / np.maximum(visible.sum(axis=0), 1)
    walk = _walk_per_second(recording, forward, seen.sum(axis=1) > 0)
    return Residual(np.where(visible, parts - mean, 0.0), walk)


def _walk_per_second(recording: Recording, forward: FloatArray, seen: BoolArray) -> FloatArray:
    """Differences between the means over neighbouring seconds; 0 beside a second without a frame."""
    second = (recording.tracked.times / _SECOND).astype(int)
    second -= second.min(initial=0)
    count = int(second.max(initial=0)) + 1
    counts = np.bincount(second[seen], minlength=count)
    averaging = np.zeros((len(second), count))
    averaging[seen, second[seen]] = 1.0 / counts[second[seen]]
    means = forward @ averaging
    valid = (counts[1:] > 0) & (counts[:-1] > 0)
    return np.where(valid, np.diff(means, axis=-1), 0.0)


def find_reproducible_frames(
    recordings: Sequence[Recording],
    perturbed: Sequence[FloatArray],
    config: IdentificationConfig = DEFAULT_CONFIG,
) -> tuple[list[BoolArray], float]:
    """The largest set of frames in which perturbed robots agree within `divergence_limit`.

    Returns whether each frame of each recording is kept, shapes (frames,), and the root mean square of the
    differences in the kept frames [m]. `perturbed` (n, frames, 2 markers): differences between the perturbed
    robots, as `Residual.shape` [m].
    """
    window = config.divergence_window
    squares = [
        _mean_square(r, x, r.tracked.times < r.start, window)
        for r, x in zip(recordings, perturbed, strict=True)
    ]
    every = np.sort(np.concatenate(squares))
    alike = np.cumsum(every) <= config.divergence_limit**2 * np.arange(1, len(every) + 1)
    most = every[alike].max(initial=0.0)
    kept = [s <= most for s in squares]
    again = [_mean_square(r, x, k, window)[k] for r, x, k in zip(recordings, perturbed, kept, strict=True)]
    return kept, root_mean(np.concatenate(again))


def mask_frames(recordings: Sequence[Recording], kept: Sequence[BoolArray]) -> list[Recording]:
    """The recordings as if no marker had been seen in frames that are not kept."""
    blind = [
        np.where(k[:, None, None], r.tracked.positions, np.nan) for r, k in zip(recordings, kept, strict=True)
    ]
    return [
        replace(r, tracked=replace(r.tracked, positions=x)) for r, x in zip(recordings, blind, strict=True)
    ]


def total_duration(recording: Recording, frames: BoolArray) -> float:
    """How long some of its frames last together [s]."""
    times = recording.tracked.times
    return float(frames.sum() * (times[-1] - times[0]) / (len(times) - 1))


def root_mean(squares: FloatArray) -> float:
    """Root of the mean of squares; 0 where there are none."""
    return float(np.sqrt(squares.sum() / max(squares.size, 1)))


def _mean_square(
    recording: Recording, perturbed: FloatArray, reference: BoolArray, window: float
) -> FloatArray:
    """Mean square by which perturbed robots differ within `window` [s] of each frame, from their means in the
    reference frames [m2], shape (frames,)."""
    seen = perturbed != 0
    counts = np.maximum(seen[:, reference].sum(axis=1, keepdims=True), 1)
    mean = perturbed[:, reference].sum(axis=1, keepdims=True) / counts
    squares = (np.where(seen, perturbed - mean, 0.0) ** 2).mean(axis=(0, 2))
    rate = 1 / total_duration(recording, np.arange(len(squares)) == 1)
    beside = np.ones(1 + 2 * round(window * rate))
    return np.convolve(squares, beside, "same") / np.convolve(np.ones(len(squares)), beside, "same")


@dataclass(frozen=True)
class Linearisation:
    """A predicted motion and its tangents at one point.

    Tangents are central differences over a finite step of each parameter. The engine's own derivatives
    (`eldir.built.sensitivities`) are exact, but grow without bound where feet strike the ground: a landing's
    outcome depends on the last micrometre, while the motion as a whole hardly changes. A fit needs the
    tangent of the whole motion, over a step that is wide against that
    (docs/decisions/0021-identification.md).
    """

    positions: list[FloatArray]
    """Markers in each recording [m], shape (frames, markers, 2)."""
    tangents: list[FloatArray]
    """Tangents of each recording [m per standard deviation of the prior],
    shape (parameters, frames, markers, 2)."""
    divergence: list[FloatArray]
    """Deviation of slightly perturbed robots from the linear prediction in each recording, by diverging
    landings [m], shape (n, frames, markers, 2)."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Recordings of one robot, the parameters that may change, and the scale of every residual."""

    body: FilmedBody
    recordings: Sequence[Recording]
    nominal: RobotParameters
    names: Sequence[str]
    """Names of the P parameters."""
    noise: tuple[float, float]
    """Standard deviations of the residuals of shape, and of walk per second [m]."""
    step_widths: FloatArray
    """Steps of z for the tangents, to both sides, shape (P,)."""
    measurements: Measurements = NOT_MEASURED
    config: IdentificationConfig = DEFAULT_CONFIG

    def around(self, z: FloatArray) -> list[FloatArray]:
        """Predicted markers at parameter values `z`, and of slightly perturbed robots, which measure
        divergence [m], of each recording, shape (1 + `jitter_robots`, frames, markers, 2). They share the
        engine's lanes, so that the perturbed ones cost nothing."""
        return self._predict([z, *(z + self._jitter)])

    def linearise(
        self, z: FloatArray, around: Sequence[FloatArray] | None = None, *, coarse: bool = False
    ) -> Linearisation:
        """The predicted motion at `z`, and its tangents over `step_widths` to both sides.

        `around`: what `around` returned for `z`. `coarse`: tangents are differences of coarse robots
        (`PrintedRobot.coarse`), with hubs in a seventh of the time; positions are exact in any case.
        """
        observable = [j for j, name in enumerate(self.names) if not is_unobservable(name)]
        units = np.eye(len(z))[observable]
        sides = [
            z + sign * width * unit
            for width, unit in zip(self.step_widths[observable], units, strict=True)
            for sign in (1, -1)
        ]
        near = self.around(z) if around is None else around
        width = self.step_widths[observable, None, None, None]
        tangents = []
        stepped = self._predict([z, *sides], coarse=True) if coarse else self._predict(sides)
        for x, exact in zip(stepped, near, strict=True):
            here = x[:1] if coarse else exact[:1]
            above, below = x[coarse::2], x[coarse + 1 :: 2]
            tangent = (above - below) / (2 * width)
            # Where one side fell over, the other side still has a tangent.
            tangent = np.where(np.isfinite(tangent), tangent, (above - here) / width)
            tangent = np.where(np.isfinite(tangent), tangent, (here - below) / width)
            whole = np.zeros((len(z), *tangent.shape[1:]))
            whole[observable] = np.nan_to_num(tangent)
            tangents.append(whole)
        divergence = [
            np.nan_to_num(x[1:] - x[0] - np.tensordot(self._jitter, whole, 1))
            for x, whole in zip(near, tangents, strict=True)
        ]
        return Linearisation([x[0] for x in near], tangents, divergence)

    @property
    def _jitter(self) -> FloatArray:
        """Perturbations of z by which robots differ slightly, shape (`jitter_robots`, P)."""
        observable = [not is_unobservable(name) for name in self.names]
        signs = np.random.default_rng(len(self.names)).choice(
            [-1.0, 1.0], (self.config.jitter_robots, len(self.names))
        )
        return np.asarray(self.config.jitter * signs * self.step_widths * observable)

    def residuals(self, z: FloatArray, positions: Sequence[FloatArray]) -> FloatArray:
        """Residuals of tracks, priors and readings in standard deviations, shape (values,); `positions` are
        those predicted at `z`."""
        return np.concatenate([self._scaled(self.track_residuals(positions)), self._prior_residuals(z)])

    def jacobian(self, z: FloatArray, linear: Linearisation) -> FloatArray:
        """Derivatives of `residuals` by z, shape (values, P); `linear` is the linearisation at `z`."""
        changes = [compute_residual(r, -s) for r, s in zip(self.recordings, linear.tangents, strict=True)]
        return np.concatenate([self._scaled(changes).T, self.prior_jacobian(z)])

    def track_residuals(self, positions: Sequence[FloatArray]) -> list[Residual]:
        """Residual of a prediction of each recording; huge where a robot blew up."""
        huge = self.config.diverged_residual * self.noise[0]
        return [
            compute_residual(
                r, np.nan_to_num(r.tracked.positions - x, nan=0.0) + huge * _diverged_frames(r, x)
            )
            for r, x in zip(self.recordings, positions, strict=True)
        ]

    def divergence(self, z: FloatArray, linear: Linearisation) -> list[Residual]:
        """Deviation of slightly perturbed robots from the linearisation at `z`, shapes (n, ...).

        It has two causes: feet land differently, and the motion is not linear.
        """
        signs = np.random.default_rng(len(z)).choice([-1.0, 1.0], (self.config.perturbed_robots, len(z)))
        observable = [not is_unobservable(n) for n in self.names]
        perturbations = self.config.perturbation * signs * self.step_widths * observable
        motions = self._predict([z, *(z + perturbations)])
        return [
            compute_residual(r, np.nan_to_num(x[1:] - x[0] - np.tensordot(perturbations, tangents, 1)))
            for r, x, tangents in zip(self.recordings, motions, linear.tangents, strict=True)
        ]

    def prior_jacobian(self, z: FloatArray) -> FloatArray:
        """Derivatives by z of the residuals of priors and readings, shape (priors and readings, P)."""
        h = self.config.prior_step
        steps = h * np.eye(len(z))
        return np.stack(
            [(self._prior_residuals(z + s) - self._prior_residuals(z - s)) / (2 * h) for s in steps], axis=1
        )

    def _predict(self, points: Sequence[FloatArray], *, coarse: bool = False) -> list[FloatArray]:
        """Predicted markers of each recording [m], shape (points, frames, markers, 2)."""
        robots = [perturb_robot(self.body.morphology, self.nominal, self.names, z) for z in points]
        return predict_markers(self.body, self.recordings, robots, coarse=coarse)

    def _prior_residuals(self, z: FloatArray) -> FloatArray:
        """Residuals of priors and readings at `z`, in standard deviations, shape (priors and readings,)."""
        if self.measurements == NOT_MEASURED:
            return z
        robot = perturb_robot(self.body.morphology, self.nominal, self.names, z)
        return np.append(z, self.measurements.residuals(self.body, robot, self.config))

    def _scaled(self, residuals: Sequence[Residual]) -> FloatArray:
        return np.concatenate([r.scale(*self.noise) for r in residuals], axis=-1)


def _diverged_frames(recording: Recording, positions: FloatArray) -> FloatArray:
    """1 where a marker was visible and the prediction diverged, alternating in sign so that no mean removes
    it."""
    lost = np.isfinite(recording.tracked.positions) & ~np.isfinite(positions)
    return 1.0 * lost * np.where(np.arange(len(positions)) % 2, 1.0, -1.0)[:, None, None]
