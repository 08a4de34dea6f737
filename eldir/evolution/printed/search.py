"""The search for printed robots that walk: offspring of the archive, judged in trials of rising honesty.

Each generation: offspring that stand, move and can be printed are made from elites; a short trial with soft
strips finds their phases and leaves half of them out; samples with hubs decide between two gaits; a table
that is tilted either way must not change the walk much; eight fresh samples with hubs say what a robot is
worth. Then the best elites are looked at again, because the best of many estimates is too good (winner's
curse).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from eldir.built.gait import Gait
from eldir.built.robot import build
from eldir.built.statics import height_over_base, shape_fault, static_margin
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.evolution.printed.archive import Archive, Walker, niche_of
from eldir.evolution.printed.configuration import PrintedEvolutionConfig
from eldir.evolution.printed.genome import PrintedGenome, motors_of
from eldir.evolution.printed.placement import mirrored
from eldir.evolution.printed.trials import Trial, counted, decided, looked_at, on_slopes, screened, screening
from eldir.evolution.printed.variation import offspring, random_genomes
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters

Refused = Callable[[Morphology], str]
"""Says why a body cannot be built; empty if it can."""
Evaluation = Callable[[Sequence[Trial], RobotParameters], FloatArray]
"""A kind of trial in `eldir.evolution.printed.trials`: a row for each trial of robots like the nominal."""
Evaluator = Callable[[Evaluation, Sequence[Trial], RobotParameters], FloatArray]
"""Runs such trials somewhere: here, or on a cluster. No row depends on the others."""
Progress = Callable[[float], None]
KNOWN = 32
"""Samples up to which elites are looked at again."""
_ATTEMPTS = 400  # for each offspring that stands
_RANDOM = 6  # times as many random robots as offspring of a generation: they are the ancestors of all others
_DECIDED, _EVALUATED = 0.5, 0.2  # shares of a generation that reach the second and the third trial
_FOUNDERS = 2  # times as many reach them in the first generation, of random robots
_TALLEST = 1.5  # height of a robot over the distance of its outermost feet
_TILTED = 1.5  # times as many robots are tried on slopes as may reach the third trial
_STEADY = 0.7  # least walk on the worse slope, as a part of that on the better one
_PARENTS = 12
_ELSEWHERE = 0.2  # probability that a parent comes from the whole archive
_AGAIN = 3  # elites that are looked at again in a generation
_HARDLY = 0.1  # less than this in the best gait: not a walker [body lengths per five cycles]


def evaluate_here(kind: Evaluation, trials: Sequence[Trial], nominal: RobotParameters) -> FloatArray:
    """The trials, run on this machine."""
    return kind(trials, nominal)


class Candidate(NamedTuple):
    """A robot on its way through the trials of one generation."""

    number: int
    parent: int
    genome: PrintedGenome
    body: Morphology


@dataclass(frozen=True)
class Generation:
    """What happened in one generation."""

    number: int
    tried: tuple[Candidate, ...]
    screened: FloatArray
    """Best walk of each in the first trial [body lengths per five cycles], shape (tried,)."""
    looked_at: tuple[Walker, ...]
    admitted: int


@dataclass
class PrintedSearch:
    """The state of a run after its last complete generation."""

    config: PrintedEvolutionConfig
    refused: Refused = lambda body: ""
    generation: int = 0
    """Number of the generation that comes next."""
    archive: Archive = field(default_factory=Archive)
    evaluate: Evaluator = evaluate_here
    _buildable: dict[bytes, bool] = field(default_factory=dict, init=False, repr=False)
    """What the build filter said of bodies: many robots differ in their gaits alone."""

    @property
    def finished(self) -> bool:
        """Whether the last generation is complete."""
        return self.generation > self.config.generations

    def step(self, progress: Progress = lambda share: None) -> Generation:
        """Run one generation; the same configuration gives the same one, whatever was interrupted before."""
        rng = np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=(self.generation,)))
        tried = self._offspring(rng) if self.archive.elites else self._progenitors(rng)
        progress(0.1)
        walks, promising = self._screened(tried)
        progress(0.4)
        chosen = self._decided(promising)
        progress(0.7)
        walkers = self._evaluate(chosen)
        admitted = self._admitted(walkers)
        progress(0.9)
        self._reevaluate_elites()
        found = Generation(self.generation, tuple(tried), np.abs(walks).max(axis=1), tuple(walkers), admitted)
        progress(1.0)
        self.generation += 1
        return found

    def _progenitors(self, rng: np.random.Generator) -> list[Candidate]:
        c = self.config

        def draw() -> list[tuple[int, PrintedGenome]]:
            drawn = random_genomes(c.lattice, c.offspring, rng, c.max_active, len(c.timings))
            return [(-1, genome) for genome in drawn]

        return self._standing(draw, _RANDOM * c.offspring)

    def _offspring(self, rng: np.random.Generator) -> list[Candidate]:
        c, ranked = self.config, self.archive.ranked()
        best = ranked[:_PARENTS]
        chance = np.arange(len(best), 0, -1) / (len(best) * (len(best) + 1) / 2)

        def draw() -> list[tuple[int, PrintedGenome]]:
            everywhere = rng.random() < _ELSEWHERE
            parent = (
                ranked[rng.integers(len(ranked))] if everywhere else best[rng.choice(len(best), p=chance)]
            )
            return [(parent.number, offspring(c.lattice, parent.genome, rng, c.max_active, len(c.timings)))]

        return self._standing(draw, c.offspring)

    def _standing(self, draw: Callable[[], list[tuple[int, PrintedGenome]]], wanted: int) -> list[Candidate]:
        """Robots that stand, keep their shape, move and can be built; no two have the same genes."""
        first = self.generation * _RANDOM * self.config.offspring
        found: dict[bytes, Candidate] = {}
        drawn = 0
        while drawn < _ATTEMPTS * wanted:
            for parent, genome in draw():
                drawn += 1
                body = genome.body(self.config.lattice)
                if len(found) < wanted and self._stands(body):
                    key = _key(genome, body)
                    found.setdefault(key, Candidate(first + len(found), parent, genome, body))
            if len(found) == wanted:
                return list(found.values())
        raise EldirError(
            "too few bodies stand, move and can be built",
            code="evolution.too-few-bodies",
            expected=f"{wanted} different bodies",
            found=str(len(found)),
            remedy="enlarge the lattice, or lower the static margin",
        )

    def _stands(self, body: Morphology) -> bool:
        robot = build(body, self.config.nominal)
        stands = static_margin(robot) >= self.config.static_margin and height_over_base(robot) <= _TALLEST
        return stands and not shape_fault(robot) and self._can_be_built(body)

    def _can_be_built(self, body: Morphology) -> bool:
        """Whether the build filter accepts a body. It is asked before any trial: of the random robots that
        would walk far it refuses half or more."""
        if body.key not in self._buildable:
            self._buildable[body.key] = not self.refused(body)
        return self._buildable[body.key]

    def _share(self, part: float) -> int:
        """How many robots may go on to a trial: this part of a generation, twice as many at the beginning."""
        return round(part * self.config.offspring * (1 if self.archive.elites else _FOUNDERS))

    def _screened(self, tried: Sequence[Candidate]) -> tuple[FloatArray, list[tuple[Candidate, Trial]]]:
        """The walks of the first trial, and the robots that go on with their two best gaits. A robot that
        walks backwards goes on as its mirror image."""
        c = self.config
        trials = [
            screening(t.body, self._gait(t), self._seed(t.number, 0), spread=t.parent < 0) for t in tried
        ]
        walks = counted(self.evaluate(screened, trials, c.nominal))
        most = np.abs(walks).max(axis=1)
        promising: list[tuple[Candidate, Trial]] = []
        for i in np.argsort(-most, kind="stable"):
            if len(promising) == self._share(_DECIDED) or most[i] < _HARDLY:
                break
            candidate, forward = tried[i], 1.0
            if walks[i].max() < most[i]:
                candidate, forward = self._mirrored(candidate), -1.0
                if not self._can_be_built(candidate.body):
                    continue
            two = np.argsort(-forward * walks[i], kind="stable")[:2]
            gaits = [trials[i].gaits[k] for k in two]
            if forward < 0:
                gaits = [self._mirrored_gait(tried[i], candidate, gait) for gait in gaits]
            promising.append(
                (candidate, Trial(candidate.body, tuple(gaits), self._seed(candidate.number, 1)))
            )
        return walks, promising

    def _decided(self, promising: Sequence[tuple[Candidate, Trial]]) -> list[tuple[Candidate, Gait]]:
        """The robots that may enter the archive, each with the better of its two gaits."""
        if not promising:
            return []
        walks = self.evaluate(decided, [trial for _, trial in promising], self.config.nominal)
        elites = [self.archive.incumbent(niche_of(candidate.body)) for candidate, _ in promising]
        room = self._share(_EVALUATED)
        best = _most_promising(walks.max(axis=1), np.maximum(elites, 0.0), round(_TILTED * room), room // 2)
        chosen = [(promising[i][0], promising[i][1].gaits[int(walks[i].argmax())]) for i in best]
        return self._steady(chosen)[:room]

    def _steady(self, chosen: Sequence[tuple[Candidate, Gait]]) -> list[tuple[Candidate, Gait]]:
        """Those that walk about as far up a slope as down it."""
        trials = [Trial(c.body, (gait,), self._seed(c.number, 3)) for c, gait in chosen]
        walks = self.evaluate(on_slopes, trials, self.config.nominal)
        steady = (walks.min(axis=1) > 0) & (walks.min(axis=1) >= _STEADY * walks.max(axis=1))
        return [pair for pair, ok in zip(chosen, steady, strict=True) if ok]

    def _evaluate(self, chosen: Sequence[tuple[Candidate, Gait]]) -> list[Walker]:
        if not chosen:
            return []
        walkers = [
            Walker(c.number, c.parent, self.generation, _with_gait(c, gait), niche_of(c.body))
            for c, gait in chosen
        ]
        return self._with_fresh_samples(walkers)

    def _admitted(self, walkers: Sequence[Walker]) -> int:
        """How many enter the archive. Who would displace an elite is looked at as often as the elite was, and
        must stay better: the best of many first looks is lucky."""
        admitted = 0
        while walkers:
            challengers = [w for w in walkers if self.archive.challenges(w)]
            entered = [self.archive.offer(w) for w in challengers]
            admitted += sum(entered)
            less_known = [w for w, inside in zip(challengers, entered, strict=True) if not inside]
            walkers = self._with_fresh_samples([w for w in less_known if self.archive.challenges(w)])
        return admitted

    def _reevaluate_elites(self) -> None:
        uncertain = [w for w in self.archive.ranked() if len(w.walks) < KNOWN]
        for walker in self._with_fresh_samples(uncertain[:_AGAIN]):
            self.archive.update(walker)

    def _with_fresh_samples(self, walkers: Sequence[Walker]) -> list[Walker]:
        """The walkers after another look."""
        if not walkers:
            return []
        bodies = [w.genome.body(self.config.lattice) for w in walkers]
        trials = [
            Trial(body, (w.genome.gait(body, self.config.timings),), self._seed(w.number, 2), len(w.walks))
            for w, body in zip(walkers, bodies, strict=True)
        ]
        walks = self.evaluate(looked_at, trials, self.config.nominal)
        return [w.with_walks(own) for w, own in zip(walkers, walks, strict=True)]

    def _gait(self, candidate: Candidate) -> Gait:
        return candidate.genome.gait(candidate.body, self.config.timings)

    def _seed(self, number: int, trial: int) -> tuple[int, ...]:
        """Seed of the samples of one robot in one kind of trial: no choice is judged by its own samples."""
        return self.config.seed, number, trial

    def _mirrored(self, candidate: Candidate) -> Candidate:
        genome = mirrored(self.config.lattice, candidate.genome)
        return candidate._replace(genome=genome, body=genome.body(self.config.lattice))

    def _mirrored_gait(self, before: Candidate, after: Candidate, gait: Gait) -> Gait:
        """The gait of the mirror image, whose motors may have another order."""
        as_gene = mirrored(self.config.lattice, _with_gait(before, gait))
        return as_gene.gait(after.body, self.config.timings)


def _most_promising(walks: FloatArray, elites: FloatArray, most: int, farthest: int) -> list[int]:
    """Indices of at most so many robots: first the `farthest` that walk farthest of those that beat their
    elites, then those that beat them by most. An empty place is beaten by every robot that walks: without
    the first ones, poor robots of new kinds would leave no room for better ones of known kinds."""
    over = walks - elites
    beating = np.flatnonzero(over > 0)
    first = beating[np.argsort(-walks[beating], kind="stable")][:farthest].tolist()
    return [*first, *(i for i in np.argsort(-over, kind="stable").tolist() if i not in first)][:most]


def _with_gait(candidate: Candidate, gait: Gait) -> PrintedGenome:
    """The genes of a robot with the phases of this gait."""
    phases = candidate.genome.phases.copy()
    phases[motors_of(candidate.body)] = gait.phase
    return replace(candidate.genome, phases=phases)


def _key(genome: PrintedGenome, body: Morphology) -> bytes:
    """Equal for robots that are built and driven alike: what is not expressed does not count."""
    return body.key + genome.phases[motors_of(body)].tobytes() + bytes([genome.timing])
