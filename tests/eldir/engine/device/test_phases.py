"""The device's kernels on the processor, thread by thread, in both orders: they learn as the CPU's do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from eldir.controller import Controller
from eldir.engine.batch import BatchConfig, BatchResult, run_batch
from eldir.engine.compiler import NAME
from eldir.engine.device.records import ASCENDING, DESCENDING, DeviceResult, DeviceTask
from eldir.engine.device.run import numpy_memory, run
from eldir.engine.kernels.contact import NO_SLIP
from eldir.engine.shortcuts import Shortcuts
from eldir.engine.validity import NO_GRADIENT
from eldir.evolution.paper.configuration import make_terrain
from eldir.learning import initial_controllers
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.scene import Scene
from tests.eldir.engine.device.device_learning import LENGTH, make_task, on_processor
from tests.eldir.engine.random_robots import (
    SMALL,
    WEIGHTS,
    like,
    one,
    robots,
    triangles_at,
    without_motors,
)
from tests.eldir.engine.twin import complex_slopes, paper_rollout

pytestmark = pytest.mark.slow

STEPS, UPDATES = 60, 3
PAPER = Scene.preset("paper").replace(steps=STEPS, precision="f64")
ORDERS = [ASCENDING, DESCENDING]
TOO_LONG_WITH_TAICHI = pytest.mark.stress if NAME == "taichi" else ()
"""Kernels that take Taichi another 30 s. A missing barrier shows with Quadrants: the source is the same."""
Robots = tuple[list[Morphology], list[Controller]]


@pytest.fixture(scope="module", autouse=True)
def _processor() -> Iterator[None]:
    with on_processor():
        yield


def compute(task: DeviceTask, order: int = DESCENDING, **memory: int) -> DeviceResult:
    return run(task, numpy_memory(order, **memory))


@pytest.fixture(scope="module")
def group() -> Robots:
    return robots(SMALL, 4, 5, PAPER)


@pytest.fixture(scope="module")
def wanted(group: Robots) -> dict[int, BatchResult]:
    """What the CPU computes, by the number of updates."""
    return {n: reference(*group, PAPER, n) for n in (0, UPDATES)}


def reference(
    bodies: list[Morphology], brains: list[Controller], scene: Scene, iterations: int,
    physics: list[Physics] | None = None,
) -> BatchResult:  # fmt: skip
    return run_batch(
        bodies, brains, scene, physics,
        config=BatchConfig(
            backward=True, iterations=iterations, update_length=LENGTH, shortcuts=Shortcuts(no_contact=False)
        ),
    )  # fmt: skip


def of_robots(best: np.ndarray, result: BatchResult) -> list[np.ndarray]:
    """Weights or gradients of each robot."""
    return np.split(best, result.batch.weight_at[1:-1])


def assert_same(found: DeviceResult, wanted: BatchResult, loss: float = 1e-12, weights: float = 1e-9) -> None:
    """Losses [m]; growth of gradients; gradients or best weights relative to their length, robot by robot."""
    assert found.status.tolist() == wanted.status.tolist()
    np.testing.assert_allclose(found.growth, wanted.growth, rtol=1e-6)
    np.testing.assert_allclose(found.losses, wanted.losses, rtol=0, atol=loss)
    for a, b in zip(of_robots(found.best, wanted), of_robots(wanted.best, wanted), strict=True):
        assert np.linalg.norm(a - b) <= weights * np.linalg.norm(b)


@pytest.mark.parametrize("span", [STEPS, 25])
@pytest.mark.parametrize("iterations", [0, UPDATES])
@pytest.mark.parametrize("order", ORDERS)
def test_robots_learn_as_on_the_cpu(
    order: int, iterations: int, span: int, group: Robots, wanted: dict[int, BatchResult]
) -> None:
    """In one launch, and in launches of 25, 25 and 10 steps."""
    result = wanted[iterations]
    assert np.median(np.abs(result.losses)) > 1e-3 and (result.status == -1).all()
    assert iterations == 0 or (np.ptp(result.losses, axis=1) > 1e-6).all()
    assert_same(compute(make_task(*group, PAPER, iterations, span), order), result)


def test_the_equations_say_the_same(group: Robots) -> None:
    """The twin in NumPy: the loss, and its slope along two directions of the weights."""
    bodies, brains = group[0][:2], group[1][:2]
    found = compute(make_task(bodies, brains, PAPER))
    gradients = reference(bodies, brains, PAPER, 0).batch.controllers(found.best)
    rng = np.random.default_rng(1)
    for r, (body, brain, gradient) in enumerate(zip(bodies, brains, gradients, strict=True)):
        x, _, _ = paper_rollout(body, brain, PAPER)
        assert abs(found.losses[r, 0] - (x[0] - x[-1])[:, 0].mean()) < 1e-12
        still = Physics.of(body, PAPER).scaled(0.0)
        for along in (like(brain, rng), gradient):
            parts = [(getattr(gradient, k), getattr(along, k)) for k in WEIGHTS]
            (slope,) = complex_slopes(body, brain, PAPER, Physics.of(body, PAPER), still, along)
            lengths = [np.sqrt(sum((part[side] ** 2).sum() for part in parts)) for side in (0, 1)]
            assert abs(sum((a * b).sum() for a, b in parts) - slope) <= 1e-9 * lengths[0] * lengths[1]


def mixed(scene: Scene) -> Robots:
    """Robots of all sizes: of one triangle, without motors, and random ones."""
    bodies = [one(triangles_at((0, 1))), without_motors(), *robots(SMALL, 3, 1, scene)[0]]
    return bodies, initial_controllers(bodies, scene, 2)


def apart(bodies: list[Morphology], scene: Scene) -> list[Physics]:
    """Physics of each robot."""
    rng, made = np.random.default_rng(3), []
    for body in bodies:
        own = Physics.of(body, scene)
        made.append(
            own.replace(
                stiffness=own.stiffness * rng.uniform(0.5, 1.2, len(own.stiffness)),
                rest_lengths=own.rest_lengths * rng.uniform(0.95, 1.05, len(own.stiffness)),
                velocities=rng.normal(0, 0.3, own.velocities.shape),
                damping=rng.uniform(5, 20),
                gravity=rng.uniform(-9, -2),
            )
        )
    return made


SCENES = {
    "deaf": {"sensing": "none"},
    "centre": {"sensing": "centre"},
    "released weights": {"weights": "released"},
    "windows": {"window": 20},
    "unequal windows": {"window": 25, "sensing": "centre"},
    "free flight": {"contact": "none"},
    "matched": {"integrator": "matched"},
}


@pytest.mark.parametrize("physics", [False, True], ids=["same physics", "own physics"])
@pytest.mark.parametrize("name", SCENES)
def test_scenes_and_bodies(name: str, physics: bool) -> None:
    scene = PAPER.replace(**SCENES[name])
    bodies, brains = mixed(scene)
    owns = apart(bodies, scene) if physics else None
    for iterations, span in ((0, None), (2, 25)):
        task = make_task(bodies, brains, scene, iterations, span, owns)
        task = task._replace(settings=task.settings._replace(contact=NO_SLIP))
        assert_same(compute(task), reference(bodies, brains, scene, iterations, owns))


GROUNDS = {
    "flat": PAPER.replace(contact="friction"),
    "rugged": PAPER.replace(terrain=make_terrain("level", 1)),
    "rising, windows": PAPER.replace(terrain=make_terrain("incline", 2), window=25),
    "as released": PAPER.replace(terrain=make_terrain("decline", 3), contact="friction-released"),
}


@pytest.mark.parametrize("order", [pytest.param(one, marks=TOO_LONG_WITH_TAICHI) for one in ORDERS])
@pytest.mark.parametrize("name", GROUNDS)
def test_friction_on_any_ground(name: str, order: int) -> None:
    """With physics of each robot's own, in launches that forget what masses knew of the ground."""
    scene = GROUNDS[name]
    bodies, brains = mixed(scene)
    rng = np.random.default_rng(4)
    owns = [own.replace(friction=rng.uniform(0.2, 1.5)) for own in apart(bodies, scene)]
    for iterations, span in ((0, None), (2, 25)):
        wanted = run_batch(
            bodies,
            brains,
            scene,
            owns,
            config=BatchConfig(backward=True, iterations=iterations, update_length=LENGTH),
        )
        assert np.abs(wanted.losses[2:]).min() > 1e-4
        assert_same(compute(make_task(bodies, brains, scene, iterations, span, owns), order), wanted)


@pytest.mark.parametrize("order", [pytest.param(one, marks=TOO_LONG_WITH_TAICHI) for one in ORDERS])
@pytest.mark.parametrize("name", ["flat", pytest.param("rugged", marks=pytest.mark.stress)])
def test_positions_half_a_step_ahead(name: str, order: int) -> None:
    """The second-order integrator."""
    ground = PAPER if name == "flat" else GROUNDS[name]
    scene = ground.replace(integrator="second-order")
    bodies, brains = mixed(scene)
    owns = apart(bodies, scene)
    for iterations, span in ((0, None), (2, 25)):
        wanted = run_batch(
            bodies,
            brains,
            scene,
            owns,
            config=BatchConfig(backward=True, iterations=iterations, update_length=LENGTH),
        )
        assert_same(compute(make_task(bodies, brains, scene, iterations, span, owns), order), wanted)


def test_a_robot_that_blows_up_leaves_the_others_alone(group: Robots) -> None:
    """One at once, and one after its first update."""
    bodies, brains = group
    calm = [Physics.of(body, PAPER) for body in bodies]
    wild = [
        own.replace(stiffness=own.stiffness * factor)
        for own, factor in zip(calm, (1, 1e9, 1, 1.38), strict=True)
    ]
    for iterations in (0, UPDATES):
        found = compute(make_task(bodies, brains, PAPER, iterations, 25, wild))
        wanted = reference(bodies, brains, PAPER, iterations, wild)
        late = iterations > 0
        assert [s >= 0 for s in wanted.status] == [False, True, False, late]
        assert found.status.tolist() == wanted.status.tolist()
        assert np.isfinite(found.losses).sum(axis=1).tolist() == [iterations + 1, 0, iterations + 1, 1]
        np.testing.assert_allclose(found.losses, wanted.losses, rtol=0, atol=1e-9)
        undisturbed = compute(make_task(bodies, brains, PAPER, iterations, 25, calm))
        pairs = [of_robots(outcome.best, wanted) for outcome in (found, undisturbed)]
        for k in (0, 2):
            assert found.losses[k].tobytes() == undisturbed.losses[k].tobytes()
            assert pairs[0][k].tobytes() == pairs[1][k].tobytes()
        kept = of_robots(wanted.best, wanted)
        for k in (1, 3):
            assert np.linalg.norm(pairs[0][k] - kept[k]) <= 1e-6 * np.linalg.norm(kept[k])


def test_a_robot_that_blew_up_on_the_cpu_has_no_loss_on_a_device(group: Robots) -> None:
    """Near the limit of stability, where speeds grow slowly: a device must not call the distance that a
    part of the robot has flown a walk."""
    bodies, brains = group
    factors = np.linspace(1.38, 1.52, 25)
    own = Physics.of(bodies[2], PAPER)
    wild = [own.replace(stiffness=own.stiffness * factor) for factor in factors]
    many = [bodies[2]] * len(wild), [brains[2]] * len(wild)
    found = compute(make_task(*many, PAPER, 0, 25, wild))
    wanted = reference(*many, PAPER, 0, wild)
    gone = wanted.status >= 0
    assert 3 < gone.sum() < len(gone)
    assert np.isinf(found.losses[gone]).all() and found.status.tolist() == wanted.status.tolist()


OVERFLOWING = PAPER.replace(damping=0.0, dt=0.002, steps=2000)
"""Of the robots of `group` every reverse sweep overflows in it, however their chaotic motion is rounded."""


@pytest.mark.parametrize("iterations", [0, 1])
@pytest.mark.parametrize("order", ORDERS)
def test_a_gradient_that_overflows_is_not_kept(order: int, iterations: int, group: Robots) -> None:
    found = compute(make_task(*group, OVERFLOWING, iterations, 500), order)
    wanted = reference(*group, OVERFLOWING, iterations)
    for outcome in (found, wanted):
        assert outcome.status.tolist() == [NO_GRADIENT] * 4 and np.isinf(outcome.losses).all()
        assert not outcome.best.any() and (outcome.growth[:, 0] > 1e18).all()


def test_a_robot_has_the_same_bytes_in_any_company(group: Robots, caplog: pytest.LogCaptureFixture) -> None:
    """Whatever robots are beside it and in whatever order, all at once or a few at a time."""
    bodies, brains = (a + b for a, b in zip(mixed(PAPER), group, strict=True))
    n = len(bodies)

    def computed(chosen: list[int], **memory: int) -> list[bytes]:
        """Losses and best weights of each robot."""
        some = [bodies[k] for k in chosen], [brains[k] for k in chosen]
        task = make_task(*some, PAPER, 1, 25)
        found = compute(task, **memory)
        best = np.split(found.best, task.offsets[1:, -1])
        return [found.losses[k].tobytes() + best[k].tobytes() for k in range(len(chosen))]

    together = computed([*range(n)])
    assert len({*together}) == n
    assert computed([*range(n)][::-1]) == together[::-1]
    assert [computed([k])[0] for k in range(n)] == together
    caplog.set_level("INFO")
    assert computed([*range(n)], history_values=110_000) == together
    _, at_once = caplog.records[-1].args  # number of robots, and of those at once
    assert 1 < at_once < n - 1


@pytest.mark.stress  # kernels of its own
@pytest.mark.parametrize("order", ORDERS)
def test_free_flight_without_ground(order: int) -> None:
    scene = PAPER.replace(contact="none")
    task = make_task(*mixed(scene), scene)
    assert task.settings.contact != NO_SLIP
    assert_same(compute(task, order), reference(*mixed(scene), scene, 0))
