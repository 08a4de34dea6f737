"""The training loop: the engine's own loop is the same as the general one, and robots that blow up stop."""

import numpy as np
import pytest

from eldir.errors import EldirError
from eldir.learning import learn, learning_paths
from eldir.physics import Physics
from eldir.rollout import simulate
from eldir.scene import Scene
from eldir.training.configuration import Adam, FixedLength, TrainingConfig
from eldir.training.loop import descend, initial_controllers, train, train_in_kernel
from tests.eldir.engine.random_robots import SMALL, robots
from tests.raised import raises

PAPER = Scene.preset("paper").replace(steps=80)
STEPS = TrainingConfig("steps")


@pytest.mark.parametrize("rule", [FixedLength(0.3, 4), Adam(0.3, 4)])
def test_along_a_slope_that_stays_every_update_has_the_given_length(rule):
    """Adam's moving averages begin at zero; their corrections make up for it from the first update on. Every
    weight then moves as far as any other."""
    slope = np.array([3.0, -3.0, 3.0, 3.0])
    for _ in range(8):
        assert rule.update(slope) == pytest.approx(0.15 * np.sign(slope), rel=1e-6)


@pytest.mark.parametrize(
    ("precision", "within", "updates"),
    [
        ("f64", 1e-9, 5),
        ("f32", 1e-4, 4),
    ],  # rounding, which the rollouts amplify: 1e-8, 4e-3 after five updates
)
@pytest.mark.parametrize("contact", ["no-slip", "friction"])
def test_the_fast_path_is_the_loop(precision, within, updates, contact):
    scene = PAPER.replace(precision=precision, contact=contact)
    bodies, brains = robots(SMALL, 4, 5, scene)
    owns = [Physics.of(b, scene).replace(stiffness=2.5e4) for b in bodies]
    fast = train_in_kernel(bodies, brains, owns, scene, STEPS, updates)
    loop = descend(bodies, brains, scene, STEPS, updates, lambda r, k: [owns[r]])
    assert np.abs(fast.losses - loop.losses).max() < within
    assert np.ptp(fast.losses, axis=1).min() > 50 * within, "the robots learned something"
    assert fast.status.tolist() == loop.status.tolist() == [-1] * 4
    for a, b in zip(fast.controllers, loop.controllers, strict=True):
        assert np.abs(a.flat - b.flat).max() < 10 * within
    chosen = train(bodies, brains, owns, scene, STEPS, updates)
    assert chosen.losses.tobytes() == fast.losses.tobytes()


@pytest.mark.parametrize("optimiser", ["steps", "adam"])
def test_a_robot_that_blows_up_keeps_its_first_weights_and_learns_no_more(optimiser):
    bodies, brains = robots(SMALL, 2, 5, PAPER)
    owns = [Physics.of(b, PAPER) for b in bodies]
    owns[1] = owns[1].replace(stiffness=1e9)
    visited = []
    training = TrainingConfig(optimiser)
    found = descend(
        bodies, brains, PAPER.replace(large_step="run"), training, 3,
        lambda r, k: [owns[r]], lambda k, r, controller: visited.append((k, r)),
    )  # fmt: skip
    assert found.status[0] == -1 and found.status[1] >= 0
    assert np.isfinite(found.losses[0]).all() and np.isinf(found.losses[1]).all()
    assert found.controllers[1] == brains[1]
    assert visited == [(0, 0), (0, 1), (1, 0), (2, 0), (3, 0)]


def test_a_mean_over_physics_is_the_loss_and_the_status_is_the_first_failure():
    scene = PAPER.replace(large_step="run", precision="f64")
    bodies, brains = robots(SMALL, 1, 6, scene)
    own = Physics.of(bodies[0], scene)
    drawn = [own, own.replace(stiffness=2e4)]
    found = descend(bodies, brains, scene, STEPS, 1, lambda r, k: drawn)
    alone = [r.loss for r in simulate(bodies * 2, brains * 2, scene, drawn)]
    assert found.losses[0, 0] == pytest.approx(np.mean(alone), abs=1e-12)
    broken = descend(bodies, brains, scene, STEPS, 1, lambda r, k: [own, own.replace(stiffness=1e9)])
    assert broken.status[0] >= 0 and np.isinf(broken.losses).all()
    fragile = [own, own.replace(stiffness=6e4), own.replace(stiffness=1e9)]
    sound, later, sooner = (r.status for r in simulate(bodies * 3, brains * 3, scene, fragile))
    assert sound == -1 and 0 <= sooner < later
    assert descend(bodies, brains, scene, STEPS, 1, lambda r, k: fragile).status[0] == sooner


@pytest.mark.parametrize("optimiser", ["steps", "adam"])
def test_the_paths_of_learning_are_the_rollouts_of_its_losses(optimiser):
    scene, training = PAPER.replace(precision="f64"), TrainingConfig(optimiser)
    bodies, _ = robots(SMALL, 1, 6, scene)
    paths = learning_paths(bodies[0], scene, 3, [5], 20, training)
    losses = learn(bodies, scene, 3, [5], training=training).losses[0]
    assert paths.shape == (4, 5, 2)
    assert losses == pytest.approx(-(paths[:, -1, 0] - paths[:, 0, 0]), abs=1e-9)
    first = simulate(bodies, initial_controllers(bodies, scene, [5]), scene)[0].positions
    assert paths[0] == pytest.approx(first.mean(axis=1)[::20], abs=1e-12)


def test_a_step_too_large_for_all_robots_is_told():
    bodies, _ = robots(SMALL, 2, 5, PAPER)
    with raises(EldirError, "scene.large-step"):
        learn(bodies, PAPER.replace(dt=1.0), 1, training=TrainingConfig("adam"))
