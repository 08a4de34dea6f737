"""Distributions of printed robots of one design, samples from them, and the walks of the samples.

Printed robots of one design differ. `NominalRobots` samples from the tolerances of data sheets and printing,
before any film. `IdentifiedRobots` samples from the uncertainty of an identification.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from eldir.built.gait import CYCLES, FreeLengths, Gait, free_lengths_batch
from eldir.built.robot import PrintedRobot, build
from eldir.built.scene import PrintedScene
from eldir.built.walking import displacements, displacements_and_ties
from eldir.core.records import FloatArray, Record
from eldir.design import Design
from eldir.morphology import Morphology
from eldir.parameters.printed import STRIP_SPREAD
from eldir.parameters.robot import RobotParameters, sample_feet, sample_springs
from eldir.parameters.tolerances import RigTolerances
from eldir.terrain import Terrain

_EQUAL = 0.1  # body lengths per five cycles: walks that differ by less count as equal
_HALVINGS = 5
_LEAST_SHARE = 0.5**_HALVINGS
SAMPLES = 16
"""Number of sampled robots of a prediction."""
RISK = 0.5
"""Standard deviations by which the fitness of a walk is below its mean. It covers the error of the mean of
four and more samples, and asks for robots that walk whatever their feet are like (decision 38)."""


@dataclass(frozen=True, eq=False)
class RobotDistribution(Record, ABC):
    """Distribution of the robots of one design."""

    morphology: Morphology
    robot: RobotParameters
    """The most probable robot."""
    ballast: float | FloatArray = 0.0
    """Ballast on this plane [kg], as `eldir.built.robot.build` takes it."""
    terrain: Terrain | None = None
    """The ground [m, of the printed robot]; by default a table."""
    power_shares: tuple[float, ...] = field(default=(), kw_only=True)
    """Power of a spring while n springs heat, relative to its power alone, as
    `eldir.built.gait.free_lengths_batch` takes it; empty: each spring has an output of its own."""

    @abstractmethod
    def sample(self, rng: np.random.Generator) -> RobotParameters:
        """Sample one robot."""

    def free_lengths_of(self, sample: RobotParameters) -> tuple[float, float]:
        """Cold and hot free length [m] between which the stiffness of a sample's springs changes."""
        return sample.free_lengths

    def samples(self, n: int, seed: int) -> list[RobotParameters]:
        """`n` robots; the same seed gives the same ones, and the first of them for a smaller `n`."""
        return [self.sample(rng) for rng in _generators(n, seed)]


@dataclass(frozen=True, eq=False)
class NominalRobots(RobotDistribution):
    """Robots within the tolerances of printing and data sheets (`perturb`), for a design without films."""

    tolerances: RigTolerances = field(default_factory=RigTolerances)
    """Tolerances of what all springs have in common."""

    def sample(self, rng: np.random.Generator) -> RobotParameters:
        """Sample one robot on one rig: each foot has its own friction, and each motor its own two springs,
        which have the errors of this rig in common."""
        printed = self.robot.printed.perturb(rng)
        strips = _sample_strips(self.morphology, printed.geometry, rng)
        # From a generator of its own: the robot is the same whatever the tolerances of its rig.
        springs = self.tolerances.perturb(self.robot.springs, rng.spawn(1)[0])
        own = sample_springs(self.morphology.motors, springs, self.tolerances, rng)
        feet = sample_feet(len(self.morphology.positions), rng)
        printed = replace(printed, geometry=0.0)
        return RobotParameters(printed, springs, strips, feet=feet, own_springs=own)

    def free_lengths_of(self, sample: RobotParameters) -> tuple[float, float]:
        """Free lengths of the nominal springs [m]: a millimetre of length does not change the stiffness."""
        return self.robot.free_lengths


@dataclass(frozen=True, eq=False)
class IdentifiedRobots(RobotDistribution):
    """Robots around one that was identified from films.

    With `filmed` gaits, each sample is moved towards the most probable robot until it stays upright in them
    as that one does: a sample that falls where the filmed robot walked is not this robot.
    """

    parameters: tuple[str, ...] = ()
    """Uncertain parameters, P of them."""
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Covariance of their normalised values z, shape (P, P)."""
    filmed: tuple[Gait, ...] = ()

    def __post_init__(self) -> None:
        self._set_array("covariance", np.float64, (len(self.parameters), len(self.parameters)))

    @classmethod
    def of(cls, design: Design, scene: PrintedScene, filmed: Sequence[Gait] = ()) -> IdentifiedRobots:
        """Robots of a design: one plane with half of the ballast. Single strips and springs keep their
        identified values if the films show this body."""
        return cls(
            design.morphology,
            scene.robot_of(design),
            design.ballast / 2,
            design.printed_terrain,
            scene.parameters,
            scene.covariance,
            tuple(filmed),
        )

    def sample(self, rng: np.random.Generator) -> RobotParameters:
        """Sample one robot; what was not identified comes from its prior, such as each foot's friction."""
        return self._sampled([rng])[0]

    def samples(self, n: int, seed: int) -> list[RobotParameters]:
        """Sample `n` robots; all are simulated side by side with the filmed gaits."""
        return self._sampled(_generators(n, seed))

    def _sampled(self, generators: Sequence[np.random.Generator]) -> list[RobotParameters]:
        """One robot from each generator."""
        steps = [self._sample_deviation(rng) for rng in generators]
        robots = [self._robot_at(*step) for step in steps]
        if not self.filmed:
            return robots
        goal = simulate_most_probable(self, self.filmed)[:, None]
        share, different = 1.0, list(range(len(robots)))
        for _ in range(_HALVINGS):
            walks = simulate_robots(self, [robots[i] for i in different], self.filmed)
            # Two falls are equal; a fall and a walk are far apart.
            equal = np.isclose(walks, goal, rtol=0, atol=_EQUAL).T
            different = [i for i, same in zip(different, equal, strict=True) if not same.all()]
            if not different:
                break
            share /= 2
            for i in different:
                robots[i] = self._robot_at(*steps[i], share)
        return robots

    def _sample_deviation(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Difference of a sample from the most probable robot: z, shape (P,); lengths of strips over their
        standard deviation, shape (S,), empty if they are known; logarithms of the feet's friction, shape
        (M,)."""
        values, vectors = np.linalg.eigh(self.covariance)
        z = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.standard_normal(len(values)))
        known = self.robot.has_individual_parts
        strips = np.zeros(0) if known else _sample_strips(self.morphology, 1.0, rng)
        return z, strips, np.log(sample_feet(len(self.morphology.positions), rng))

    def _robot_at(
        self, z: FloatArray, strips: FloatArray, feet: FloatArray, share: float = 1.0
    ) -> RobotParameters:
        """The robot at this share of the way from the most probable robot to a sample; nearer where springs
        would not get longer when heated, as wide covariances allow."""
        while True:
            robot = replace(self.robot.at(self.parameters, share * z), feet=np.exp(share * feet))
            if share < _LEAST_SHARE or robot.has_stroke(self.morphology.motors):
                break
            share /= 2
        return replace(robot, strips=share * STRIP_SPREAD * strips) if len(strips) else robot


CONFIDENCE_LEVEL = 0.95
"""Share of robots that walk within the interval of a prediction."""


def interval_reach(deviation: float, samples: int, level: float = CONFIDENCE_LEVEL) -> float:
    """Half width of the interval for one more robot, from the standard deviation of `samples` of them, in its
    unit: t s sqrt(1 + 1/n), with Student's t for n - 1 degrees of freedom; NaN for less than two samples."""
    from scipy.special import stdtrit  # a tenth of a second

    if samples < 2:
        return float("nan")
    return float(stdtrit(samples - 1, (1 + level) / 2) * deviation * np.sqrt(1 + 1 / samples))


@dataclass(frozen=True, eq=False)
class SampledWalks(Record):
    """Displacements of the samples of a robot with one gait."""

    displacement: FloatArray
    """Displacement [body lengths per five cycles], shape (n,); minus infinity where a sample fell or
    folded."""
    ties: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Share of ties in each sample's sliding (`tie_share`), shape (n,), NaN where it fell or
    folded; empty if it was not computed."""

    @property
    def _standing(self) -> FloatArray:
        return self.displacement[np.isfinite(self.displacement)]

    @property
    def mean(self) -> float:
        """Mean of the samples that stay upright; minus infinity if none does."""
        return float(self._standing.mean()) if len(self._standing) else -np.inf

    @property
    def spread(self) -> float:
        """Standard deviation of the samples that stay upright."""
        return float(self._standing.std(ddof=1)) if len(self._standing) > 1 else 0.0

    @property
    def fallen(self) -> float:
        """Share of the samples that fell or folded."""
        return 1.0 - len(self._standing) / len(self.displacement)

    @property
    def expected(self) -> float:
        """Mean of all samples, a fall counted as no motion."""
        return self.mean * (1.0 - self.fallen) if len(self._standing) else -np.inf

    @property
    def error(self) -> float:
        """Standard error of `expected`."""
        return self.spread_with_falls / float(np.sqrt(len(self.displacement)))

    @property
    def fitness(self) -> float:
        """Lower confidence bound by which robots are ranked: the expected walk less half the standard
        deviation, falls included; minus infinity if all fall."""
        return self.expected - RISK * self.spread_with_falls

    @property
    def with_falls(self) -> FloatArray:
        """Displacement, a fall counted as no motion, shape (n,)."""
        return np.where(np.isfinite(self.displacement), self.displacement, 0.0)

    @property
    def spread_with_falls(self) -> float:
        """Standard deviation of all samples, a fall counted as no motion."""
        return float(self.with_falls.std(ddof=1)) if len(self.displacement) > 1 else 0.0

    @property
    def tie_share(self) -> float:
        """Mean share of ties of the samples that stay upright; NaN if it is not known."""
        known = self.ties[np.isfinite(self.ties)]
        return float(known.mean()) if len(known) else np.nan

    @property
    def probability_forward(self) -> float:
        """Share of the samples that stay upright and go forward."""
        return float((self.displacement > 0).mean())


def sample_walks(
    robots: RobotDistribution,
    gaits: Sequence[Gait],
    n: int = SAMPLES,
    seed: int = 0,
    *,
    cycles: int | None = None,
    coarse: bool = False,
) -> list[SampledWalks]:
    """Walks of `n` samples with each gait; all gaits have the same samples.

    `cycles` count after the first one, five by default. `coarse` is for choices among many
    (`PrintedRobot.coarse`).
    """
    built, tables, count, free = _simulation_arguments(
        robots, robots.samples(n, seed), gaits, cycles or CYCLES, coarse
    )
    walks, ties = displacements_and_ties(built, tables, count, free, robots.terrain)
    shape = len(gaits), n
    return [SampledWalks(*of) for of in zip(walks.reshape(shape), ties.reshape(shape), strict=True)]


def simulate_most_probable(
    robots: RobotDistribution, gaits: Sequence[Gait], *, cycles: int | None = None, coarse: bool = False
) -> FloatArray:
    """Displacement of the most probable robot with each gait [body lengths per five cycles], shape (gaits,);
    minus infinity where it fell or folded. `cycles` and `coarse` as in `sample_walks`."""
    arguments = _simulation_arguments(robots, [robots.robot], gaits, cycles or CYCLES, coarse)
    return displacements(*arguments, terrain=robots.terrain)


def simulate_robots(
    common: RobotDistribution,
    robots: Sequence[RobotParameters],
    gaits: Sequence[Gait],
    *,
    coarse: bool = False,
) -> FloatArray:
    """Displacements of these robots of a distribution [body lengths per five cycles], shape (gaits, robots);
    minus infinity where one fell or folded. `coarse` as in `sample_walks`."""
    arguments = _simulation_arguments(common, robots, gaits, CYCLES, coarse)
    walks = displacements(*arguments, terrain=common.terrain)
    return walks.reshape(len(gaits), len(robots))


def _simulation_arguments(
    common: RobotDistribution,
    robots: Sequence[RobotParameters],
    gaits: Sequence[Gait],
    cycles: int,
    coarse: bool = False,
) -> tuple[list[PrintedRobot], list[FreeLengths], int, list[tuple[float, float]]]:
    """The arguments of `displacements` for all robots with the first gait, then with the next one."""
    body = common.morphology
    built = [build(body, robot, ballast=common.ballast) for robot in robots]
    if coarse:
        built = [robot.coarse() for robot in built]
    springs = [robot.motor_springs(body.motors) for robot in robots]
    heated = [(gait, own) for gait in gaits for own in springs]
    hubs = [body.motor_hubs] * len(heated)
    tables = free_lengths_batch(heated, cycles, hubs=hubs, power_shares=common.power_shares)
    free = [common.free_lengths_of(robot) for robot in robots]
    return built * len(gaits), tables, cycles, free * len(gaits)


def _sample_strips(morphology: Morphology, spread: float, rng: np.random.Generator) -> FloatArray:
    """Random lengths of strips beyond the drawing, 0 for active springs, shape (S,)."""
    return np.where(morphology.active, 0.0, spread * rng.standard_normal(len(morphology.active)))


def _generators(n: int, seed: int) -> list[np.random.Generator]:
    return [np.random.default_rng([seed, i]) for i in range(n)]
