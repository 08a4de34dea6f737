"""The search for printed robots that walk: offspring of the archive, evaluated in trials of rising accuracy.

In each generation, elites have offspring that stand, move and can be printed. A short trial with soft strips
finds their phases and rejects half of them. Samples with hubs decide between two gaits. A table that is
tilted either way must not change the walk much. Eight fresh samples with hubs give the fitness. Then the best
elites are evaluated again, because the best of many estimates is too good (winner's curse).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from eldir.built.gait import Gait
from eldir.built.robot import build, find_shape_fault, height_over_base, static_margin
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.evolution.printed.archive import Archive, Walker, find_niche
from eldir.evolution.printed.configuration import PrintedEvolutionConfig, RejectionReason
from eldir.evolution.printed.genome import (
    PrintedGenome,
    make_offspring,
    mirror_genome,
    motor_springs,
    random_genomes,
)
from eldir.evolution.printed.trials import (
    Trial,
    compare_gaits,
    count_falls_as_zero,
    evaluate_walks,
    make_screening_trial,
    screen_gaits,
    walk_on_slopes,
)
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters

Evaluation = Callable[[Sequence[Trial], RobotParameters], FloatArray]
"""A kind of trial in `eldir.evolution.printed.trials`: a row for each trial of robots like the nominal."""
Evaluator = Callable[[Evaluation, Sequence[Trial], RobotParameters], FloatArray]
"""Runs such trials somewhere: here, or on a cluster. No row depends on the others."""
Progress = Callable[[float], None]
MAX_SAMPLES = 32
"""Samples up to which elites are evaluated again."""
_ATTEMPTS = 400  # for each offspring that stands
_RANDOM = 6  # times as many random robots as offspring of a generation: they are the ancestors of all others
_COMPARED, _EVALUATED = 0.5, 0.2  # shares of a generation that reach the second and the third trial
_FOUNDERS = 2  # times as many reach them in the first generation, of random robots
_MAX_HEIGHT_TO_BASE = 1.5  # height of a robot over the distance of its outermost feet
_TILTED = 1.5  # times as many robots are tried on slopes as may reach the third trial
_MIN_SLOPE_RATIO = 0.7  # least walk on the worse slope, as a part of that on the better one
_MIN_SIZE_RATIO = 0.7  # least fitness of the best elite of a size that gets its share, as a part of the best
_ELSEWHERE = 0.2  # probability that a parent comes from the whole archive
_REEVALUATED = 3  # elites that are evaluated again in a generation
_MIN_WALK = 0.1  # less than this in the best gait: not a walker [body lengths per five cycles]


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
    candidates: tuple[Candidate, ...]
    screened_walks: FloatArray
    """Best walk of each in the first trial [body lengths per five cycles], shape (candidates,)."""
    evaluated: tuple[Walker, ...]
    """Robots with the walks of their first evaluation."""
    admitted: int
    """Number of robots that entered the archive."""


@dataclass
class PrintedSearch:
    """The state of a run after its last complete generation."""

    config: PrintedEvolutionConfig
    rejection_reason: RejectionReason = lambda body: ""
    generation: int = 0
    """Number of the generation that comes next."""
    archive: Archive = field(default_factory=Archive)
    evaluate: Evaluator = evaluate_here
    _buildable: dict[bytes, bool] = field(default_factory=dict, init=False, repr=False)
    """Result of the build filter for each body: many robots differ in their gaits alone."""

    @property
    def finished(self) -> bool:
        """Whether the last generation is complete."""
        return self.generation > self.config.generations

    def step(self, progress: Progress = lambda share: None) -> Generation:
        """Run one generation; the same configuration gives the same one, whatever was interrupted before."""
        rng = np.random.default_rng(np.random.SeedSequence(self.config.seed, spawn_key=(self.generation,)))
        candidates = self._offspring(rng) if self.archive.elites else self.progenitors(rng)
        progress(0.1)
        walks, promising = self.screen(candidates)
        progress(0.4)
        chosen = self._choose_gaits(promising)
        progress(0.7)
        walkers = self._evaluate(chosen)
        admitted = self.admit(walkers)
        progress(0.9)
        self._reevaluate_elites()
        found = Generation(
            self.generation, tuple(candidates), np.abs(walks).max(axis=1), tuple(walkers), admitted
        )
        progress(1.0)
        self.generation += 1
        return found

    def progenitors(self, rng: np.random.Generator) -> list[Candidate]:
        c = self.config

        def sample() -> list[tuple[int, PrintedGenome]]:
            genomes = random_genomes(c.lattice, c.offspring, rng, c.max_active, len(c.timings))
            return [(-1, genome) for genome in genomes]

        return self._collect_candidates(sample, _RANDOM * c.offspring)

    def _offspring(self, rng: np.random.Generator) -> list[Candidate]:
        c, ranked = self.config, self.archive.ranked()
        sizes = self.archive.by_size(_MIN_SIZE_RATIO)

        def sample() -> list[tuple[int, PrintedGenome]]:
            best = ranked if rng.random() < _ELSEWHERE else sizes[rng.integers(len(sizes))]
            chance = np.ones(len(best)) if best is ranked else np.arange(len(best), 0, -1.0)
            parent = best[rng.choice(len(best), p=chance / chance.sum())]
            return [
                (parent.number, make_offspring(c.lattice, parent.genome, rng, c.max_active, len(c.timings)))
            ]

        return self._collect_candidates(sample, c.offspring)

    def _collect_candidates(
        self, sample: Callable[[], list[tuple[int, PrintedGenome]]], wanted: int
    ) -> list[Candidate]:
        """Robots that stand, keep their shape, move and can be built; no two have the same genes."""
        first = self.generation * _RANDOM * self.config.offspring
        found: dict[bytes, Candidate] = {}
        sampled = 0
        while sampled < _ATTEMPTS * wanted:
            for parent, genome in sample():
                sampled += 1
                body = genome.body(self.config.lattice)
                if len(found) < wanted and self.stands(body):
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

    def stands(self, body: Morphology) -> bool:
        robot = build(body, self.config.nominal)
        stands = (
            static_margin(robot) >= self.config.static_margin
            and height_over_base(robot) <= _MAX_HEIGHT_TO_BASE
        )
        return stands and not find_shape_fault(robot) and self._can_be_built(body)

    def _can_be_built(self, body: Morphology) -> bool:
        """Whether the build filter accepts a body. It is asked before any trial: of the random robots that
        would walk far it refuses half or more."""
        if body.key not in self._buildable:
            self._buildable[body.key] = not self.rejection_reason(body)
        return self._buildable[body.key]

    def _trial_capacity(self, part: float) -> int:
        """How many robots may go on to a trial: this part of a generation, twice as many at the beginning."""
        return round(part * self.config.offspring * (1 if self.archive.elites else _FOUNDERS))

    def screen(self, candidates: Sequence[Candidate]) -> tuple[FloatArray, list[tuple[Candidate, Trial]]]:
        """The walks of the first trial, and the robots that go on with their two best gaits. A robot that
        walks backwards goes on as its mirror image."""
        nominal, ground = self.config.nominal, self.config.terrain
        trials = [
            make_screening_trial(c.body, self._gait(c), self._seed(c.number, 0), c.parent < 0, ground)
            for c in candidates
        ]
        walks = count_falls_as_zero(self.evaluate(screen_gaits, trials, nominal))
        most = np.abs(walks).max(axis=1)
        promising: list[tuple[Candidate, Trial]] = []
        for i in np.argsort(-most, kind="stable"):
            if len(promising) == self._trial_capacity(_COMPARED) or most[i] < _MIN_WALK:
                break
            candidate, forward = candidates[i], 1.0
            if walks[i].max() < most[i]:
                candidate, forward = self._mirror_candidate(candidate), -1.0
                if not self._can_be_built(candidate.body):
                    continue
            two = np.argsort(-forward * walks[i], kind="stable")[:2]
            gaits = [trials[i].gaits[k] for k in two]
            if forward < 0:
                gaits = [self._mirror_gait(candidates[i], candidate, gait) for gait in gaits]
            promising.append(
                (
                    candidate,
                    Trial(candidate.body, tuple(gaits), self._seed(candidate.number, 1), terrain=ground),
                )
            )
        return walks, promising

    def _choose_gaits(self, promising: Sequence[tuple[Candidate, Trial]]) -> list[tuple[Candidate, Gait]]:
        """The robots that may enter the archive, each with the better of its two gaits."""
        if not promising:
            return []
        walks = self.evaluate(compare_gaits, [trial for _, trial in promising], self.config.nominal)
        elites = [self.archive.incumbent(find_niche(candidate.body)) for candidate, _ in promising]
        room = self._trial_capacity(_EVALUATED)
        best = most_promising(
            walks.max(axis=1),
            np.maximum(elites, 0.0),
            [len(candidate.body.positions) for candidate, _ in promising],
            round(_TILTED * room),
            room // 2,
        )
        chosen = [(promising[i][0], promising[i][1].gaits[int(walks[i].argmax())]) for i in best]
        return self.keep_steady(chosen)[:room]

    def keep_steady(self, chosen: Sequence[tuple[Candidate, Gait]]) -> list[tuple[Candidate, Gait]]:
        """Those that walk about as far up a slope as down it; all on a terrain, whose slopes matter more than
        those of a table."""
        if self.config.terrain is not None:
            return list(chosen)
        trials = [Trial(c.body, (gait,), self._seed(c.number, 3)) for c, gait in chosen]
        walks = self.evaluate(walk_on_slopes, trials, self.config.nominal)
        steady = (walks.min(axis=1) > 0) & (walks.min(axis=1) >= _MIN_SLOPE_RATIO * walks.max(axis=1))
        return [pair for pair, ok in zip(chosen, steady, strict=True) if ok]

    def _evaluate(self, chosen: Sequence[tuple[Candidate, Gait]]) -> list[Walker]:
        if not chosen:
            return []
        walkers = [
            Walker(c.number, c.parent, self.generation, _with_gait(c, gait), find_niche(c.body))
            for c, gait in chosen
        ]
        return self._with_fresh_samples(walkers)

    def admit(self, walkers: Sequence[Walker]) -> int:
        """Admit walkers to the archive; returns their number. A robot that would displace an elite is
        evaluated as often as the elite was, and must stay better: the best of many first estimates is
        lucky."""
        admitted = 0
        while walkers:
            challengers = [w for w in walkers if self.archive.challenges(w)]
            entered = [self.archive.offer(w) for w in challengers]
            admitted += sum(entered)
            less_known = [w for w, inside in zip(challengers, entered, strict=True) if not inside]
            walkers = self._with_fresh_samples([w for w in less_known if self.archive.challenges(w)])
        return admitted

    def _reevaluate_elites(self) -> None:
        uncertain = [w for w in self.archive.ranked() if len(w.walks) < MAX_SAMPLES]
        turns = in_turn([w.niche.masses for w in uncertain])[:_REEVALUATED]
        for walker in self._with_fresh_samples([uncertain[i] for i in turns]):
            self.archive.update(walker)

    def _with_fresh_samples(self, walkers: Sequence[Walker]) -> list[Walker]:
        """The walkers with eight more samples each."""
        if not walkers:
            return []
        bodies = [w.genome.body(self.config.lattice) for w in walkers]
        trials = [
            Trial(
                body,
                (w.genome.gait(body, self.config.timings),),
                self._seed(w.number, 2),
                len(w.walks),
                self.config.terrain,
            )
            for w, body in zip(walkers, bodies, strict=True)
        ]
        walks = self.evaluate(evaluate_walks, trials, self.config.nominal)
        return [w.with_walks(own) for w, own in zip(walkers, walks, strict=True)]

    def _gait(self, candidate: Candidate) -> Gait:
        return candidate.genome.gait(candidate.body, self.config.timings)

    def _seed(self, number: int, trial: int) -> tuple[int, ...]:
        """Seed of the samples of one robot in one kind of trial: no choice is judged by its own samples."""
        return self.config.seed, number, trial

    def _mirror_candidate(self, candidate: Candidate) -> Candidate:
        genome = mirror_genome(self.config.lattice, candidate.genome)
        return candidate._replace(genome=genome, body=genome.body(self.config.lattice))

    def _mirror_gait(self, before: Candidate, after: Candidate, gait: Gait) -> Gait:
        """The gait of the mirror image, whose motors may have another order."""
        as_gene = mirror_genome(self.config.lattice, _with_gait(before, gait))
        return as_gene.gait(after.body, self.config.timings)


def most_promising(
    walks: FloatArray, elites: FloatArray, sizes: Sequence[int], most: int, farthest: int
) -> list[int]:
    """Indices of at most so many robots. First come those that beat their elites: the `farthest` that walk
    farthest, then the others by size (number of hubs) in turn, so that small robots leave room for larger
    ones; last those that do not beat their elites. An empty niche is beaten by every robot that walks."""
    order = np.argsort(-walks, kind="stable").tolist()
    beating = [i for i in order if walks[i] > elites[i]]
    others = beating[farthest:]
    turns = [others[k] for k in in_turn([sizes[i] for i in others])]
    rest = [i for i in np.argsort(elites - walks, kind="stable").tolist() if walks[i] <= elites[i]]
    return [*beating[:farthest], *turns, *rest][:most]


def in_turn(sizes: Sequence[int]) -> list[int]:
    """Indices of ranked robots of these sizes: first the best of each size, then the second of each, and so
    on, the better before the worse."""
    earlier: Counter[int] = Counter()
    turns = []
    for size in sizes:
        turns.append(earlier[size])
        earlier[size] += 1
    return sorted(range(len(sizes)), key=turns.__getitem__)


def _with_gait(candidate: Candidate, gait: Gait) -> PrintedGenome:
    """The genes of a robot with the phases of this gait."""
    phases = candidate.genome.phases.copy()
    phases[motor_springs(candidate.body)] = gait.phase
    return replace(candidate.genome, phases=phases)


def _key(genome: PrintedGenome, body: Morphology) -> bytes:
    """Equal for robots that are built and driven alike: what is not expressed does not count."""
    return body.key + genome.phases[motor_springs(body)].tobytes() + bytes([genome.timing])
