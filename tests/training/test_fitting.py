"""Gradients with respect to physics against differences and the twin's complex steps; and a fit by them."""

import textwrap
from dataclasses import fields, replace

import numpy as np
import pytest

from eldir.controller import Controller
from eldir.engine.stable_step import substeps
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.morphology import Morphology
from eldir.physics import Physics
from eldir.rollout import loss_and_gradient, simulate
from eldir.scene import Scene
from eldir.training import fitting
from eldir.training.fitting import fit_physics, motion_gradient
from tests.eldir.test_physics import PAPER, RUGGED, drawn
from tests.engine.test_engine import WEIGHTS, like, moved, robots
from tests.engine.twin import complex_slope

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
    cotangent = np.random.default_rng(2).standard_normal((scene.steps + 1, *body.positions.shape))
    of_loss, of_cotangent = (motion_gradient([body], [brain], scene, [own], p) for p in (None, [cotangent]))
    assert of_loss.losses[0] == of_cotangent.losses[0]
    if scene.contact != "none":  # that is another kernel, tests/engine/test_shortcuts.py
        plain = loss_and_gradient([body], [brain], scene, [own])[1][0]
        assert all(np.array_equal(getattr(plain, k), getattr(of_loss.controllers[0], k)) for k in WEIGHTS)
    ways, sums = directions(own, brain, 3), []
    for key, way in ways.items():
        predicted = [
            product(g.physics[0], way[0]) + product(g.controllers[0], way[1]) for g in (of_loss, of_cotangent)
        ]
        sums.append(predicted)
        found = [differences(robot, scene, way, h, cotangent) for h in (1e-3, 1e-4, 1e-5, 1e-6)]
        off = np.array([np.abs(np.subtract(f, predicted)) for f in found if f is not None])
        # What rounding leaves of a loss that hardly depends on it, and of a sum of many positions.
        floor = np.array([1e-11, 1e-9])
        assert len(off), key
        assert (off.min(axis=0) <= 1e-7 * np.abs(predicted) + floor).all(), (key, off, predicted)
    assert scene.contact in ("no-slip", "none") or product(of_cotangent.physics[0], ways["friction"][0]) != 0
    whole = sum_of(own, [w[0] for w in ways.values()]), ways["weights"][1]
    for k, p in enumerate((None, cotangent)):
        exact = complex_slope(body, brain, scene, own, *whole, p)
        assert abs(sum(s[k] for s in sums) - exact) <= 1e-10 * sum(abs(s[k]) for s in sums)


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_of_physics(kind: str) -> None:
    for name, longer in KINDS[kind].items():
        scene = longer.replace(steps=40)
        assert_gradients(robot(name, scene), scene)


def test_steps_may_be_divided_and_robots_may_blow_up() -> None:
    """A step too large for the springs: cotangents act at the scene's steps all the same."""
    scene = RUGGED.replace(dt=0.012, steps=20, large_step="subdivide")
    body, brain, own = robot("rugged", scene)
    assert substeps([body], scene, [own])[0] > 1
    cotangent = np.random.default_rng(2).standard_normal((21, *body.positions.shape))
    found = motion_gradient([body], [brain], scene, [own], [cotangent])
    for key, way in directions(own, brain, 4).items():
        slopes = [differences((body, brain, own), scene, way, h, cotangent) for h in (1e-4, 1e-5, 1e-6)]
        predicted = product(found.physics[0], way[0]) + product(found.controllers[0], way[1])
        assert min(abs(s[1] - predicted) for s in slopes if s) <= 1e-7 * abs(predicted) + 1e-9, key
    burst = motion_gradient([body], [brain], scene.replace(large_step="run"), [own.replace(stiffness=1e8)])
    assert np.isinf(burst.losses[0])
    assert burst.physics[0] == own.scaled(0.0) and burst.controllers[0] == brain.scaled(0.0)


def test_a_robot_s_physics_are_found_in_its_motion() -> None:
    """From a film with half a millimetre of noise, in which every third mass is not seen."""
    scene = PAPER.replace(contact="friction", steps=250)
    (body,), (brain,) = robots(Lattice(6, 11), 1, 3, scene)
    wanted = {"passive stiffness": 0.7, "active stiffness": 0.8, "damping": 1.2, "friction": 0.6}
    own = Physics.of(body, scene)
    stiffness = own.stiffness * np.where(body.active, wanted["active stiffness"], wanted["passive stiffness"])
    true = own.replace(stiffness=stiffness, damping=1.2 * own.damping, friction=0.6)
    film = simulate([body], [brain], scene, [true])[0].positions
    film = film + np.random.default_rng(0).normal(0, 5e-4, film.shape)
    film[:, ::3] = np.nan
    found = fit_physics(body, brain, scene, film, tuple(wanted))
    off = found.factors / list(wanted.values()) - 1
    assert found.distance == pytest.approx(5e-4 * np.sqrt(2), rel=0.03)
    assert (np.abs(off) < 0.02).all() and (np.abs(off) < 4 * found.errors).all(), (off, found.errors)
    assert np.allclose(found.physics.stiffness, stiffness, rtol=0.02)


def test_what_a_motion_does_not_tell_is_known_to_be_unknown() -> None:
    """A passive body has no active springs: what it is said to be stays, and of the rest nothing is lost."""
    scene = RUGGED.replace(steps=40)
    body, brain, own = robot("passive", scene)
    film = simulate([body], [brain], scene, [own])[0].positions
    film = film + np.random.default_rng(0).normal(0, 1e-4, film.shape)
    found = fit_physics(body, brain, scene, film, ("active stiffness", "stiffness"), own)
    assert found.factors[0] == 1 and np.isinf(found.errors[0])
    assert abs(found.factors[1] - 1) < 4 * found.errors[1] < 0.01
    again = fit_physics(
        body, brain, scene, simulate([body], [brain], scene, [own])[0].positions, ("damping",), own
    )
    assert again.factors[0] == 1 and again.distance == 0


def test_what_cannot_be_fitted_is_named() -> None:
    scene = PAPER.replace(steps=2)
    body, brain, own = robot("flat", scene)
    film = np.zeros((3, *body.positions.shape))
    with pytest.raises(InputError, match="cannot be fitted"):
        fit_physics(body, brain, scene, film, ("mass",))
    with pytest.raises(InputError, match="found none"):
        fit_physics(body, brain, scene, film, ())
    with pytest.raises(InputError, match="a scene without friction has no such parameter"):
        fit_physics(body, brain, scene, film, ("friction",))
    with pytest.raises(InputError, match="observed positions are wrong"):
        fit_physics(body, brain, scene, film[:2], ("stiffness",))
    with pytest.raises(InputError, match="cotangents of its positions"):
        motion_gradient([body], [brain], scene, [own], [film[:2]])
    with pytest.raises(InputError, match=r"Scene\.window"):
        motion_gradient([body], [brain], scene.replace(window=1), [own])


def test_the_example_of_the_documentation_runs() -> None:
    code = textwrap.dedent(str(fitting.__doc__).split("its motion.\n\n", 1)[1])
    names: dict[str, object] = {}
    exec(code.replace("print(", "("), names)
    assert names["found"].factors == pytest.approx([0.8, 0.8], rel=1e-3)
