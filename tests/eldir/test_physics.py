"""Physical parameters of each robot's own: against the twin, and against scenes that have them for all."""

import numpy as np
import pytest

from eldir.controller import Controller
from eldir.defaults import Optimiser
from eldir.engine.validity import REFUSED
from eldir.errors import EldirError, InputError
from eldir.learning import learn
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from tests.eldir.engine.random_robots import SMALL, WEIGHTS, robots
from tests.eldir.engine.twin import paper_rollout
from tests.eldir.random_physics import PAPER, RUGGED, drawn
from tests.raised import raises

SCENES = {
    "flat": PAPER,
    "friction": PAPER.replace(contact="friction"),
    "rugged": RUGGED,
    "released": Scene.preset("released-main").replace(precision="f64"),
    "free flight": PAPER.replace(contact="none"),
    "open loop": PAPER.replace(sensing="none"),
    "matched": RUGGED.replace(integrator="matched"),
    "second order": RUGGED.replace(integrator="second-order"),
    "second order, flat": PAPER.replace(integrator="second-order"),
}


@pytest.mark.parametrize("name", SCENES)
def test_robots_of_their_own_physics_move_as_the_twin(name: str) -> None:
    scene = SCENES[name].replace(steps=50)
    bodies, brains = robots(SMALL, 2, 3, scene)
    owns = [drawn(body, scene, seed) for seed, body in enumerate(bodies)]
    for rollout, *robot, own in zip(simulate(bodies, brains, scene, owns), bodies, brains, owns, strict=True):
        x, v, a = paper_rollout(*robot, scene, own)
        assert np.abs(rollout.positions - x).max() < 1e-10
        assert np.abs(rollout.velocities - v).max() < 1e-8
        assert np.abs(rollout.activations - a).max() < 1e-9
        assert abs(rollout.loss + (x[-1] - x[0])[:, 0].mean()) < 1e-12


@pytest.mark.parametrize("optimiser", ["steps", "adam"])
@pytest.mark.parametrize("integrator", ["paper", "second-order"])
def test_one_physics_for_all_is_a_scene(integrator: str, optimiser: Optimiser) -> None:
    """The same bytes, in company of robots with other physics."""
    scene = PAPER.replace(steps=80, precision="f32", integrator=integrator)
    training = TrainingConfig(optimiser, 0.2)
    other = scene.replace(damping=9.0, gravity=-9.81, stiffness=2e4)
    bodies, brains = robots(SMALL, 3, 5, scene)
    owns = [Physics.of(b, scene).replace(damping=9.0, gravity=-9.81, stiffness=2e4) for b in bodies]
    wanted, found = simulate(bodies, brains, other), simulate(bodies, brains, scene, owns)
    assert all(a == b for a, b in zip(found, wanted, strict=True))
    doubled = [*bodies, *bodies], [*brains, *brains], [Physics.of(b, scene) for b in bodies] + owns
    trained = learn(doubled[0], scene, 2, controllers=doubled[1], physics=doubled[2], training=training)
    for part, theirs in ((slice(3, None), other), (slice(3), scene)):
        alone = learn(bodies, theirs, 2, controllers=brains, training=training)
        assert trained.losses[part].tobytes() == alone.losses.tobytes()
    losses, gradients = loss_and_gradient(doubled[0], doubled[1], scene, doubled[2])
    plain = loss_and_gradient(bodies, brains, other)
    assert losses[3:].tobytes() == plain[0].tobytes() and (losses[:3] != losses[3:]).all()
    for mine, theirs in zip(gradients[3:], plain[1], strict=True):
        assert all(np.array_equal(getattr(mine, k), getattr(theirs, k)) for k in WEIGHTS)


def test_a_robot_with_springs_too_stiff_for_the_step_is_refused() -> None:
    scene = PAPER.replace(steps=40)
    bodies, brains = robots(SMALL, 2, 5, scene)
    stiff = [Physics.of(bodies[0], scene), Physics.of(bodies[1], scene).replace(stiffness=6e4)]
    losses, _ = loss_and_gradient(bodies, brains, scene, stiff)
    assert np.isfinite(losses[0]) and np.isinf(losses[1])
    assert [r.status for r in simulate(bodies, brains, scene, stiff)] == [-1, REFUSED]
    finer = simulate(bodies, brains, scene.replace(large_step="subdivide"), stiff)
    assert all(np.isfinite(r.loss) for r in finer)
    with raises(EldirError, "scene.large-step"):
        simulate(bodies[1:], brains[1:], scene, stiff[1:])


def test_less_friction_slides_further() -> None:
    """Thrown along the ground: with none, nothing but damping slows it."""
    scene = PAPER.replace(contact="friction", steps=50, sensing="none", damping=0.0)
    (body,), _ = robots(SMALL, 1, 3, scene)
    shape = (32, 10 + 4 * len(body.positions))
    still = Controller(np.zeros(shape), np.zeros(32), np.zeros((body.motors, 32)), np.zeros(body.motors))
    thrown = Physics.of(body, scene).replace(velocities=np.tile([0.5, 0.0], (len(body.positions), 1)))
    coefficients = (0.0, 0.1, 0.4, 1.0)
    slid = [simulate([body], [still], scene, [thrown.replace(friction=f)])[0].loss for f in coefficients]
    assert slid[0] == pytest.approx(-0.5 * 50 * scene.dt, rel=1e-6) and (np.diff(slid) > 0).all()


def test_wrong_physics_is_named() -> None:
    scene = PAPER.replace(steps=2)
    bodies, brains = robots(SMALL, 2, 9, scene)
    owns = [Physics.of(b, scene) for b in bodies]
    with raises(InputError, "input.wrong-number", "physics", match="expected 2, one for each robot; found 1"):
        simulate(bodies, brains, scene, owns[:1])
    with raises(InputError, "input.wrong-shape", "Physics.stiffness of robot 0"):
        simulate(bodies, brains, scene, owns[::-1])
    with raises(InputError, "input.wrong-value", "Physics.damping of robot 1"):
        simulate(bodies, brains, scene, [owns[0], owns[1].replace(damping=-1.0)])
    with raises(InputError, "input.wrong-value", "Physics.velocities of robot 1"):
        simulate(bodies, brains, scene, [owns[0], owns[1].replace(velocities=np.nan)])
    with raises(InputError, "input.wrong-value", "Physics.friction of robot 1"):
        loss_and_gradient(bodies, brains, scene, [owns[0], owns[1].replace(friction=0.5)])
    with raises(InputError, "input.unknown-name", "field of physics"):
        owns[0].replace(mass=1.0)
