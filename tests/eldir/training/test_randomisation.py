"""Learning over drawn physics: a mean over the robots drawn, the same in any company, from a scene file."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldir.built.samples import IdentifiedRobots
from eldir.built.scene import PrintedScene
from eldir.defaults import Optimiser
from eldir.errors import InputError
from eldir.evolution.loop import run_generations
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.paper.run_folder import RunFolder
from eldir.evolution.search import Search
from eldir.evolution.workers import LocalWorkers
from eldir.lattice import Lattice
from eldir.learning import initial_controllers, learn
from eldir.parameters.robot import RobotParameters
from eldir.parameters.uncertain import PARAMETERS
from eldir.physics import Physics
from eldir.rollout import simulate
from eldir.scene import Scene
from eldir.training.configuration import TrainingConfig
from eldir.training.randomisation import RANDOMISED, Randomisation
from tests.eldir.engine.random_robots import SMALL, robots
from tests.raised import raises

SCENE = Scene.preset("paper").replace(contact="friction", steps=60)
NOMINAL = RobotParameters()
SURE = Randomisation(np.zeros(4), np.zeros((4, 4)), 0.0, samples=2)
"""Every robot drawn is the scene's, but for the coefficient of friction, which is 1: the paper's."""


@pytest.mark.parametrize("optimiser", ["steps", "adam"])
def test_randomisation_without_spread_is_plain_learning(optimiser: Optimiser) -> None:
    training, scene = TrainingConfig(optimiser), SCENE.replace(precision="f64")
    bodies, _ = robots(SMALL, 3, 5, scene)
    for seeds in ([7, 8, 9], 4):
        plain = learn(bodies, scene, 3, seeds, training=training)
        found = learn(bodies, scene, 3, seeds, training=training, randomisation=SURE)
        assert found.status.tolist() == plain.status.tolist() == [-1, -1, -1]
        assert np.abs(found.losses - plain.losses).max() < 1e-9
        for a, b in zip(found.controllers, plain.controllers, strict=True):
            assert np.abs(a.flat - b.flat).max() < 1e-8


def test_losses_are_means_over_the_robots_drawn() -> None:
    scene, drawn = SCENE.replace(precision="f64"), Randomisation.unfilmed()
    bodies, _ = robots(SMALL, 2, 4, scene)
    initial = initial_controllers(bodies, scene, [3, 4])
    found = learn(bodies, scene, 1, [3, 4], randomisation=drawn)
    for body, brain, seed, losses in zip(bodies, initial, [3, 4], found.losses, strict=True):
        owns = drawn.sample_update(body, scene, seed, 0)
        alone = simulate([body] * len(owns), [brain] * len(owns), scene, owns)
        assert losses[0] == pytest.approx(np.mean([r.loss for r in alone]), abs=1e-12)
        assert np.std([r.loss for r in alone]) > 1e-5, "robots that are drawn differ"


def test_the_same_bytes_in_any_company_and_on_any_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    bodies, _ = robots(SMALL, 4, 6, SCENE)
    found = []
    for threads, chosen in ((1, [0, 1, 2, 3]), (3, [2, 0])):
        monkeypatch.setenv("ELDIR_THREADS", str(threads))
        trained = learn([bodies[i] for i in chosen], SCENE, 2, chosen, randomisation=Randomisation.unfilmed())
        found.append({i: (trained.losses[k].tobytes(), trained.controllers[k]) for k, i in enumerate(chosen)})
    assert found[1] == {i: found[0][i] for i in (2, 0)}
    assert found[0][0][0] != found[0][1][0]


def test_draws_are_as_the_scene_says() -> None:
    """Moments of many draws, against robots drawn from the scene itself."""
    turns = {"friction": 1.0, "tension": -1.0, "cold_stiffness": 0.5, "hot_stiffness": 0.5, "weight": 1.0}
    robot = NOMINAL.at(tuple(turns), list(turns.values()))
    scene = PrintedScene.of(robot, tuple(PARAMETERS), 0.1 * np.eye(len(PARAMETERS)))
    drawn_from = Randomisation.of(scene)
    body = robots(SMALL, 1, 4, SCENE)[0][0]
    drawn = [drawn_from.sample(body, SCENE, np.random.default_rng(i)) for i in range(2000)]
    around = IdentifiedRobots(body, robot, parameters=scene.parameters, covariance=scene.covariance)
    real = [around.sample(np.random.default_rng(i)).printed for i in range(2000)]
    motor, strip = np.flatnonzero(body.active)[0], np.flatnonzero(~body.active)[0]
    mass = np.array([b.hexagon for b in real]) / NOMINAL.printed.hexagon
    pairs = {
        "friction": ([p.friction for p in drawn], [b.friction for b in real]),
        "strips": (
            [p.stiffness[strip] / SCENE.stiffness for p in drawn],
            np.array([b.tension for b in real]) / NOMINAL.printed.tension / mass,
        ),
        "motors": (
            [p.stiffness[motor] / SCENE.stiffness for p in drawn],
            np.sqrt([b.cold_stiffness * b.hot_stiffness / (49.0 * 124.0) for b in real]) / mass,
        ),
        "damping": ([p.damping / SCENE.damping for p in drawn], [b.drag for b in real]),
    }
    assert set(pairs) == set(RANDOMISED)
    for name, (ours, theirs) in pairs.items():
        a, b = np.log(ours), np.log(theirs)
        assert a.mean() == pytest.approx(b.mean(), abs=4 * b.std() / np.sqrt(len(b)) + 1e-6), name
        assert a.std() == pytest.approx(b.std(), rel=0.06), name
    lengths = np.array([p.rest_lengths / body.rest_lengths for p in drawn])
    assert lengths[:, strip].std() == pytest.approx(0.3 / 57, rel=0.06) and (lengths[:, motor] == 1).all()
    gripping = drawn_from.sample(body, SCENE.replace(contact="no-slip"), np.random.default_rng(0))
    assert gripping.friction == 1


def test_a_run_keeps_its_randomisation(tmp_path: Path) -> None:
    config = EvolutionConfig(
        Lattice(3, 6), 3, 1, iterations=2, seed=1, scene=SCENE, randomisation=Randomisation.unfilmed()
    )
    found = []
    for name in ("a", "b"):
        RunFolder.create(tmp_path / name, config)
        run = RunFolder.open(tmp_path / name)
        assert run.config == config
        search = Search(PaperProblem(run.config))
        run_generations(run, search, LocalWorkers())
        found.append([robot.losses.tobytes() for robot in search.archive.ranked()])
    other = RunFolder.create(tmp_path / "c", replace(config, randomisation=None))
    plain = other.restore()
    run_generations(other, plain, LocalWorkers())
    assert found[0] == found[1] != [robot.losses.tobytes() for robot in plain.archive.ranked()]
    values = json.loads((tmp_path / "a" / "run.json").read_text())
    del values["config"]["randomisation"]
    assert EvolutionConfig.from_json(values["config"]).randomisation is None


def test_physics_are_either_given_or_drawn() -> None:
    bodies, _ = robots(SMALL, 2, 4, SCENE)
    owns = [Physics.of(body, SCENE) for body in bodies]
    with raises(InputError, "learning.two-physics"):
        learn(bodies, SCENE, 1, physics=owns, randomisation=SURE)
    brains = initial_controllers(bodies, SCENE, 0)
    with raises(InputError, "input.wrong-number", "seeds"):
        learn(bodies, SCENE, 1, [1], brains, randomisation=SURE)
