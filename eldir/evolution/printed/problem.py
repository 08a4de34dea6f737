"""The evolution of printed robots that walk: offspring of the archive, and trials of rising accuracy.

In each generation, elites have offspring that stand, move and can be printed. A short trial with soft strips
finds their phases and rejects half of them. Samples with hubs decide between two gaits. A table that is
tilted either way must not change the walk much. Eight fresh samples with hubs give the fitness.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eldir.built.gait import Gait
from eldir.built.robot import build, find_shape_fault, height_over_base, static_margin
from eldir.core.records import BoolArray, FloatArray
from eldir.errors import EldirError
from eldir.evolution.archive import Archive
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
from eldir.evolution.printed.walker import Walker, find_niche, group_by_size
from eldir.evolution.problem import BatchGenerator, TrialBatch
from eldir.morphology import Morphology

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


class Candidate(NamedTuple):
    """A robot on its way through the trials of one generation."""

    number: int
    parent: int
    genome: PrintedGenome
    body: Morphology
    generation: int
    screened: float = 0.0
    """Best walk in the first trial [body lengths per five cycles]."""


class PrintedProblem:
    """Printed robots that walk on the rig's springs."""

    capacity = 1

    def __init__(
        self, config: PrintedEvolutionConfig, rejection_reason: RejectionReason = lambda body: ""
    ) -> None:
        """`rejection_reason` says why a body cannot be built, and must be the same whenever a run is
        continued."""
        self.config = config
        self.seed, self.generations = config.seed, config.generations
        self.rejection_reason = rejection_reason
        self._buildable: dict[bytes, bool] = {}  # of each body: many robots differ in their gaits alone

    def random(self, generation: int, rng: np.random.Generator) -> list[Candidate]:
        c = self.config

        def sample() -> list[tuple[int, PrintedGenome]]:
            genomes = random_genomes(c.lattice, c.offspring, rng, c.max_active, len(c.timings))
            return [(-1, genome) for genome in genomes]

        return self._collect(sample, generation, _RANDOM * c.offspring)

    def vary(self, archive: Archive[Walker], generation: int, rng: np.random.Generator) -> list[Candidate]:
        c, ranked = self.config, archive.ranked()
        sizes = group_by_size(ranked, _MIN_SIZE_RATIO)

        def sample() -> list[tuple[int, PrintedGenome]]:
            best = ranked if rng.random() < _ELSEWHERE else sizes[rng.integers(len(sizes))]
            chance = np.ones(len(best)) if best is ranked else np.arange(len(best), 0, -1.0)
            parent = best[rng.choice(len(best), p=chance / chance.sum())]
            return [
                (parent.number, make_offspring(c.lattice, parent.genome, rng, c.max_active, len(c.timings)))
            ]

        return self._collect(sample, generation, c.offspring)

    def _collect(
        self, sample: Callable[[], list[tuple[int, PrintedGenome]]], generation: int, wanted: int
    ) -> list[Candidate]:
        """Robots that stand, keep their shape, move and can be built; no two have the same genes."""
        first = generation * _RANDOM * self.config.offspring
        found: dict[bytes, Candidate] = {}
        sampled = 0
        while sampled < _ATTEMPTS * wanted:
            for parent, genome in sample():
                sampled += 1
                body = genome.body(self.config.lattice)
                if len(found) < wanted and self.stands(body):
                    number = first + len(found)
                    found.setdefault(_key(genome, body), Candidate(number, parent, genome, body, generation))
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

    def evaluate(
        self, candidates: Sequence[Candidate], archive: Archive[Walker]
    ) -> BatchGenerator[tuple[list[Candidate], list[Walker]]]:
        founders = 1 if len(archive) else _FOUNDERS
        room = [round(part * self.config.offspring * founders) for part in (_COMPARED, _EVALUATED)]
        trials = self.screening_trials(candidates)
        walks = count_falls_as_zero((yield self._batch(screen_gaits, trials, 0.1, 0.4)))
        tried = [
            c._replace(screened=float(most))
            for c, most in zip(candidates, np.abs(walks).max(axis=1), strict=True)
        ]
        promising = self.select_promising(candidates, trials, walks, room[0])
        chosen: list[tuple[Candidate, Gait]] = []
        if promising:
            walks = yield self._batch(compare_gaits, [trial for _, trial in promising], 0.4, 0.6)
            chosen = self._choose_gaits(promising, walks, archive, room[1])
        if chosen and self.config.terrain is None:  # a terrain has slopes that matter more than a table's
            trials = [Trial(c.body, (gait,), self._seed(c.number, 3)) for c, gait in chosen]
            walks = yield self._batch(walk_on_slopes, trials, 0.6, 0.7)
            chosen = [pair for pair, steady in zip(chosen, is_steady(walks), strict=True) if steady]
        walkers = [
            Walker(c.number, c.parent, c.generation, _with_gait(c, gait), find_niche(c.body))
            for c, gait in chosen[: room[1]]
        ]
        return tried, (yield from self.sample(walkers))

    def screening_trials(self, candidates: Sequence[Candidate]) -> list[Trial]:
        ground = self.config.terrain
        return [
            make_screening_trial(c.body, self._gait(c), self._seed(c.number, 0), c.parent < 0, ground)
            for c in candidates
        ]

    def select_promising(
        self, candidates: Sequence[Candidate], trials: Sequence[Trial], walks: FloatArray, room: int
    ) -> list[tuple[Candidate, Trial]]:
        """The robots that go on from the first trial, with their two best gaits. A robot that walks backwards
        goes on as its mirror image."""
        most = np.abs(walks).max(axis=1)
        promising: list[tuple[Candidate, Trial]] = []
        for i in np.argsort(-most, kind="stable"):
            if len(promising) == room or most[i] < _MIN_WALK:
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
            seed = self._seed(candidate.number, 1)
            trial = Trial(candidate.body, tuple(gaits), seed, terrain=self.config.terrain)
            promising.append((candidate, trial))
        return promising

    def _choose_gaits(
        self,
        promising: Sequence[tuple[Candidate, Trial]],
        walks: FloatArray,
        archive: Archive[Walker],
        room: int,
    ) -> list[tuple[Candidate, Gait]]:
        """The robots that may enter the archive, each with the better of its two gaits."""
        elites = [archive.incumbent(find_niche(candidate.body)) for candidate, _ in promising]
        best = choose_promising(
            walks.max(axis=1),
            np.maximum(elites, 0.0),
            [len(candidate.body.positions) for candidate, _ in promising],
            round(_TILTED * room),
            room // 2,
        )
        return [(promising[i][0], promising[i][1].gaits[int(walks[i].argmax())]) for i in best]

    def choose_uncertain(self, archive: Archive[Walker]) -> list[Walker]:
        """The best elites of each size whose walks are not yet well known."""
        uncertain = [w for w in archive.ranked() if w.samples < MAX_SAMPLES]
        return [uncertain[i] for i in alternate_sizes([w.niche.masses for w in uncertain])[:_REEVALUATED]]

    def sample(self, walkers: Sequence[Walker]) -> BatchGenerator[list[Walker]]:
        """The walkers with eight more samples each."""
        if not walkers:
            return []
        c, trials = self.config, []
        for w in walkers:
            body = w.genome.body(c.lattice)
            gait = w.genome.gait(body, c.timings)
            trials.append(Trial(body, (gait,), self._seed(w.number, 2), w.samples, c.terrain))
        walks = yield self._batch(evaluate_walks, trials, 0.7, 0.99)
        return [w.with_walks(own) for w, own in zip(walkers, walks, strict=True)]

    def _batch(
        self, trial: Callable[..., FloatArray], tasks: Sequence[Trial], first: float, last: float
    ) -> TrialBatch:
        return TrialBatch(trial, tasks, (first, last), (self.config.nominal, self.config.tolerances))

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


def is_steady(walks: FloatArray) -> BoolArray:
    """Which robots walk about as far up a slope as down it, from their walks on both, shape (n, 2)."""
    steady: BoolArray = (walks.min(axis=1) > 0) & (walks.min(axis=1) >= _MIN_SLOPE_RATIO * walks.max(axis=1))
    return steady


def choose_promising(
    walks: FloatArray, elites: FloatArray, sizes: Sequence[int], max_count: int, farthest: int
) -> list[int]:
    """Indices of at most so many robots. First come those that beat their elites: the `farthest` that walk
    farthest, then the others by size (number of hubs) in turn, so that small robots leave room for larger
    ones; last those that do not beat their elites. An empty niche is beaten by every robot that walks."""
    order = np.argsort(-walks, kind="stable").tolist()
    beating = [i for i in order if walks[i] > elites[i]]
    others = beating[farthest:]
    turns = [others[k] for k in alternate_sizes([sizes[i] for i in others])]
    rest = [i for i in np.argsort(elites - walks, kind="stable").tolist() if walks[i] <= elites[i]]
    return [*beating[:farthest], *turns, *rest][:max_count]


def alternate_sizes(sizes: Sequence[int]) -> list[int]:
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
