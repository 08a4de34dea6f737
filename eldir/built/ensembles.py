"""A gait on slightly different builds of one design, or on robots as films have shown them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from eldir.built.gait import CYCLES, Gait, heated
from eldir.built.parts import Parts
from eldir.built.robot import BuiltRobot, build
from eldir.built.scene import BuiltScene
from eldir.built.screening import displacements
from eldir.core.records import FloatArray, Record
from eldir.morphology import Morphology
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import Specimen

_ALIKE = 0.1  # body lengths per five cycles: less tells no two walks apart
_HALVINGS = 5


@dataclass(frozen=True, eq=False)
class Ensemble(Record):
    """Displacements of slightly different builds of one design."""

    displacement: FloatArray
    """Body lengths per five cycles, shape (n,); minus infinity where a build fell or folded."""

    @property
    def _standing(self) -> FloatArray:
        return self.displacement[np.isfinite(self.displacement)]

    @property
    def mean(self) -> float:
        """Of the builds that stand; minus infinity where none does."""
        return float(self._standing.mean()) if len(self._standing) else -np.inf

    @property
    def spread(self) -> float:
        """Standard deviation of the builds that stand."""
        return float(self._standing.std(ddof=1)) if len(self._standing) > 1 else 0.0

    @property
    def fallen(self) -> float:
        """Share of the builds that fell or folded."""
        return 1.0 - len(self._standing) / len(self.displacement)

    @property
    def expected(self) -> float:
        """The mean, builds that fell counted as going nowhere."""
        return self.mean * (1.0 - self.fallen) if len(self._standing) else -np.inf

    @property
    def doubt(self) -> float:
        """Standard deviation, builds that fell counted as going nowhere."""
        walks = np.where(np.isfinite(self.displacement), self.displacement, 0.0)
        return float(walks.std(ddof=1)) if len(walks) > 1 else 0.0

    @property
    def probability_forward(self) -> float:
        """Share of the builds that stand and go forward."""
        return float((self.displacement > 0).mean())


def ensemble(
    morphology: Morphology,
    gait: Gait,
    n: int = 16,
    seed: int = 0,
    parameters: BuiltParameters | None = None,
    springs: SpringParameters | None = None,
    ballast: float | FloatArray = 0.0,
    scene: BuiltScene | None = None,
    parts: Parts | None = None,
    filmed: Sequence[Gait] = (),
) -> Ensemble:
    """The same design and gait built `n` times with seeded differences; `ballast` as in `build`.

    With a `scene`, robots are drawn from what was identified, instead of around the nominal one; with
    `parts`, all of them have those strips, and springs that differ in that way. With gaits that were
    `filmed`, each is moved towards the most probable robot until it does with them what that one does: those
    that fall where the filmed robot walked are not this robot.
    """
    return ensembles(morphology, [gait], n, seed, parameters, springs, ballast, scene, parts, filmed)[0]


def ensembles(
    morphology: Morphology,
    gaits: Sequence[Gait],
    n: int = 16,
    seed: int = 0,
    parameters: BuiltParameters | None = None,
    springs: SpringParameters | None = None,
    ballast: float | FloatArray = 0.0,
    scene: BuiltScene | None = None,
    parts: Parts | None = None,
    filmed: Sequence[Gait] = (),
) -> list[Ensemble]:
    """One `ensemble` for each gait, all of the same robots."""
    if scene is not None:
        return _driven(_drawn(morphology, n, seed, ballast, scene, parts, filmed), gaits)
    p, nominal = parameters or BuiltParameters(), springs or SpringParameters()
    builds: list[_Build] = []
    for i in range(n):
        rng = np.random.default_rng([seed, i])
        robot = build(morphology, p.perturbed(rng), ballast=ballast, rng=rng)
        own = [nominal.perturbed(rng)] * morphology.motors
        builds.append(_Build(robot, own, (nominal.cold_length, nominal.hot_length)))
    return _driven(builds, gaits)


def as_found(
    morphology: Morphology,
    gaits: Sequence[Gait],
    scene: BuiltScene,
    parts: Parts | None,
    ballast: float | FloatArray = 0.0,
) -> FloatArray:
    """Body lengths per five cycles of the most probable robot itself with each gait, shape (gaits,); minus
    infinity where it fell or folded."""
    one = _identified(morphology, scene.specimen, parts, ballast, None)
    return np.array([walks.displacement[0] for walks in _driven([one], gaits)])


class _Build(NamedTuple):
    """One robot that gaits are tried on."""

    robot: BuiltRobot
    springs: list[SpringParameters]
    """Of each motor."""
    free: tuple[float, float]
    """Cold and hot free length, as `drive` takes them."""


def _drawn(
    body: Morphology,
    n: int,
    seed: int,
    ballast: float | FloatArray,
    scene: BuiltScene,
    parts: Parts | None,
    filmed: Sequence[Gait],
) -> list[_Build]:
    """Robots of a scene that do with `filmed` gaits what the most probable one does."""
    builds: dict[int, _Build] = {}
    goal = as_found(body, filmed, scene, parts, ballast)[:, None] if filmed else np.zeros((0, 1))
    away, unlike = 1.0, list(range(n))
    for _ in range(1 + _HALVINGS):
        for i in unlike:
            rng = np.random.default_rng([seed, i])
            builds[i] = _identified(body, scene.draw(rng, away), parts, ballast, rng)
        if not (filmed and unlike):
            break
        tried = _driven([builds[i] for i in unlike], filmed)
        walks = np.array([walks.displacement for walks in tried])
        # Two falls are alike; a fall and a walk are far apart.
        alike = np.isclose(walks, goal, rtol=0, atol=_ALIKE)
        unlike = [i for i, same in zip(unlike, alike.all(axis=0), strict=True) if not same]
        away /= 2
    return [builds[i] for i in range(n)]


def _identified(
    body: Morphology,
    whole: Specimen,
    parts: Parts | None,
    ballast: float | FloatArray,
    rng: np.random.Generator | None,
) -> _Build:
    built, springs = whole
    free = (springs.cold_length, springs.hot_length)
    if parts is None:
        return _Build(build(body, built, ballast=ballast, rng=rng), [springs] * body.motors, free)
    return _Build(parts.robot(body, whole, ballast), parts.springs(whole, body.motors), free)


def _driven(builds: Sequence[_Build], gaits: Sequence[Gait]) -> list[Ensemble]:
    robots, free = ([b.robot for b in builds] * len(gaits), [b.free for b in builds] * len(gaits))
    tables = heated([(gait, b.springs) for gait in gaits for b in builds], CYCLES)
    walks = displacements(robots, tables, CYCLES, free)
    return [Ensemble(walks[i : i + len(builds)]) for i in range(0, len(walks), len(builds))]
