"""Gaits: on-phases, what a rollout becomes, and what the springs make of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eldir.built.gait import CONDITIONING, DUTY, PERIOD, SETTLE, Gait, free_lengths, free_lengths_batch
from eldir.engine.validity import OK
from eldir.errors import InputError
from eldir.parameters.springs import SpringParameters
from eldir.rollout import Rollout
from eldir.scene import Scene

SCENE = Scene.preset("paper")


def rollout(*activations: np.ndarray) -> Rollout:
    """One that only has activations, each of shape (999,)."""
    still = np.zeros((1000, 3, 2))
    return Rollout(still, still, np.stack(activations, axis=1), 0.0, OK)


def square(phase: float, duty: float, level: float = 1.0) -> np.ndarray:
    """On from `phase` for `duty` of the CPG's period, at +-level."""
    cycle = SCENE.omega * np.arange(999) * SCENE.dt / (2 * np.pi)
    return level * np.where((cycle - phase) % 1.0 < duty, 1.0, -1.0)


def apart(a: float, b: float) -> float:
    """Distance of two phases on the circle."""
    return abs((a - b + 0.5) % 1.0 - 0.5)


@settings(max_examples=30, deadline=None)
@given(phase=st.floats(0, 0.99), duty=st.floats(0.05, 0.95), level=st.floats(1e-3, 1))
def test_phase_and_duty_of_a_square_wave_are_found(phase: float, duty: float, level: float) -> None:
    gait = Gait.from_rollout(rollout(square(phase, duty, level)), SCENE)
    assert gait.period == PERIOD and gait.method == "imitate"
    assert apart(gait.phase[0], phase) < 0.025
    assert gait.duty[0] == pytest.approx(min(duty, DUTY), abs=0.03)


def test_phases_keep_their_order_between_motors() -> None:
    t = SCENE.omega * np.arange(999) * SCENE.dt
    gait = Gait.from_rollout(rollout(np.sin(t), np.sin(t - np.pi / 2), np.zeros(999)), SCENE, 30.0)
    assert gait.period == 30.0
    assert apart(gait.phase[1] - gait.phase[0], 0.25) < 0.02
    assert gait.duty == pytest.approx([DUTY, DUTY, 0.0])


def test_the_first_cycle_does_not_count_and_short_bumps_lose() -> None:
    wave = square(0.6, 0.2)
    cycle = SCENE.omega * np.arange(999) * SCENE.dt / (2 * np.pi)
    wave[cycle < 1] = 1.0
    wave[(cycle % 1.0 > 0.1) & (cycle % 1.0 < 0.15) & (cycle >= 1)] = 1.0
    gait = Gait.from_rollout(rollout(wave), SCENE)
    assert apart(gait.phase[0], 0.6) < 0.025 and gait.duty[0] == pytest.approx(0.2, abs=0.03)


def test_a_violent_first_cycle_does_not_hide_the_gait() -> None:
    """A robot that starts from rest uses ten times the range, at another time, before it finds its gait."""
    cycle = SCENE.omega * np.arange(999) * SCENE.dt / (2 * np.pi)
    wave = np.where(cycle < 1, square(0.1, 0.2), square(0.6, 0.2, 0.1))
    gait = Gait.from_rollout(rollout(wave), SCENE)
    assert apart(gait.phase[0], 0.6) < 0.025


@given(st.lists(st.tuples(st.floats(0, 0.999), st.floats(0, 0.99)), min_size=1, max_size=4))
@settings(max_examples=30, deadline=None)
def test_on_lasts_the_duty_of_each_period(motors: list[tuple[float, float]]) -> None:
    phase, duty = np.array(motors).T
    gait = Gait(20.0, phase, duty)
    times = (np.arange(4000) + 0.5) * 20.0 / 4000
    assert np.abs(gait.is_heating(times).mean(axis=0) - duty).max() <= 1 / 4000 + 1e-9
    later = gait.is_heating(times + 60.0)
    assert (later != gait.is_heating(times)).mean() < 2e-3  # but for rounding at the edges
    assert not gait.is_heating(-times).any()


def test_wrong_gaits_are_named() -> None:
    for period, phase, duty in ((0.0, [0], [0.3]), (20.0, [0], [1.0]), (20.0, [0], [-0.1])):
        with pytest.raises(InputError, match=r"^(invalid Gait\.period|Gait: invalid duty)"):
            Gait(period, np.array(phase, float), np.array(duty))
    with pytest.raises(InputError, match=r"^Gait: invalid duty"):
        Gait(20.0, np.zeros(2), np.zeros(1))


def test_springs_follow_the_gait() -> None:
    p = SpringParameters()
    gait = Gait(PERIOD, np.array([0.0, 0.5]), np.full(2, DUTY))
    table = free_lengths(gait, p, cycles=2)
    rows = round((SETTLE + PERIOD * (2 + CONDITIONING)) / table.interval)
    assert table.lengths.shape == (rows + 1, 2) and table.temperatures.shape == (rows, 2)
    assert table.first_cycle * table.interval == pytest.approx(SETTLE + PERIOD * CONDITIONING)
    settled = round(SETTLE / table.interval)
    assert table.lengths[: settled + 1] == pytest.approx(p.cold_length)
    assert p.cold_length - 1e-12 <= table.lengths.min() and table.lengths.max() <= p.hot_length + 1e-12
    # Past Af while heating, below Mf at the end of a period: the whole stroke, every cycle.
    cycle = round(PERIOD / table.interval)
    for first in (table.first_cycle, table.first_cycle + cycle):
        lengths = table.lengths[first : first + cycle + 1]
        assert lengths.max(axis=0) == pytest.approx(p.hot_length, abs=1e-4)
        assert np.ptp(lengths, axis=0).min() > 0.9 * (p.hot_length - p.cold_length)
        hottest = lengths.argmax(axis=0) / cycle
        assert apart(hottest[1] - hottest[0], 0.5) < 0.02
    assert table.temperatures.max() < 90.0


def test_what_never_heats_never_lengthens() -> None:
    table = free_lengths(Gait(PERIOD, np.zeros(1), np.zeros(1)), cycles=1)
    assert np.ptp(table.lengths) == 0


def test_springs_of_many_gaits_are_heated_side_by_side_as_if_alone() -> None:
    rng = np.random.default_rng(0)
    robots = [
        (
            Gait(period, np.array([0.0, rng.random()]), np.full(2, 6 / period)),
            [SpringParameters(current_limit=rng.uniform(3, 4))] * 2,
        )
        for period in (20.0, 18.6, 23.0, 20.0)
    ]
    together = free_lengths_batch(robots, cycles=1)
    for robot, found in zip(robots, together, strict=True):
        assert found == free_lengths_batch([robot], cycles=1)[0]
        assert len(found.lengths) == round((3.0 + 2 * robot[0].period) / 0.05) + 1
    assert free_lengths_batch([], cycles=1) == []
