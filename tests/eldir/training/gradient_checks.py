"""Gradients with respect to physics and controller, against differences along directions."""

from dataclasses import fields, replace

import numpy as np

from eldir.controller import Controller
from eldir.engine.pack import MotionCotangents
from eldir.lattice import Lattice
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient, simulate, simulate_one
from eldir.scene import Scene
from eldir.training.gradients import Motion, loss_gradient, motion_gradient
from tests.eldir.engine.random_robots import WEIGHTS, like, moved, robots
from tests.eldir.engine.twin import complex_slopes
from tests.eldir.random_physics import PAPER, RUGGED, drawn

FEW = Lattice(4, 7)
NAMES = tuple(f.name for f in fields(Physics))
KINDS = {
    "without slip": {
        "flat": PAPER,
        "open loop": PAPER.replace(sensing="none"),
        "free flight": PAPER.replace(contact="none"),
        "matched": PAPER.replace(integrator="matched"),
        "passive": PAPER,
        "passive free flight": PAPER.replace(contact="none"),
    },
    "with friction": {
        "flat": PAPER.replace(contact="friction"),
        "rugged": RUGGED,
        "released": Scene.preset("released-main").replace(precision="f64"),
        "open loop": RUGGED.replace(sensing="none"),
        "matched": RUGGED.replace(integrator="matched"),
        "passive": RUGGED,
    },
    "of second order": {
        "flat": PAPER.replace(contact="friction", integrator="second-order"),
        "rugged": RUGGED.replace(integrator="second-order"),
        "passive": RUGGED.replace(integrator="second-order"),
    },
}


def robot(name: str, scene: Scene, lattice: Lattice = FEW) -> tuple[Morphology, Controller, Physics]:
    """One that leaves the ground and meets it again; a passive one has lost its motors."""
    (body,), (brain,) = robots(lattice, 1, 6, scene)
    if name.startswith("passive"):
        body = replace(body, active=np.zeros(len(body.springs), bool))
        brain = Controller(brain.w1, brain.b1, np.zeros((0, 32)), np.zeros(0))
    return body, brain, drawn(body, scene, 1)


def directions(own: Physics, brain: Controller, seed: int) -> dict[str, tuple[Physics, Controller]]:
    """One in every parameter alone, each about as large as it is, and one in the weights."""
    rng, none, found = np.random.default_rng(seed), own.scaled(0.0), {}
    for name in NAMES:
        value = getattr(own, name)
        size = (
            np.abs(value).mean()
            * rng.uniform(0.5, 1.5, np.shape(value))
            * rng.choice([-1, 1], np.shape(value))
        )
        if name == "friction" and own.friction == 1:  # a scene without
            size = 0.0
        found[name] = none.replace(**{name: size}), brain.scaled(0.0)
    found["weights"] = none, like(brain, rng)
    return found


def product(a: Physics | Controller, b: Physics | Controller) -> float:
    return sum(float(np.sum(getattr(a, f.name) * getattr(b, f.name))) for f in fields(a))


def sum_of(own: Physics, parts: list[Physics]) -> Physics:
    return Physics(*(sum(getattr(p, name) for p in parts) for name in NAMES))


def along(own: Physics, by: Physics, h: float) -> Physics:
    return Physics(*(getattr(own, name) + h * getattr(by, name) for name in NAMES))


def differences(
    robot: tuple[Morphology, Controller, Physics], scene: Scene, by: tuple[Physics, Controller], h: float,
    cotangent: np.ndarray,
) -> tuple[float, float] | None:  # fmt: skip
    """Of the loss and of the pulled positions, to the fourth order; None where contacts differ."""
    body, brain, own = robot
    sides = [(along(own, by[0], e * h), moved(brain, by[1], e * h)) for e in (-2, -1, 1, 2)]
    ends = simulate([body] * 4, [s[1] for s in sides], scene, [s[0] for s in sides])
    x = np.array([r.positions for r in ends])
    if scene.contact != "none":
        touching = np.abs(x[..., 1] - scene.terrain.height(x[..., 0])) < 1e-9
        if (touching != touching[0]).any():
            return None
    weights = np.array([1, -8, 8, -1]) / (12 * h)
    return float(weights @ [r.loss for r in ends]), float(weights @ (x * cotangent).sum(axis=(1, 2, 3)))


def assert_gradients(robot: tuple[Morphology, Controller, Physics], scene: Scene) -> None:
    """To 1e-7 against differences away from contact events: there, one of some step lengths neither meets
    another contact nor drowns in rounding. To 1e-10 against the twin."""
    body, brain, own = robot
    rng, states = np.random.default_rng(2), (scene.steps + 1, *body.positions.shape)
    cotangent = rng.standard_normal(states)
    complete = MotionCotangents(
        cotangent, rng.standard_normal(states), rng.standard_normal((scene.steps, body.motors))
    )
    of_loss, of_cotangent, of_all = (
        motion_gradient([body], [brain], scene, [own], p) for p in (None, [cotangent], [complete])
    )
    assert of_loss.losses[0] == of_cotangent.losses[0]
    motions: dict[str, np.ndarray] = {}

    def pulled(i: int, motion: Motion) -> tuple[float, MotionCotangents]:
        motions.update({name: motion.read(name) for name in MotionCotangents._fields})
        return 1.0, complete

    kept = loss_gradient([body], [brain], scene, [own], pulled)  # without a second simulation
    assert (kept.losses[0], kept.controllers, kept.physics) == (1.0, of_all.controllers, of_all.physics)
    rollout = simulate_one(body, brain, scene, own)
    assert all(np.allclose(m, getattr(rollout, name), rtol=0, atol=1e-11) for name, m in motions.items())
    if scene.contact != "none":  # that is another kernel, tests/eldir/engine/test_shortcuts.py
        plain = loss_and_gradient([body], [brain], scene, [own])[1][0]
        assert all(np.array_equal(getattr(plain, k), getattr(of_loss.controllers[0], k)) for k in WEIGHTS)
    ways, sums = directions(own, brain, 3), []
    for key, way in ways.items():
        predicted = [
            product(g.physics[0], way[0]) + product(g.controllers[0], way[1])
            for g in (of_loss, of_cotangent, of_all)
        ]
        sums.append(predicted)
        found = [differences(robot, scene, way, h, cotangent) for h in (1e-3, 1e-4, 1e-5, 1e-6)]
        off = np.array([np.abs(np.subtract(f, predicted[:2])) for f in found if f is not None])
        # What rounding leaves of a loss that hardly depends on it, and of a sum of many positions.
        floor = np.array([1e-11, 1e-9])
        assert len(off), key
        assert (off.min(axis=0) <= 1e-7 * np.abs(predicted[:2]) + floor).all(), (key, off, predicted)
    assert scene.contact in ("no-slip", "none") or product(of_cotangent.physics[0], ways["friction"][0]) != 0
    whole = sum_of(own, [w[0] for w in ways.values()]), ways["weights"][1]
    slopes = complex_slopes(body, brain, scene, own, *whole, MotionCotangents(cotangent), complete)
    for k, exact in enumerate(slopes):
        assert abs(sum(s[k] for s in sums) - exact) <= 1e-10 * sum(abs(s[k]) for s in sums)
