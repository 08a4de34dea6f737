"""Derivatives of the built robot's motion against central differences of the motion, and closed forms."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from eldir.built.motion import drive
from eldir.built.robot import build, rest_state
from eldir.built.sensitivities import MOTION_PARAMETERS, DriveInputs, Parameter, sensitivities
from eldir.built.stability import stable_step
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from tests.eldir.built.braced_robots import COLD, FREE_FALL, HOT, bodies, strip, swing, unheated
from tests.raised import raises

INTERVAL = 0.005
OF_BUILD = {field.name for field in fields(BuiltParameters)}
FREE = {"cold_length": 0, "hot_length": 1}
KINDS = {
    "pins": BuiltParameters(),
    "clamped": BuiltParameters.clamped(),
    "hubs": BuiltParameters().with_hubs(),
}
# The lag has a test of its own. Pinned strips buckle here and others bend; pinned masses do not turn.
HERE = {"pins": {"lag", "gyration"}, "clamped": {"lag", "buckling"}, "hubs": {"lag", "buckling"}}
NO_EFFECT = {
    joints: HERE[joints] | {name for name in OF_BUILD if not p.acts(name)} for joints, p in KINDS.items()
}


def drives(p: BuiltParameters, seed: int, instants: int = 11) -> DriveInputs:
    """A robot whose motors stretch and pull, with strips that buckle and feet that slip."""
    robot = build(bodies(1, seed)[0], p)
    warm = COLD + 0.002 + 0.9 * (swing(robot, instants, period=0.1, interval=INTERVAL) - COLD)
    return DriveInputs(robot, warm, INTERVAL)


def changed(base: DriveInputs, body_seed: int, name: str, h: float) -> DriveInputs:
    """The same drive with one parameter larger by h."""
    robot, p = base.robot, base.robot.parameters
    if name in OF_BUILD:
        robot = build(bodies(1, body_seed)[0], replace(p, **{name: getattr(p, name) + h}))
        return replace(base, robot=robot)
    if name == "ballast":
        return replace(base, robot=build(bodies(1, body_seed)[0], p, ballast=h))
    assert name in FREE
    free = tuple(f + h * (FREE[name] == i) for i, f in enumerate(base.free))
    return replace(base, lengths=free[0] + (free[1] - free[0]) * base.heated_fraction, free=free)


def moved(d: DriveInputs, step: float) -> np.ndarray:
    states = None if d.state is None else [d.state]
    return drive([d.robot], [d.lengths], d.interval, step=step, free=d.free, states=states)[0].positions


def differences(base: DriveInputs, seed: int, name: str, step: float) -> tuple[np.ndarray, float]:
    """The central difference that agrees best with that of half the step, extrapolated; and how far they
    differ, relative to the largest: by rounding where the steps are small, by kinks where they are large."""
    size = {"ballast": 1e-3, "cold_length": 0.03, "hot_length": 0.06, "tilt": 0.1}.get(name)
    size = abs(size or getattr(base.robot.parameters, name))
    steps = [size * part for whole in (3e-4, 3e-5, 3e-6, 3e-7) for part in (whole, whole / 2)]
    sides = [changed(base, seed, name, sign * h) for h in steps for sign in (1, -1)]
    if name in FREE:
        ends = np.array([moved(d, step) for d in sides])
    else:
        robots, tables = [d.robot for d in sides], [d.lengths for d in sides]
        ends = np.array([m.positions for m in drive(robots, tables, base.interval, step=step)])
    tangents = (ends[::2] - ends[1::2]) / (2 * np.array(steps)[:, None, None, None])
    best = (4 * tangents[1::2] - tangents[::2]) / 3
    errors_ = np.abs(best - tangents[1::2]).max(axis=(1, 2, 3)) / np.abs(best).max(axis=(1, 2, 3))
    return best[errors_.argmin()], float(errors_.min())


@pytest.mark.parametrize("joints", KINDS)
def test_what_does_not_act_with_these_joints_moves_nothing(joints: str) -> None:
    p = KINDS[joints]
    idle = {name for name in OF_BUILD if not p.acts(name)} - {"socket", "bending"}  # which make other joints
    assert {"corner", "socket_turn", "socket_friction"} <= idle or (joints == "hubs" and not idle)
    base = drives(p, 7)
    other = replace(p, **{name: getattr(p, name) + 0.3 for name in idle})
    changed_robot = replace(base, robot=build(bodies(1, 7)[0], other))
    step = 0.8 * stable_step(base.robot)
    assert other.joints == joints and np.array_equal(moved(base, step), moved(changed_robot, step))


@pytest.mark.parametrize("joints", KINDS)
def test_tangents_are_those_of_the_motion(joints: str) -> None:
    """With motors that stretch and pull, strips that buckle, bend or stick in sockets, and feet that slip."""
    seed = 7
    base = drives(replace(KINDS[joints], tilt=0.02, backward_friction=1.2), seed)
    step = 0.8 * stable_step(base.robot)
    names = [n for n in MOTION_PARAMETERS if n not in NO_EFFECT[joints]]
    (found,) = sensitivities([base], [names], step=step)
    assert np.abs(found.positions - moved(base, step)).max() < 1e-14
    if joints != "hubs":  # whose centres move as they roll on their corners
        feet = found.positions[1:, :, 1]
        assert np.isclose(feet, 0, atol=1e-9).any(axis=1).sum() > 3
    assert np.ptp(found.positions, axis=0).max() > 1e-3
    errors = {}
    for name, tangent in zip(names, found.tangents, strict=True):
        expected, error_ = differences(base, seed, name, step)
        errors[name] = (float(np.abs(tangent - expected).max() / np.abs(expected).max()), error_)
    assert all(error < max(1e-6, 10 * own) for error, own in errors.values()), errors
    assert max(own for _, own in errors.values()) < 5e-6, errors  # the differences are rounded
    assert np.median([error for error, _ in errors.values()]) < 2e-7


def test_what_the_motion_begins_with_and_single_springs() -> None:
    """Initial positions and velocities, one strip's rest length, one motor's course."""
    base = drives(BuiltParameters(), 2)
    robot, step = base.robot, 0.8 * stable_step(base.robot)
    rng, h = np.random.default_rng(0), 1e-7
    kicked = np.zeros((4, len(robot.masses)))
    kicked[1:4] = [0.01 * rng.random(len(robot.masses)), *rng.standard_normal((2, len(robot.masses)))]
    longer = np.zeros(len(robot.springs))
    longer[np.flatnonzero(~robot.active)[3]] = 1.0
    course = base.lengths - COLD  # of a motor that stretches further
    start = rest_state(robot)
    start[1] += 0.002
    start[2] += 0.05
    base = replace(base, state=start)

    def kick(inputs: DriveInputs, by: float) -> DriveInputs:
        return replace(inputs, state=start + by * kicked)

    def stretch(inputs: DriveInputs, by: float) -> DriveInputs:
        return replace(inputs, robot=replace(robot, rest_lengths=robot.rest_lengths + by * longer))

    def go_further(inputs: DriveInputs, by: float) -> DriveInputs:
        return replace(inputs, lengths=base.lengths + by * course)

    changes = kick, stretch, go_further
    (found,) = sensitivities([base], [[Parameter(c, scale=0.01) for c in changes]], step=step)
    for i, (tangent, change) in enumerate(zip(found.tangents, changes, strict=True)):
        up, down = (moved(change(base, sign * h), step) for sign in (1, -1))
        expected = (up - down) / (2 * h)
        assert np.abs(tangent - expected).max() < 1e-5 * np.abs(expected).max(), i


def test_feet_of_different_friction() -> None:
    """The tangents in the common friction and in that of one foot, which slips and bears a load."""
    base = drives(BuiltParameters(), 7)
    uneven = np.exp(0.3 * np.random.default_rng(1).standard_normal(len(base.robot.masses)))
    robot = replace(base.robot, feet=uneven)
    base, step = replace(base, robot=robot), 0.8 * stable_step(robot)
    foot, h = np.zeros(len(robot.masses)), 1e-5
    foot[int(np.argmin(robot.positions[:, 1]))] = 1.0
    friction = robot.parameters.friction

    def change(inputs: DriveInputs, common: float, single: float) -> DriveInputs:
        feet = robot.feet * (1 + common / friction) + foot * single / friction
        return replace(inputs, robot=replace(robot, feet=feet))

    own = Parameter(lambda inputs, by: change(inputs, 0.0, by))
    (found,) = sensitivities([base], [["friction", own]], step=step)
    assert np.abs(found.positions - moved(base, step)).max() < 1e-14
    for tangent, (common, single) in zip(found.tangents, ((h, 0.0), (0.0, h)), strict=True):
        up, down = (moved(change(base, sign * common, sign * single), step) for sign in (1, -1))
        expected = (up - down) / (2 * h)
        assert np.abs(expected).max() > 1e-6
        assert np.abs(tangent - expected).max() < 1e-5 * np.abs(expected).max()


def test_a_lag_shifts_the_course_of_all_motors() -> None:
    robot = build(bodies(1)[0])
    step = 0.8 * stable_step(robot)

    def late(by: float) -> DriveInputs:
        t = np.arange(41)[:, None] * INTERVAL - by - 0.1 * np.arange(int(robot.active.sum()))
        return DriveInputs(robot, COLD + (HOT - COLD) * 0.5 * (1 - np.cos(2 * np.pi * t / 0.4)), INTERVAL)

    (found,) = sensitivities([late(0.0)], [["lag"]], step=step)
    expected = (moved(late(1e-6), step) - moved(late(-1e-6), step)) / 2e-6
    # The table has 80 instants a period, the engine goes straight between them.
    assert np.abs(found.tangents[0] - expected).max() < 0.05 * np.abs(expected).max()


def test_two_masses_on_a_strip_follow_the_closed_form() -> None:
    """x(t) = d cos(w t) / 2 about the middle: its derivative in the stiffness is -d t sin(w t) w / 4 k."""
    robot = strip((0, 1), (0.05, 1), (2e-3, 3e-3), FREE_FALL)
    state, stretch, interval = rest_state(robot), 1e-4, 1e-3
    state[0] += [-stretch * 0.6, stretch * 0.4]
    base = DriveInputs(robot, unheated(robot, 21), interval, state=state)
    (found,) = sensitivities([base], [["tension"]], step=2e-7)
    k, reduced, t = FREE_FALL.tension, 1.2e-3, found.times
    omega = np.sqrt(k / reduced)
    expected = -stretch * t * np.sin(omega * t) * omega / (2 * k)
    apart = np.diff(found.tangents[0, :, :, 0], axis=1)[:, 0]
    assert np.abs(apart - expected).max() < 3e-3 * np.abs(expected).max()


def test_going_on_equals_one_long_run_whatever_the_company(monkeypatch: pytest.MonkeyPatch) -> None:
    base = [drives(BuiltParameters.clamped(), seed) for seed in (2, 3)]
    names = [[n for n in MOTION_PARAMETERS if n not in NO_EFFECT["clamped"]][:10], ["friction"]]
    monkeypatch.setenv("ELDIR_THREADS", "2")
    whole = sensitivities(base, names)
    monkeypatch.setenv("ELDIR_THREADS", "1")
    (alone,) = sensitivities(base[1:], names[1:])
    assert alone == whole[1]
    halves = [replace(base[0], lengths=base[0].lengths[part]) for part in (slice(0, 6), slice(5, 11))]
    (first,) = sensitivities(halves[:1], names[:1])
    going_on = replace(halves[1], state=first.state)
    (second,) = sensitivities([going_on], names[:1], state_tangents=[first.state_tangents])
    assert whole[0].tangents[:, 5:].tobytes() == second.tangents.tobytes()
    assert whole[0].state_tangents.tobytes() == second.state_tangents.tobytes()


def test_a_robot_that_blows_up_is_told_and_others_are_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    base = drives(BuiltParameters(), 2)
    wild = rest_state(base.robot)
    wild[2, 0] = 1e9
    good, bad = sensitivities([base, replace(base, state=wild)], [["friction"]] * 2)
    assert bad.status == 0 and np.isnan(bad.tangents[0, 1:]).all() and np.isfinite(bad.tangents[0, 0]).all()
    assert good == sensitivities([base], [["friction"]])[0] and np.isfinite(good.tangents).all()


def test_what_is_refused() -> None:
    base = drives(BuiltParameters(), 2)
    with raises(InputError, "input.unknown-name", "parameter", match="found 'colour'"):
        sensitivities([base], [["colour"]])
    with raises(InputError, "input.wrong-shape", "tangents of the state of drive 0"):
        sensitivities([base], [["friction"]], state_tangents=[np.zeros((2, 3))])
    with raises(InputError, "input.wrong-value", "parameters of drive 0"):
        sensitivities([base], [[]])
    with raises(InputError, "input.wrong-number", "lists of parameters"):
        sensitivities([base], [])
    with raises(InputError, "robot.other-joints"):
        sensitivities([base], [["bending"]])
    with raises(InputError, "robot.other-joints"):
        sensitivities([drives(BuiltParameters.clamped(), 2)], [["socket"]])
    assert sensitivities([], []) == []
