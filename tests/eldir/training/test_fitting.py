"""Gradients with respect to physics against differences and the twin's complex steps; and a fit by them."""

import textwrap

import numpy as np
import pytest

from eldir.engine.stable_step import substeps
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.physics import Physics
from eldir.rollout import simulate
from eldir.training import fitting
from eldir.training.fitting import fit_physics
from eldir.training.gradients import motion_gradient
from tests.eldir.engine.random_robots import robots
from tests.eldir.random_physics import PAPER, RUGGED
from tests.eldir.training.gradient_checks import (
    KINDS,
    assert_gradients,
    differences,
    directions,
    product,
    robot,
)
from tests.raised import raises

pytestmark = pytest.mark.slow


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


@pytest.mark.parametrize("points", [4, 6, 20])
def test_standard_errors_are_those_of_a_straight_line(points: int) -> None:
    """Few points: two of them went into the line. NumPy's own fit is the oracle."""
    rng = np.random.default_rng(points)
    x = rng.random(points)
    y = 2 * x + 1 + rng.normal(0, 0.1, points)
    line, covariance = np.polyfit(x, y, 1, cov=True)
    residual = np.mean((y - np.polyval(line, x)) ** 2)
    found = fitting._standard_errors(np.array([x, np.ones(points)]), residual)
    assert found == pytest.approx(np.sqrt(np.diag(covariance)))


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
    with raises(InputError, "input.unknown-name", "parameter to fit", match="found 'mass'"):
        fit_physics(body, brain, scene, film, ("mass",))
    with raises(InputError, "input.unknown-name", "parameter to fit", match="found 'none'"):
        fit_physics(body, brain, scene, film, ())
    with raises(InputError, "input.wrong-value", "Scene.contact"):
        fit_physics(body, brain, scene, film, ("friction",))
    with raises(InputError, "input.wrong-shape", "observed"):
        fit_physics(body, brain, scene, film[:2], ("stiffness",))
    with raises(InputError, "input.wrong-shape", "cotangents of robot 0"):
        motion_gradient([body], [brain], scene, [own], [film[:2]])
    with raises(InputError, "input.wrong-value", "Scene.window"):
        motion_gradient([body], [brain], scene.replace(window=1), [own])


def test_the_example_of_the_documentation_runs() -> None:
    code = textwrap.dedent(str(fitting.__doc__).split("its motion.\n\n", 1)[1])
    names: dict[str, object] = {}
    exec(code.replace("print(", "("), names)
    assert names["found"].factors == pytest.approx([0.8, 0.8], rel=1e-3)
