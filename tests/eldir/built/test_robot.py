"""The built scene against closed forms, a twin in NumPy, symmetry and conservation."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import jsonschema
import numpy as np
import pytest

from eldir.built import motion as driving
from eldir.built.motion import OK, drive
from eldir.built.robot import build, rest_state
from eldir.built.stability import stable_step, stable_step_in_any_pose
from eldir.controller import Controller
from eldir.core.validation import adapter
from eldir.design import Ballast
from eldir.errors import EldirError, InputError
from eldir.genotype import Genotype, random_genotypes
from eldir.learning import learn
from eldir.morphology import develop
from eldir.parameters.printed import BuiltParameters
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.terrain import Terrain
from tests.eldir.built.braced_robots import COLD, FREE_FALL, HOT, LATTICE, bodies, strip, swing, unheated
from tests.eldir.engine.twin import built_run
from tests.raised import raises


def test_the_preset_is_the_built_robots_scene() -> None:
    scene = Scene.preset("built")
    assert scene.built == BuiltParameters() and scene.gravity == -9.81 and scene.contact == "coulomb"
    assert Scene.from_json(json.loads(json.dumps(scene.to_json()))) == scene
    softer = scene.replace(stiffness=20e3, steps=200)
    assert softer.built is not None and softer.built.tension == 20e3
    assert scene.replace(built=BuiltParameters(gravity=-1.62)).gravity == -1.62
    schema = adapter(Scene).json_schema()
    jsonschema.validate(softer.to_json(), schema)
    jsonschema.validate(Scene.preset("paper").to_json(), schema)
    assert "built" not in Scene.preset("paper").to_json()


def test_a_built_scene_is_driven_and_not_taught() -> None:
    scene, body = Scene.preset("built"), bodies(1)[0]
    brain = Controller.random(len(body.positions), body.motors, np.random.default_rng(0))
    for trained in (simulate, loss_and_gradient):
        with raises(InputError, "scene.no-controller", match=r"eldir\.built\.drive"):
            trained([body], [brain], scene)
    with raises(InputError, "scene.no-controller"):
        learn([body], scene, 1)
    assert scene.built is not None
    robot = build(body, scene.built)
    (motion,) = drive([robot], [unheated(robot, 4)], scene.dt)
    assert motion.times == pytest.approx([0, 0.05, 0.1, 0.15])


def test_a_built_scene_may_have_any_terrain() -> None:
    """It is saved with it, keeps its law of contact, and a robot stands on it."""
    ground = Terrain.rugged(np.random.default_rng(0))
    scene = Scene.preset("built").replace(terrain=ground)
    assert scene.contact == "coulomb" and Scene.from_json(json.loads(json.dumps(scene.to_json()))) == scene
    assert scene.built is not None
    robot = build(bodies(1)[0], scene.built)
    (motion,) = drive([robot], [unheated(robot, 4)], scene.dt, terrain=scene.terrain)
    over = motion.positions[0, :, 1] - ground.height(motion.positions[0, :, 0])
    assert over.min() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "value", "code", "key"),
    [
        ("contact", "friction", "scene.inconsistent", "Scene.built"),
        ("precision", "f32", "scene.inconsistent", "Scene.precision"),
        ("built", None, "scene.inconsistent", "Scene.built"),
        ("gravity", 1.0, "built-parameters.wrong-value", "gravity"),
    ],
)
def test_what_a_built_scene_cannot_be(name: str, value: Any, code: str, key: str) -> None:
    with raises(InputError, code, key):
        Scene.preset("built").replace(**{name: value})
    with raises(InputError, "scene.inconsistent", "Scene.built"):
        Scene.preset("paper").replace(contact="coulomb")
    with raises(InputError, "scene.inconsistent", "Scene.damping", match=r"Scene\.built\.drag"):
        Scene(contact="coulomb", precision="f64", gravity=-9.81, stiffness=178e3, built=BuiltParameters())
    with raises(InputError, "built-parameters.missing-key", "active_damping"):
        BuiltParameters.from_json({"pitch": 0.05})


def test_masses_of_a_triangle() -> None:
    mask = np.zeros((6, 11), bool)
    mask[0, 1] = True
    springs = np.zeros(110, bool)
    springs[np.flatnonzero(LATTICE.expressed_springs(mask))[0]] = True
    body = develop(LATTICE, Genotype(mask, springs))
    robot = build(body)
    p = BuiltParameters()
    corner = p.hexagon + p.half_connector + p.strip / 2
    light, heavy = corner + p.strip / 2, corner + p.active_spring / 2
    assert sorted(robot.masses) == pytest.approx([light, heavy, heavy])
    assert robot.positions.min(axis=0) == pytest.approx([0, 0])
    assert robot.body_length == pytest.approx(p.pitch)
    passive = build(body, without_motor=0, ballast=9e-3)
    assert not passive.active.any() and np.isfinite(passive.buckling).all()
    foremost = int(passive.positions[:, 0].argmax())
    assert passive.masses[foremost] == pytest.approx(light + 9e-3)
    assert passive.masses.sum() == pytest.approx(3 * light + 9e-3)
    with raises(InputError, "input.wrong-value", "without_motor"):
        build(body, without_motor=1)


@pytest.mark.parametrize("seed", range(20))
def test_a_ballast_is_on_the_lower_of_the_foremost_masses_as_the_packet_has_it(seed: int) -> None:
    body = develop(LATTICE, random_genotypes(LATTICE, 1, np.random.default_rng(seed), 2)[0])
    (loaded,) = np.flatnonzero(build(body, ballast=9e-3).masses - build(body).masses)
    x, y = body.positions.round(9).T
    assert x[loaded] == x.max() and y[loaded] == y[x == x.max()].min()
    assert Ballast.parse("9g@front", body).mass == loaded


@pytest.mark.parametrize(("missing", "strips", "connectors"), [((), 6, 0), ((5, 6), 5, 1)])
def test_a_mass_with_six_springs_has_no_connector(
    missing: tuple[int, ...], strips: int, connectors: int
) -> None:
    mask = np.zeros((6, 11), bool)
    mask[:2, 4:7] = True  # six triangles about one vertex
    mask[1, list(missing)] = False
    body = develop(LATTICE, Genotype(mask, np.zeros(110, bool)))
    robot = build(body)
    centre = int(np.bincount(body.springs.ravel()).argmax())
    p = robot.parameters
    expected = p.hexagon + strips * p.strip / 2 + connectors * p.half_connector
    assert robot.masses[centre] == pytest.approx(expected)


def test_two_masses_swing_as_the_closed_form_says() -> None:
    robot = strip((0, 1), (0.05, 1), (2e-3, 3e-3), FREE_FALL)
    dt, stretch = 2e-5, 1e-4
    state = rest_state(robot)
    state[0, 1] += stretch
    (motion,) = drive([robot], [unheated(robot, 3001)], dt, states=[state], step=dt)
    found = np.diff(motion.positions[:, :, 0], axis=1)[:, 0] - 0.05
    omega = np.sqrt(FREE_FALL.tension / (2e-3 * 3e-3 / 5e-3))
    angle = np.arccos(1 - (omega * dt) ** 2 / 2)  # semi-implicit Euler, exactly
    assert angle == pytest.approx(omega * dt, rel=0.01)
    expected = stretch * np.cos(angle * (np.arange(3001) + 0.5)) / np.cos(angle / 2)
    assert np.abs(found - expected).max() < 1e-8 * 1e-1
    momentum = motion.state[2] @ robot.masses
    assert abs(momentum) < 1e-12


@pytest.mark.parametrize("mu", [0.2, 0.5, 1.0])
@pytest.mark.parametrize("speed", [0.3, -0.5])
@pytest.mark.parametrize("backward", [1.0, 2.5])
def test_sliding_distance(mu: float, speed: float, backward: float) -> None:
    p = BuiltParameters(friction=mu, drag=0.0, backward_friction=backward)
    robot = strip((0, 0), (0.05, 0), (2e-3, 2e-3), p)
    state = rest_state(robot)
    state[2] = speed
    (motion,) = drive([robot], [unheated(robot, 40)], 0.01, states=[state], step=2e-5)
    slid = motion.positions[-1, :, 0].mean() - 0.025
    mu *= backward if speed < 0 else 1.0
    assert slid == pytest.approx(np.sign(speed) * speed**2 / (2 * mu * 9.81), rel=3e-3)
    assert np.abs(motion.state[2:]).max() < 1e-9  # and it has stopped


@pytest.mark.parametrize("masses", [(2e-3, 2e-3), (1e-3, 4e-3)])
def test_each_foot_has_its_own_friction(masses: tuple[float, float]) -> None:
    """Two feet slide together: the mean friction, weighed by the loads, stops them."""
    p, feet = BuiltParameters(friction=0.5, drag=0.0), np.array([0.6, 1.2])
    robot = replace(strip((0, 0), (0.05, 0), masses, p), feet=feet)
    state = rest_state(robot)
    state[2] = speed = 0.4
    (motion,) = drive([robot], [unheated(robot, 40)], 0.01, states=[state], step=2e-5)
    slid = (motion.positions[-1, :, 0] - robot.positions[:, 0]) @ robot.masses / robot.masses.sum()
    mu = robot.friction @ robot.masses / robot.masses.sum()
    assert slid == pytest.approx(speed**2 / (2 * mu * 9.81), rel=3e-3)
    assert robot.friction == pytest.approx([0.3, 0.6])


@pytest.mark.parametrize("downhill", [1, -1])
def test_a_tilted_table_is_slippery_beyond_the_angle_of_friction(downhill: int) -> None:
    def slid(slope: float) -> float:
        p = BuiltParameters(friction=0.5, drag=0.0, tilt=float(downhill * np.arctan(slope)))
        robot = strip((0, 0), (0.05, 0), (2e-3, 2e-3), p)
        (motion,) = drive([robot], [unheated(robot, 51)], 0.01, step=2e-5)
        return float(motion.positions[-1, :, 0].mean() - 0.025)

    assert slid(0.49) == 0
    steep = np.arctan(0.6)
    acceleration = 9.81 * (np.sin(steep) - 0.5 * np.cos(steep))
    assert downhill * slid(0.6) == pytest.approx(0.5 * acceleration * 0.5**2, rel=1e-4)


def test_falling_with_drag() -> None:
    p = BuiltParameters(drag=2.0)
    robot = strip((0, 5), (0.05, 5), (2e-3, 2e-3), p)
    (motion,) = drive([robot], [unheated(robot, 51)], 0.01)
    t = motion.times
    fall = 9.81 / 2.0 * (t - (1 - np.exp(-2.0 * t)) / 2.0)
    assert np.abs(5 - motion.positions[:, 0, 1] - fall).max() < 1e-3


@pytest.mark.parametrize("load", [0.5, 1.05, 1.2])
def test_a_strip_bears_its_buckling_load_and_little_more(load: float) -> None:
    """Upright, with a weight on top: Hooke below the Euler load, then P = PE (1 + s / 2 L)."""
    p = BuiltParameters(drag=10.0)
    weight = load * p.buckling
    robot = strip((0, 0), (0, 0.05), (2e-3, weight / 9.81), p)
    (motion,) = drive([robot], [unheated(robot, 601)], 0.01, every=100)
    shortened = 0.05 - motion.positions[-1, 1, 1]
    expected = weight / p.tension if load < 1 else 2 * 0.05 * (load - 1)
    assert shortened == pytest.approx(expected, rel=1e-3)


def test_an_active_spring_pulls_linearly_however_far() -> None:
    spring = replace(
        strip((0, 1), (0.2, 1), (2e-3, 3e-3), FREE_FALL), active=np.ones(1, bool), buckling=np.full(1, np.inf)
    )
    dt = 1e-4
    for free, stiffness in ((COLD, FREE_FALL.cold_stiffness), (HOT, FREE_FALL.hot_stiffness)):
        (motion,) = drive([spring], [np.full((51, 1), free)], dt, step=dt)
        found = np.diff(motion.positions[:, :, 0], axis=1)[:, 0]
        angle = np.arccos(1 - stiffness / (2e-3 * 3e-3 / 5e-3) * dt**2 / 2)
        expected = free + (0.2 - free) * np.cos(angle * (np.arange(51) + 0.5)) / np.cos(angle / 2)
        assert np.abs(found - expected).max() < 1e-9


@pytest.mark.parametrize(
    ("parameters", "instants"), [(BuiltParameters(), 151), (BuiltParameters.clamped(), 101)]
)
def test_nothing_moves_without_heat(parameters: BuiltParameters, instants: int) -> None:
    """It creeps less than a thousandth of its length in a minute, or in a quarter of one if it is clamped."""
    robot = build(bodies(2)[1], parameters)  # the first one falls over
    (motion,) = drive([robot], [unheated(robot, instants)], 0.1, every=25)
    assert motion.positions[..., 1].min() > -1e-9
    assert np.ptp(motion.positions[-1, :, 1]) > 0.9 * np.ptp(robot.positions[:, 1])
    middle = motion.positions[3:, :, 0].mean(axis=1)
    most = 1e-3 * instants / (150 if parameters.joints == "clamped" else 600)
    assert np.abs(middle - middle[0]).max() < most * robot.body_length


def test_a_mirrored_design_moves_mirrored() -> None:
    body = bodies(1)[0]
    robot = build(body)
    order = np.lexsort((robot.positions[:, 1], -robot.positions[:, 0]))
    number = np.argsort(order)
    mirrored = replace(
        robot,
        positions=robot.positions[order] * [-1, 1],
        masses=robot.masses[order],
        springs=number[robot.springs].astype(np.int32),
    )
    table = swing(robot, 31)
    one, other = drive([robot, mirrored], [table, table], 0.01)
    assert np.ptp(one.positions, axis=0).max() > 1e-3
    assert np.abs(one.positions[:, order] * [-1, 1] - other.positions).max() < 1e-7


@pytest.mark.parametrize(
    "parameters",
    [BuiltParameters(), BuiltParameters.clamped(), BuiltParameters(tilt=-0.1, backward_friction=2.5)],
    ids=["pinned", "clamped", "tilted"],
)
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_twin_moves_the_same(seed: int, parameters: BuiltParameters) -> None:
    robot = build(bodies(1, seed)[0], parameters)
    interval, instants = 0.005, 7
    step = 0.9 * stable_step(robot)
    lengths = COLD + (HOT - COLD) * np.random.default_rng(seed).random((instants, int(robot.active.sum())))
    (motion,) = drive([robot], [lengths], interval, step=step)
    twin = built_run(robot, lengths, interval, int(np.ceil(interval / step)), (COLD, HOT))
    assert np.ptp(motion.positions, axis=0).max() > 1e-4
    assert np.abs(motion.positions - twin).max() < 1e-11


def test_a_robot_does_not_depend_on_its_neighbours() -> None:
    """Robots of one body share vectors in the engine, each with its own parameters and steps."""
    body, p = bodies(1)[0], BuiltParameters()
    robots = [build(body, p.perturb(rng), rng=rng) for rng in map(np.random.default_rng, range(11))]
    tables = [swing(r, 31, period=0.2 + 0.02 * i) for i, r in enumerate(robots)]
    assert len({driving.substeps(r, 0.01, None) for r in robots}) > 2
    together = drive(robots, tables, 0.01)
    for robot, table, motion in zip(robots, tables, together, strict=True):
        (alone,) = drive([robot], [table], 0.01)
        assert alone == motion


def test_going_on_equals_one_long_run_and_threads_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    robots = [build(m) for m in bodies(3)]
    tables = [swing(r, 41) for r in robots]
    monkeypatch.setenv("ELDIR_THREADS", "1")
    whole = drive(robots, tables, 0.01)
    monkeypatch.setenv("ELDIR_THREADS", "2")
    first = drive(robots, [t[:21] for t in tables], 0.01)
    second = drive(robots, [t[20:] for t in tables], 0.01, states=[m.state for m in first])
    for w, f, s in zip(whole, first, second, strict=True):
        assert w.positions[:21].tobytes() == f.positions.tobytes()
        assert w.positions[20:].tobytes() == s.positions.tobytes()
        assert w.state.tobytes() == s.state.tobytes()
    (rare,) = drive(robots[:1], tables[:1], 0.01, every=10)
    assert rare.positions.tobytes() == whole[0].positions[::10].tobytes()
    assert np.allclose(rare.times, np.arange(5) * 0.1)


@pytest.mark.parametrize("bending", [0.0, 0.0194, 2.0])
def test_the_largest_step_is_the_largest(bending: float, monkeypatch: pytest.MonkeyPatch) -> None:
    body = bodies(1, 3)[0]
    passive = replace(body, active=np.zeros(len(body.springs), bool))
    robot = build(passive, replace(FREE_FALL, bending=bending))
    state, largest = rest_state(robot), stable_step(robot)
    state[1] += 1.0
    state[0] += 1e-9 * np.random.default_rng(0).standard_normal(len(robot.masses))
    monkeypatch.setattr(driving, "stable_step", lambda robot: np.inf)
    grown = {}
    for part in (0.97, 1.05):
        dt = part * largest
        (motion,) = drive([robot], [unheated(robot, 2001)], dt, states=[state], step=dt, every=2000)
        off = motion.positions[-1] - robot.positions - [0, 1]
        grown[part] = motion.status >= 0 or np.abs(off).max() > 1e-6
    assert grown == {0.97: False, 1.05: True}


@pytest.mark.parametrize("bending", [0.0, 0.0194, 2.0])
def test_no_pose_has_a_smaller_stable_step(bending: float) -> None:
    rng = np.random.default_rng(1)
    for body in bodies(3):
        robot = build(body, BuiltParameters(bending=bending))
        least = stable_step_in_any_pose(robot)
        for _ in range(20):
            folded = replace(robot, positions=rng.standard_normal(robot.positions.shape))
            assert stable_step(folded) >= least * (1 - 1e-9)


def test_what_is_refused() -> None:
    robot = build(bodies(1)[0])
    table = unheated(robot, 3)
    with raises(EldirError, "scene.large-step"):
        drive([robot], [table], 0.01, step=1.03 * stable_step(robot))
    with raises(InputError, "input.wrong-shape", "lengths of robot 0"):
        drive([robot], [table[:, :1]], 0.01)
    with raises(InputError, "built-parameters.wrong-value", "friction"):
        BuiltParameters(friction=-0.1)
    with raises(InputError, "built-parameters.wrong-value", "gravity"):
        BuiltParameters(gravity=9.81)
    with raises(InputError, "built-parameters.wrong-value", "tilt"):
        BuiltParameters(tilt=2.0)
    assert drive([], [], 0.01) == []


def test_another_specimen_differs_a_little_and_repeats() -> None:
    nominal = BuiltParameters()
    specimens = [nominal.perturb(np.random.default_rng(s)) for s in range(200)]
    frictions = np.array([s.friction for s in specimens])
    assert 0.35 <= frictions.min() < 0.37 and 0.63 < frictions.max() <= 0.65
    tensions = np.log([s.tension / nominal.tension for s in specimens])
    assert tensions.std() == pytest.approx(0.1, rel=0.2)
    assert nominal.perturb(np.random.default_rng(0)) == specimens[0]
    body = bodies(1)[0]
    off = [
        (r := build(body, specimens[0], rng=np.random.default_rng(s))).rest_lengths[~r.active] - 0.05
        for s in range(20)
    ]
    assert np.std(off) == pytest.approx(0.3e-3, rel=0.2)


def test_a_robot_that_blows_up_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = build(bodies(1)[0])
    monkeypatch.setattr(driving, "stable_step", lambda robot: np.inf)
    table = unheated(robot, 21)
    bad, good = drive([robot, robot], [table] * 2, 0.01, step=1e-3)[0], drive([robot], [table], 0.01)[0]
    assert bad.status >= 0 and np.isnan(bad.positions[bad.status + 1 :]).all()
    assert np.isfinite(bad.positions[: bad.status + 1]).all()
    assert good.status == OK and np.isfinite(good.positions).all()
