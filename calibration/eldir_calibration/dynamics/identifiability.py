"""Identifiability: which parameter explains which motion, and which gait to film next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.gait import SETTLE, Gait
from eldir.built.scene import ExplainedRanges, NextFilm, PrintedScene
from eldir.core.records import FloatArray, Record
from eldir.parameters.robot import RobotParameters
from eldir.parameters.uncertain import is_unobservable
from eldir.trajectory import Trajectory
from eldir_calibration.dynamics._problem import Problem, compute_residual
from eldir_calibration.dynamics.configuration import DEFAULT_CONFIG
from eldir_calibration.dynamics.recording import INTERVAL, FilmedBody, Recording, predict_markers

_BATCH_SIZE = 16  # robots that are simulated side by side between two reports of progress


@dataclass(frozen=True, eq=False)
class RangeAttribution(Record):
    """Vertical ranges of motion in a recording's last cycle, and the effect of P parameters on them."""

    parameters: tuple[str, ...]
    markers: tuple[str, ...]
    sensitivities: FloatArray
    """Change of a marker's range per standard deviation of the parameter's prior [m], shape (P, markers)."""
    shares: FloatArray
    """Part of the change from the nominal to the identified robot that each parameter explains [m], shape
    (P, markers)."""
    change: FloatArray
    """The whole change, which is not quite the sum of the shares [m], shape (markers,)."""

    @property
    def numbers(self) -> ExplainedRanges:
        """The sensitivities and shares, rounded [m]."""

        def named(values: FloatArray) -> dict[str, float]:
            return {m: round(float(v), 7) for m, v in zip(self.markers, values, strict=True)}

        return ExplainedRanges(
            {n: named(v) for n, v in zip(self.parameters, self.sensitivities, strict=True)},
            {n: named(v) for n, v in zip(self.parameters, self.shares, strict=True)}
            | {"all": named(self.change)},
        )


def attribute_ranges(
    body: FilmedBody,
    recording: Recording,
    nominal: RobotParameters,
    scene: PrintedScene,
    progress: Callable[[float], None] = lambda part: None,
) -> RangeAttribution:
    """Vertical ranges of the nominal and the identified robot: gradients at both, and each parameter's share
    of the change by the mean of both gradients. What the shares leave is not linear. Parameters on which no
    motion depends are not simulated. `progress` is called with the part that is done."""
    names = scene.parameters
    z = scene.z
    places = [np.zeros(len(z)), z]
    step = DEFAULT_CONFIG.attribution_step
    moving = [i for i, name in enumerate(names) if not is_unobservable(name)]
    steps = [s * step * unit for unit in np.eye(len(z))[moving] for s in (1, -1)]
    tried = [nominal.at(names, p) for place in places for p in [place, *(place + s for s in steps)]]
    parts = []
    for first in range(0, len(tried), _BATCH_SIZE):
        progress(first / len(tried))
        parts += predict_markers(body, [recording], tried[first : first + _BATCH_SIZE])
    motions = np.concatenate(parts)
    t = recording.tracked.times
    last = (t >= recording.end - recording.period) & (t <= recording.end)
    ranges = np.ptp(motions[..., 1][:, last], axis=1).reshape(2, -1, len(body.marker_masses))
    sensitivities = np.zeros((2, len(names), len(body.marker_masses)))
    sensitivities[:, moving] = np.nan_to_num((ranges[:, 1::2] - ranges[:, 2::2]) / (2 * step))
    return RangeAttribution(
        names,
        recording.tracked.names,
        sensitivities[1],
        sensitivities.mean(axis=0) * z[:, None],
        ranges[1, 0] - ranges[0, 0],
    )


@dataclass(frozen=True)
class Experiment:
    """A film of one gait that was not made yet."""

    gait: Gait
    information: float
    """Expected information [bit]: half the binary logarithm of the factor by which the film would shrink the
    determinant of the covariance."""
    remaining_spread: dict[str, float]
    """Standard deviation of each parameter after that film, as a part of its prior's."""

    @property
    def numbers(self) -> NextFilm:
        """The expected information, rounded."""
        return NextFilm(
            tuple(round(float(p), 6) for p in self.gait.phase),
            round(self.information, 3),
            {n: round(d, 4) for n, d in self.remaining_spread.items()},
        )


def rank_experiments(
    body: FilmedBody,
    scene: PrintedScene,
    gaits: Sequence[Gait],
    progress: Callable[[float], None] = lambda part: None,
) -> list[Experiment]:
    """The expected information of a film of one cycle of each gait, the most informative first.

    It is computed to first order about the identified robot: the covariance becomes (C^-1 + J'J)^-1, with J
    in standard deviations of the noise that the fit assumed. Hubs are simulated as pins, which takes a
    seventh of the time; what a film tells of the friction in sockets and of bending is left out.
    """
    found, measured = [], scene.identification.noise_m
    noise = measured.shape, measured.walk_per_second
    zero = np.zeros(len(scene.parameters))
    prior = np.linalg.pinv(scene.covariance, hermitian=True)
    robot = scene.robot.uniform
    robot = replace(robot, printed=robot.printed.with_pins())
    config = replace(DEFAULT_CONFIG, jitter_robots=0)  # divergence does not enter
    for i, gait in enumerate(gaits):
        progress(i / len(gaits))
        film = _blank_recording(body, gait, config.film_rate)
        widths = np.full(len(zero), config.attribution_step)
        linear = Problem(
            body, [film], robot, scene.parameters, config.rough_noise, widths, config=config
        ).linearise(zero)
        rows = compute_residual(film, linear.tangents[0]).scale(*noise)
        after = np.linalg.inv(prior + rows @ rows.T)
        gain = 0.5 * (np.linalg.slogdet(prior + rows @ rows.T)[1] - np.linalg.slogdet(prior)[1]) / np.log(2)
        left = dict(zip(scene.parameters, np.sqrt(np.diag(after)).tolist(), strict=True))
        found.append(Experiment(gait, float(gain), left))
    return sorted(found, key=lambda e: -e.information)


def _blank_recording(body: FilmedBody, gait: Gait, rate: float) -> Recording:
    """A recording of one cycle without motion, in which every marker is seen in all frames."""
    starts = np.arange(round((SETTLE + gait.period * 2) / INTERVAL)) * INTERVAL
    times = np.arange(0, len(starts) * INTERVAL, 1 / rate)
    names = tuple(f"m{i + 1}" for i in range(len(body.marker_masses)))
    nothing = Trajectory(names, times, np.zeros((len(times), len(names), 2)))
    on = gait.is_heating(starts - SETTLE + 1e-9).astype(float)
    return Recording(nothing, on, SETTLE + gait.period, gait.period, 1)
