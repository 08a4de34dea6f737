"""Printed robots on a terrain: closed forms, the tilted table, energy, twins, derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.ground import heights, place
from eldir.built.motion import drive
from eldir.built.robot import PrintedRobot, build, rest_state
from eldir.built.sensitivities import DriveInputs, sensitivities
from eldir.built.stability import stable_step
from eldir.built.walking import tie_share
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain
from tests.eldir.built.braced_robots import COLD, HOT, bodies, energy, strip, swing, unheated
from tests.eldir.built.grounds import plane, polyline, steps, zigzag
from tests.eldir.engine.twin import built_run
from tests.raised import raises

KINDS = {
    "pins": BuiltParameters(),
    "clamped": BuiltParameters.clamped(),
    "hubs": BuiltParameters().with_hubs(),
}


def corners(robot: PrintedRobot, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Where masses, or all corners of hubs, may meet the ground, shape (T, P, 2)."""
    if robot.joints != "hubs":
        return positions
    angles = np.arctan2(rotations[..., 1], rotations[..., 0])[..., None] + np.radians(60) * np.arange(6)
    arms = robot.parameters.corner * np.stack(
        [np.cos(angles - np.pi / 2), 1 + np.sin(angles - np.pi / 2)], -1
    )
    return (positions[:, :, None] + arms).reshape(len(positions), -1, 2)


@pytest.mark.parametrize("joints", KINDS)
def test_a_level_terrain_is_the_table(joints: str) -> None:
    robots = [build(body, KINDS[joints]) for body in bodies(4, 7)]
    tables = [swing(r, 5) for r in robots]
    level = Terrain.from_segments(np.array([-0.1, 0.03]), np.zeros(2), np.full(2, 0.2))
    for table, terrain in zip(
        drive(robots, tables, 0.01), drive(robots, tables, 0.01, terrain=level), strict=True
    ):
        assert np.abs(terrain.positions - [0, 0.2] - table.positions).max() < 1e-9
    if joints != "hubs":
        assert drive(robots, tables, 0.01, terrain=plane(0.0)) == drive(robots, tables, 0.01)


@pytest.mark.parametrize("joints", KINDS)
@pytest.mark.parametrize("tilt", [0.15, -0.4])
def test_a_slope_is_a_tilted_table(joints: str, tilt: float) -> None:
    """The same physics in another frame, with feet that grip more backward."""
    p = replace(KINDS[joints], backward_friction=1.4)
    robot = build(bodies(1, 7)[0], p)
    lengths = swing(robot, 5)
    (tilted,) = drive([replace(robot, parameters=replace(p, tilt=tilt))], [lengths], 0.01)
    turn = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
    state = rest_state(robot)
    state[:2] = turn @ state[:2]
    if joints != "pins":
        state[4:6] = turn @ state[4:6]
    lowered = p.corner * (1 - 1 / np.cos(tilt))  # heights count from a hub that stands on level ground
    ground = plane(-np.tan(tilt), lowered)
    (sloping,) = drive([robot], [lengths], 0.01, terrain=ground, states=[state])
    assert np.ptp(tilted.positions, axis=0).max() > 1e-3
    assert np.abs(tilted.positions @ turn.T - sloping.positions).max() < 1e-9


@pytest.mark.parametrize("downhill", [1, -1])
def test_a_slope_is_slippery_beyond_the_angle_of_friction(downhill: int) -> None:
    def slid(slope: float) -> float:
        robot = strip((0, 0), (0.05, -0.05 * downhill * slope), (2e-3, 2e-3), BuiltParameters(drag=0.0))
        ground = plane(-downhill * slope)
        (motion,) = drive([robot], [unheated(robot, 51)], 0.01, step=2e-5, terrain=ground)
        assert np.abs(heights(motion.positions, ground)).max() < 1e-9
        return float(motion.positions[-1, :, 0].mean() - 0.025)

    assert abs(slid(0.49)) < 1e-9
    steep = np.arctan(0.6)
    acceleration = 9.81 * (np.sin(steep) - 0.5 * np.cos(steep)) * np.cos(steep)
    assert downhill * slid(0.6) == pytest.approx(0.5 * acceleration * 0.5**2, rel=1e-4)


def test_from_a_ridge_each_mass_goes_down_its_side_and_a_valley_holds_it() -> None:
    """Without friction, down a slope of 45 degrees by g t^2 / 4; in the valley the collision takes all speed
    that is not along the other side, here all of it."""
    robot = strip((0, 0), (0.05, 0), (2e-3, 2e-3), BuiltParameters(friction=0.0, drag=0.0, tension=1e-6))
    ridge = polyline(np.array([-0.2, 0.025, 0.25]), np.array([-0.225, 0.0, -0.225]))
    state = place(robot, ridge)
    state[0] = [0.0249, 0.0251]
    state[1] = -1e-4
    (motion,) = drive([robot], [unheated(robot, 11)], 0.01, step=2e-5, states=[state], terrain=ridge)
    fallen = 9.81 * motion.times**2 / 4
    assert np.abs(motion.positions[:, 1, 0] - 0.0251 - fallen).max() < 1e-5
    assert np.abs(motion.positions[:, 0, 0] - 0.0249 + fallen).max() < 1e-5
    valley = polyline(np.array([-0.2, 0.025, 0.25]), np.array([0.225, 0.0, 0.225]))
    state[0], state[1] = [0.0, 0.05], 0.025
    (motion,) = drive([robot], [unheated(robot, 31)], 0.01, step=2e-5, states=[state], terrain=valley)
    assert np.abs(motion.positions[-1] - [0.025, 0.0]).max() < 1e-5
    assert np.abs(motion.state[2:4]).max() < 2e-3


@pytest.mark.parametrize("ground", [zigzag(1), steps()], ids=["zigzag", "steps"])
@pytest.mark.parametrize("joints", KINDS)
def test_no_part_goes_into_the_ground(joints: str, ground: Terrain) -> None:
    robots = [build(body, KINDS[joints]) for body in bodies(8, 3)]
    for robot, motion in zip(
        robots, drive(robots, [swing(r, 81) for r in robots], 0.01, terrain=ground), strict=True
    ):
        if joints == "hubs" and motion.rotations[..., 0].min() < 0.5:
            continue  # a hub has turned by more than 60 degrees: the body has folded
        touching = heights(corners(robot, motion.positions, motion.rotations), ground)
        steepest = np.hypot(1.0, np.abs(ground.slope).max())
        assert touching.min() > -1e-4 * steepest
        assert np.median(touching.min(axis=1)) > -1e-8 * steepest
        assert (np.abs(touching[1:]) < 1e-6).any()


@pytest.mark.parametrize("ground", [zigzag(2), steps()], ids=["zigzag", "steps"])
def test_ground_never_gives_energy(ground: Terrain) -> None:
    """A body of hubs without motors, thrown onto the ground; without friction in its sockets and damping."""
    body = bodies(1, 3)[0]
    p = replace(KINDS["hubs"], socket_friction=0.0, drag=0.0, strip_damping=0.0, buckling=1e9, tension=2e3)
    robot = build(replace(body, active=np.zeros(len(body.springs), bool)), p)
    state = place(robot, ground)
    state[1] += 0.02
    state[2], state[3] = 0.3, -0.2
    energies = []
    for _ in range(60):
        (motion,) = drive([robot], [np.zeros((2, 0))], 0.005, states=[state], terrain=ground, step=2e-5)
        state = motion.state
        weight = -p.gravity * robot.masses @ state[1]
        energies.append(energy(robot, state) + weight)
    kinetic = robot.masses.sum() * (0.3**2 + 0.2**2) / 2
    assert energies[-1] < energies[0] - 0.5 * kinetic  # it has landed
    assert np.diff(energies).max() < 1e-2 * kinetic  # of steps of finite length


@pytest.mark.parametrize("ground", [zigzag(1), zigzag(4, 1.2), steps()], ids=["zigzag", "steep", "steps"])
@pytest.mark.parametrize("joints", KINDS)
def test_twin_moves_the_same(joints: str, ground: Terrain) -> None:
    p = replace(KINDS[joints], backward_friction=1.5, socket_turn=0.03 * (joints == "hubs"), tilt=0.05)
    robot = build(bodies(1, 2)[0], p)
    interval, instants = 0.003, 3
    step = 0.9 * stable_step(robot)
    lengths = COLD + (HOT - COLD) * np.random.default_rng(2).random((instants, int(robot.active.sum())))
    start = place(robot, ground)
    start[3] = -0.5  # it lands at once
    (motion,) = drive([robot], [lengths], interval, step=step, terrain=ground, states=[start])
    twin = built_run(robot, lengths, interval, int(np.ceil(interval / step)), (COLD, HOT), ground, start)
    below = Terrain(ground.x0, ground.slope, ground.intercept - 1.0)
    (falling,) = drive([robot], [lengths], interval, step=step, terrain=below, states=[start])
    assert np.abs(motion.positions - falling.positions).max() > 1e-3
    assert np.abs(motion.positions - twin).max() < 1e-11


@pytest.mark.parametrize("joints", KINDS)
def test_derivatives_are_those_of_the_motion(joints: str) -> None:
    ground = zigzag(1)
    robot = build(bodies(1, 7)[0], KINDS[joints])
    step, names = 0.8 * stable_step(robot), ["friction", "gravity", "hexagon", "pitch"]
    lengths = COLD + 0.002 + 0.9 * (swing(robot, 11, period=0.1, interval=0.005) - COLD)
    base = DriveInputs(robot, lengths, 0.005, terrain=ground)
    (found,) = sensitivities([base], [names], step=step)
    (motion,) = drive([robot], [lengths], 0.005, step=step, terrain=ground)
    assert np.abs(found.positions - motion.positions).max() < 1e-13
    for name, tangent in zip(names, found.tangents, strict=True):
        value = getattr(robot.parameters, name)
        differences = []
        for part in (1e-5, 1e-6, 1e-7):
            h = part * abs(value)
            sides = [
                robot.with_parameters(replace(robot.parameters, **{name: value + sign * h}))
                for sign in (1, -1)
            ]
            up, down = drive(sides, [lengths] * 2, 0.005, step=step, terrain=ground)
            differences.append((up.positions - down.positions) / (2 * h))
        error = min(np.abs(tangent - d).max() for d in differences)
        assert error < 1e-5 * np.abs(tangent).max(), name


def test_robots_do_not_depend_on_their_neighbours() -> None:
    """Robots that share vectors, some in the air, each over its own segments."""
    ground = zigzag(5)
    for p in KINDS.values():
        robots = [build(bodies(1)[0], p.perturb(np.random.default_rng(i))) for i in range(9)]
        tables = [swing(r, 11, period=0.2 + 0.02 * i) for i, r in enumerate(robots)]
        starts = [place(r, ground) for r in robots]
        for i, start in enumerate(starts):
            start[0] += 0.01 * i
            start[1] += 0.003 + 0.05 * (i % 2)
        together = drive(robots, tables, 0.01, terrain=ground, states=starts)
        for robot, table, start, motion in zip(robots, tables, starts, together, strict=True):
            assert drive([robot], [table], 0.01, terrain=ground, states=[start]) == [motion]


def test_drives_on_several_grounds_at_once() -> None:
    robot = build(bodies(1)[0])
    inputs = DriveInputs(robot, swing(robot, 6), 0.01)
    grounds = [None, zigzag(1), zigzag(2)]
    together = sensitivities([replace(inputs, terrain=g) for g in grounds], [["friction"]] * 3)
    for ground, found in zip(grounds, together, strict=True):
        assert [found] == sensitivities([replace(inputs, terrain=ground)], [["friction"]])
    assert together[0] != together[1] != together[2]


def test_sliding_counts_on_the_ground_wherever_it_is() -> None:
    robot = build(bodies(1)[0])
    (motion,) = drive([robot], [swing(robot, 41)], 0.01)
    lifted = motion.positions + np.array([0.0, 0.2])
    assert tie_share(robot, lifted, plane(0.0, 0.2)) == tie_share(robot, motion.positions)


@pytest.mark.parametrize(("lifted", "share"), [(0.0, 1.0), (1e-3, 0.0)], ids=["stands", "hovers"])
@pytest.mark.parametrize("turned", [0.0, 12.0, 30.0])
def test_sliding_of_hubs_counts_on_whichever_corner_they_stand(turned: float, lifted: float, share: float):
    """Both feet move uphill by 1 mm in each instant and bear the same load. Their lowest corners stand on the
    slope, or 1 mm above it."""
    slope, corner = 0.4, KINDS["hubs"].corner
    robot = strip((0, 0), (0.05, 0.02), (2e-3, 2e-3), KINDS["hubs"])
    angles = np.radians([turned, turned, turned - 60, turned - 60])
    rise = (np.cos(angles) + slope * np.sin(angles)).max() - 1
    x = np.arange(5)[:, None] * 1e-3 + np.array([0.0, 0.05])
    positions = np.stack([x, slope * x + corner * rise + lifted], axis=2)
    assert tie_share(robot, positions, plane(slope)) == share


def test_what_is_refused() -> None:
    robot = build(bodies(1)[0])
    arguments = [robot], [swing(robot, 3)], 0.01
    for ground, wrong in (
        (plane(21.0), "slopes up to 20; found 21"),
        (polyline(np.array([0, 5e-5, 0.1]), np.zeros(3)), "at least 0.1 mm; found 0.05 mm"),
        (Terrain.from_segments(np.array([0, 0.1]), np.zeros(2), np.array([0, 0.1])), "segments that meet"),
    ):
        with raises(InputError, "input.wrong-value", "terrain", match=wrong):
            drive(*arguments, terrain=ground)
        with raises(InputError, "input.wrong-value", "terrain", match=wrong):
            sensitivities([DriveInputs(*arguments[0], arguments[1][0], 0.01, terrain=ground)], [["friction"]])
