"""A walker's motion in closed form: speed, swing and lift of m1 to m5."""

import numpy as np

from eldir.trajectory import Trajectory
from eldir_calibration.report.comparison import Motion

PERIOD = 20.0
CYCLES = 5
LENGTH = 0.2


def walker(
    *,
    speed: float = 0.01,
    swing: float = 0.004,
    lift: float = 0.003,
    phase: float = 0.0,
    rate: float = 10.0,
    start: float = PERIOD,
    period: float = PERIOD,
    scale: float = 1.0,
    noise: float = 0.0,
) -> Motion:
    """Two masses that walk at `speed` [m a cycle] while they swing by `swing` and `lift` [m]."""
    t = np.arange(0, start + CYCLES * period + 1 / rate, 1 / rate)
    turn = 2 * np.pi * ((t - start) / period - phase)
    forward = speed * (t - start) / period
    one = np.stack([forward + swing * np.sin(turn), 0.03 + lift * np.cos(turn)], axis=1)
    two = np.stack([forward + 0.05 + swing * np.cos(turn), 0.06 + 2 * lift * np.sin(turn)], axis=1)
    positions = np.stack([one, two], axis=1)
    if noise:
        positions = positions + np.random.default_rng(0).normal(0, noise, positions.shape)
    track = Trajectory(("m1", "m2"), t, positions / scale)
    return Motion(track, start, period, CYCLES, LENGTH / scale, scale)
