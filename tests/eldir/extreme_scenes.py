"""Scenes at the edge of what can be computed: five with a name, and random ones; and what must hold in
each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from eldir.benchmark.stability import extreme_bodies, extreme_grounds
from eldir.controller import Controller
from eldir.engine.validity import NO_GRADIENT, OK, REFUSED, max_speeds
from eldir.learning import learn
from eldir.morphology import Bodies, Morphology
from eldir.physics import Physics
from eldir.rollout import LossesAndGradients, loss_and_gradient, simulate
from eldir.scene import Integrator, Scene
from eldir.terrain import Terrain
from eldir.training.configuration import TrainingConfig
from eldir.training.gradients import motion_gradient
from eldir.training.loop import initial_controllers
from tests.eldir.engine.random_robots import SMALL, robots

PAPER = Scene.preset("paper")
UPDATES = 3


@dataclass
class Extreme:
    """Robots in a scene, and how they are trained."""

    scene: Scene
    bodies: list[Morphology]
    physics: list[Physics]
    controllers: list[Controller]
    training: TrainingConfig

    @classmethod
    def of(
        cls,
        scene: Scene,
        height: float = 0.0,
        speed: tuple[float, float] = (0.0, 0.0),
        seed: int = 0,
        n: int = 4,
    ) -> Extreme:
        """Random robots at a height over the ground [m], with an initial velocity [m/s]."""
        bodies = [
            replace(body, positions=body.positions + np.array([0, height]))
            for body in robots(SMALL, n, seed, scene)[0]
        ]
        owns = [
            Physics.of(body, scene).replace(velocities=np.tile(speed, (len(body.positions), 1)))
            for body in bodies
        ]
        return cls(scene, bodies, owns, initial_controllers(bodies, scene, seed), TrainingConfig.of(scene))

    @property
    def arguments(self) -> tuple[Any, ...]:
        return self.bodies, self.controllers, self.scene, self.physics


RUGGED = PAPER.replace(terrain=Terrain.rugged(np.random.default_rng(1)), damping=0.0, large_step="run")
NASTY = {
    "a drop of 50 m with little damping": lambda: Extreme.of(
        PAPER.replace(damping=0.1, steps=2000), height=50.0
    ),
    "rugged ground without damping": lambda: Extreme.of(RUGGED),
    "springs too stiff for divided steps": lambda: Extreme.of(
        PAPER.replace(stiffness=1e6, steps=300, large_step="subdivide")
    ),
    "thrown at the ground": lambda: Extreme.of(
        PAPER.replace(damping=0.0, contact="friction"), height=0.05, speed=(3.0, -9.0)
    ),
    "20 000 steps of 1 us": lambda: Extreme.of(PAPER.replace(dt=1e-6, steps=20_000), seed=8, n=5),
}
"""Once each of them gave wrong numbers with a good status."""


def random_extreme(seed: int) -> Extreme:
    """Any ground, integrator and precision; stiffness, damping, gravity, steps, motors and weights over
    decades; some robots high above the ground, fast, or with bodies at the edge."""
    rng = np.random.default_rng(seed)

    def decades(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    steps = int(decades(1, 1000))
    scene = PAPER.replace(
        stiffness=decades(1e1, 1e8), damping=rng.choice([0.0, decades(1e-2, 1e3)]), steps=steps,
        gravity=-rng.choice([0.0, decades(0.1, 1e4)]), actuation=rng.choice([0.1, 0.9]),
        omega=decades(1, 1e4),
        dt=decades(1e-6, 1e-2), sensing=rng.choice(["centre", "centre-and-rest", "none"]),
        precision=rng.choice(["f32", "f64"]), integrator=rng.choice(get_args(Integrator)), large_step="run",
    )  # fmt: skip
    grounds = extreme_grounds(scene) | {"none": scene.replace(contact="none")}
    scene = grounds[rng.choice([*grounds])]
    if scene.integrator != "second-order":
        scene = scene.replace(window=rng.choice([None, int(rng.integers(1, steps + 1))]))
    made = Extreme.of(
        scene, rng.choice([0.0, decades(0.01, 100)]), tuple(rng.normal(0, decades(1e-3, 30), 2))
    )
    if rng.random() < 0.5:
        made.bodies = [extreme_bodies()[name] for name in rng.choice([*extreme_bodies()], 3, replace=False)]
        made.physics = [Physics.of(body, scene) for body in made.bodies]
    scale = rng.choice([1.0, decades(1e-3, 1e6)])
    made.controllers = [c.scaled(scale) for c in initial_controllers(made.bodies, scene, seed)]
    made.training = TrainingConfig(rng.choice(["steps", "adam"]), decades(1e-3, 1e3))
    return made


def assert_honest(extreme: Extreme) -> LossesAndGradients:
    """What has a good status is finite and slow enough; what has not is no result."""
    rollouts, found = simulate(*extreme.arguments), loss_and_gradient(*extreme.arguments)
    limits = max_speeds(Bodies(extreme.bodies), extreme.scene, extreme.physics)
    duration = extreme.scene.steps * extreme.scene.dt
    for i, rollout in enumerate(rollouts):
        if rollout.status == OK:
            assert all(
                np.isfinite(a).all() for a in (rollout.positions, rollout.velocities, rollout.activations)
            )
            # Friction may push a mass out of the ground, up to where it would have been.
            assert abs(rollout.loss) <= 1.5 * limits[i] * duration
        else:
            assert rollout.loss == np.inf and (rollout.status >= 0 or rollout.status == REFUSED)
        assert found.status[i] == rollout.status or (found.status[i], rollout.status) == (NO_GRADIENT, OK)
    _assert_flagged(found[0], [c.flat for c in found[1]], found.status)
    if extreme.scene.window is None:
        both = motion_gradient(*extreme.arguments)
        _assert_flagged(both.losses, [c.flat for c in both.controllers], both.status)
        parts = [
            np.concatenate([np.ravel(getattr(p, k)) for k in ("stiffness", "rest_lengths", "velocities")])
            for p in both.physics
        ]
        _assert_flagged(both.losses, parts, both.status)
    return found


def _assert_flagged(losses: np.ndarray, gradients: list[np.ndarray], status: np.ndarray) -> None:
    for loss, gradient, state in zip(losses, gradients, status, strict=True):
        assert np.isfinite(gradient).all()
        assert np.isfinite(loss) if state == OK else loss == np.inf and not gradient.any()


def assert_learns_honestly(extreme: Extreme) -> None:
    """The best controller is that of the least loss without a flag, and walks as far again."""
    learned = learn(
        extreme.bodies, extreme.scene, UPDATES, controllers=extreme.controllers, physics=extreme.physics,
        training=extreme.training,
    )  # fmt: skip
    again = simulate(extreme.bodies, learned.controllers, extreme.scene, extreme.physics)
    for i, losses in enumerate(learned.losses):
        sound = int(np.isfinite(losses).sum())
        assert np.isfinite(losses[:sound]).all() and (losses[sound:] == np.inf).all()
        assert (learned.status[i] == OK) == (sound == UPDATES + 1)
        assert not learned.chaotic[i, -1] and not learned.rounded[i, -1]  # no gradient follows
        assert np.isfinite(learned.controllers[i].flat).all()
        if sound:
            assert again[i].status == OK
            assert abs(again[i].loss - losses.min()) <= 1e-6 * (1 + abs(again[i].loss))
        else:
            assert learned.controllers[i] == extreme.controllers[i]
