"""Options beyond the paper: Adam, a windowed objective, inherited weights; each against its own oracle."""

import numpy as np
import pytest

from eldir.controller import CPGS, HIDDEN, Controller
from eldir.errors import InputError
from eldir.evolution.variation import inherit
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.learning import learn
from eldir.morphology import Morphology, develop
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from tests.eldir.engine import twin
from tests.raised import raises

SMALL = Lattice(4, 6)
SCENE = Scene.preset("paper").replace(precision="f64", steps=60)
WEIGHTS = ("w1", "b1", "w2", "b2")


def robots(n: int, seed: int) -> tuple[list[Morphology], list[Controller]]:
    rng = np.random.default_rng(seed)
    bodies = [develop(SMALL, g) for g in random_genotypes(SMALL, n, rng)]
    return bodies, [Controller.random(len(b.positions), b.motors, rng) for b in bodies]


def flat(c: Controller) -> np.ndarray:
    return np.concatenate([getattr(c, k).ravel() for k in WEIGHTS])


def moved(c: Controller, by: np.ndarray) -> Controller:
    parts = np.split(by, np.cumsum([getattr(c, k).size for k in WEIGHTS])[:-1])
    return Controller(
        *(getattr(c, k) + p.reshape(getattr(c, k).shape) for k, p in zip(WEIGHTS, parts, strict=True))
    )


def windowed_loss(body: Morphology, brain: Controller, scene: Scene, states: tuple, window: int) -> float:
    """By the twin: every window goes on from the state that the unmoved weights led to."""
    xs, vs, _ = states
    own, rest = Physics.of(body, scene), xs[0] - xs[0].mean(axis=0)
    loss = 0.0
    for start in range(0, scene.steps, window):
        x, v = xs[start], vs[start]
        for t in range(start, min(start + window, scene.steps)):
            x, v, _ = twin.paper_step(body, brain, scene, own, t, x, v, v, rest)
        loss -= x[:, 0].mean() - xs[start][:, 0].mean()
    return loss


@pytest.mark.parametrize("window", [7, 20])
def test_the_windowed_gradient_is_the_slope_of_the_windowed_loss(window):
    scene = SCENE.replace(window=window, gravity=0.0)  # in the air, where nothing is abrupt
    bodies, brains = robots(2, 3)
    rng = np.random.default_rng(0)
    losses, gradients = loss_and_gradient(bodies, brains, scene)
    assert losses == pytest.approx(loss_and_gradient(bodies, brains, SCENE.replace(gravity=0.0))[0])
    for body, brain, slope in zip(bodies, brains, gradients, strict=True):
        states = twin.paper_rollout(body, brain, scene)
        along = rng.standard_normal(len(flat(brain)))
        ends = [windowed_loss(body, moved(brain, e * along), scene, states, window) for e in (1e-6, -1e-6)]
        assert flat(slope) @ along == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5, abs=1e-12)


def test_a_window_as_long_as_the_rollout_changes_nothing():
    bodies, brains = robots(3, 4)
    whole = loss_and_gradient(bodies, brains, SCENE)[1]
    for window in (60, 1000):
        assert loss_and_gradient(bodies, brains, SCENE.replace(window=window))[1] == whole
    assert loss_and_gradient(bodies, brains, SCENE.replace(window=30))[1] != whole
    with raises(InputError, "scene.wrong-value", "window"):
        SCENE.replace(window=0)


def test_adam_follows_its_definition():
    """Kingma and Ba, Algorithm 1, written out with powers instead of running averages."""
    training = TrainingConfig("adam", 0.2)
    bodies, brains = robots(3, 5)
    found = learn(bodies, SCENE, 4, controllers=brains, training=training)
    for r, (body, brain) in enumerate(zip(bodies, brains, strict=True)):
        slopes, losses, trail = [], [], [brain]
        for t in range(1, 6):
            loss, (gradient,) = loss_and_gradient([body], [trail[-1]], SCENE)
            losses.append(loss[0])
            slopes.append(flat(gradient))
            faded = 0.9 ** np.arange(t - 1, -1, -1.0)
            mean = 0.1 * (faded @ np.array(slopes)) / (1 - 0.9**t)
            faded = 0.999 ** np.arange(t - 1, -1, -1.0)
            square = 0.001 * (faded @ np.array(slopes) ** 2) / (1 - 0.999**t)
            rate = training.update_length / np.sqrt(len(mean))
            trail.append(moved(trail[-1], -rate * mean / (np.sqrt(square) + 1e-8)))
        assert found.losses[r] == pytest.approx(losses, abs=1e-9)
        assert flat(found.controllers[r]) == pytest.approx(flat(trail[np.argmin(losses)]), abs=1e-7)


def test_adam_depends_neither_on_company_nor_on_robots_that_blow_up():
    scene, training = SCENE.replace(steps=40), TrainingConfig("adam", 0.2)
    bodies, brains = robots(3, 6)
    brains[1] = brains[1].scaled(1e4)
    together = learn(bodies, scene, 3, controllers=brains, training=training)
    alone = learn(bodies[2:], scene, 3, controllers=brains[2:], training=training)
    assert np.array_equal(together.losses[2], alone.losses[0])
    assert together.controllers[2] == alone.controllers[0]


def test_what_parent_and_child_share_is_inherited():
    rng = np.random.default_rng(7)
    one, other = (develop(SMALL, g) for g in random_genotypes(SMALL, 2, rng))
    trained, fresh = (Controller.random(len(b.positions), b.motors, rng) for b in (one, other))
    # Random controllers have no biases; learning gives them some.
    trained, fresh = (c.shaped(rng.standard_normal(len(c.flat))) for c in (trained, fresh))
    child = inherit(one, trained, other, fresh)
    assert np.array_equal(child.b1, trained.b1)
    assert np.array_equal(child.w1[:, :CPGS], trained.w1[:, :CPGS])
    shared = 0
    for i, vertex in enumerate(other.vertices):
        source, k = (fresh, i)
        if vertex in one.vertices:
            source, k = trained, one.vertices.tolist().index(vertex)
            shared += 1
        kept, found = (c.w1[:, CPGS + 4 * j :][:, :4] for c, j in ((source, k), (child, i)))
        assert np.array_equal(kept, found)
    assert 0 < shared < len(other.vertices)
    theirs = one.lattice_springs[one.active].tolist()
    for i, spring in enumerate(other.lattice_springs[other.active]):
        source, k = (trained, theirs.index(spring)) if spring in theirs else (fresh, i)
        assert np.array_equal(child.w2[i], source.w2[k])
        assert child.b2[i] == source.b2[k]
    assert inherit(one, trained, one, fresh_of(one)) == trained
    assert child.w1.shape == (HIDDEN, CPGS + 4 * len(other.positions))


def fresh_of(body: Morphology) -> Controller:
    return Controller.random(len(body.positions), body.motors, np.random.default_rng(0))
