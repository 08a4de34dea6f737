"""Ranks the designs of a run for building: first the build filter, then the walk of the printed robot.

The fitness in the paper's scene does not rank printed robots (docs/reference/built.md). The walk of the
printed robot does: first in the best phases, or in the gait that evolved with the body; then over samples,
robots of the same design with slightly different parameters. The fitness of a design is the mean walk of its
samples, a fall counted as no walk, less half their standard deviation. A walk that ties decide
(`eldir.built.walking.MAX_TIE_SHARE`) cannot be predicted well. A user who builds several robots of a list
wants different ones: of bodies that evolved with a gait, those that differ, and those that walk nearly as far
as the best, come first; and a body that is on the list already (`Morphology.body_key`) comes after all others
that walk forward.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from eldir.built.gait import Gait, read_gait
from eldir.built.robot import build, count_mechanisms, static_margin
from eldir.built.samples import RISK, IdentifiedRobots, NominalRobots, SampledWalks, sample_walks
from eldir.built.scene import PrintedScene
from eldir.built.screening import ScreeningResult, screen
from eldir.built.walking import MAX_TIE_SHARE, walk
from eldir.core.arguments import require_value
from eldir.design import Design
from eldir.errors import EldirError
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_cad.checks.buildability import check
from eldir_cad.checks.kit_differences import different_parameters
from eldir_cad.checks.lateral_stability import LateralStability, predict_lateral_stability
from eldir_cad.checks.strip_law import built_parameters, hub_parameters, spring_parameters
from eldir_cad.checks.violations import BuildReport
from eldir_cad.kit.printer import Printer, fit_to_printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification
from eldir_cad.shortlist import MAX_DESIGNS, SEED

_NOT_FAR_ENOUGH = "walks less far than others"
_SAMPLED_PER_PLACE = 2  # designs to sample for each place on the list: samples change the order
MAX_SIMULATED = 400
"""Designs to simulate as printed robots, in the run's order; more take too long."""
Progress = Callable[[str, float], None]
_T = TypeVar("_T")
MAX_SIMILARITY = 0.8
"""Bodies that share more of their springs count as similar."""
NEARLY_AS_FAR = 0.9
"""Designs with at least this part of the best fitness walk about as far: samples hardly tell them apart."""
_GRID = (
    4  # steps in half a side of a triangle: middles of springs are on the grid, masses on every fourth step
)


@dataclass(frozen=True)
class RankedDesign:
    """A design on the shortlist, with the values that rank it."""

    design: Design
    report: BuildReport
    screened: ScreeningResult
    gait: Gait
    spread: SampledWalks
    lateral: LateralStability | None = None
    """Whether it falls over sideways if its faces differ; None where that is not predicted."""

    @property
    def may_fall_sideways(self) -> bool:
        """Whether its margin is too small."""
        return self.lateral is not None and not self.lateral.is_safe

    @property
    def is_doubtful(self) -> bool:
        """Whether ties make the prediction doubtful."""
        return self.spread.tie_share > MAX_TIE_SHARE


@dataclass(frozen=True)
class Shortlist:
    """The best designs, best first, and why the others were left out."""

    candidates: tuple[RankedDesign, ...]
    considered: int
    """Different bodies in the run."""
    left_out: dict[str, int]
    """Number of designs that each reason rejected, the most frequent reason first."""

    def require_candidates(self, remedy: str) -> None:
        """Raise `EldirError` if no design is left."""
        if not self.candidates:
            reasons = ", ".join(f"{n} {kind}" for kind, n in self.left_out.items()) or "no designs"
            problem, found = (
                "no evolved design can be built and stands",
                f"{self.considered} bodies: {reasons}",
            )
            raise EldirError(problem, code="shortlist.empty", found=found, remedy=remedy)


def rank(
    designs: Sequence[Design],
    top: int = MAX_DESIGNS,
    specification: Specification | None = None,
    printer: Printer | None = None,
    seed: int = SEED,
    progress: Progress | None = None,
    scene: PrintedScene | None = None,
    springs: SpringParameters | None = None,
    tolerances: RigTolerances | None = None,
) -> Shortlist:
    """The `top` designs whose samples walk farthest (`SampledWalks.fitness`), each in its best gait. First
    come different bodies that walk forward; then bodies that a better design has; then designs whose
    prediction is doubtful because of ties; then those that may fall over sideways.

    All walk on the ground of the designs (`Design.printed_terrain`), one for all. `scene`: an identified
    robot; then the samples are of its uncertainty. `springs`: nominal springs on the supply of a rig, by
    default those of the specification; `tolerances` of the rig, by default those of a new rig file.
    `progress` is called with the name of the stage and the completed share of it.
    """
    show = progress or (lambda _stage, _share: None)
    one_ground = all(d.printed_terrain == designs[0].printed_terrain for d in designs)
    require_value("designs", one_ground, "designs of one run, with the same printed_terrain")
    printer = printer or load_printer()
    spec = fit_to_printer(specification or load_specification(), printer)
    different = _unique_bodies(designs)
    reasons: Counter[str] = Counter()
    own, other_parts = springs or spring_parameters(spec), different_parameters(spec, printer)
    buildable = _filter_buildable(different, spec, printer, own, reasons, show)
    nominal = RobotParameters(built_parameters(spec, printer, own), own)
    robot = nominal if scene is None else scene.robot.uniform
    with_hubs = RobotParameters(hub_parameters(spec, printer, own), own)
    standing = _screen([d for d, _ in buildable], robot, _SAMPLED_PER_PLACE * top, reasons, show)
    candidates = []
    for i, (s, gait) in enumerate(standing):
        design, report = buildable[s.index]
        body = design.morphology
        robots = (
            NominalRobots(
                body, with_hubs, terrain=design.printed_terrain, tolerances=tolerances or RigTolerances()
            )
            if scene is None
            else IdentifiedRobots(
                body,
                robot,
                terrain=design.printed_terrain,
                parameters=scene.parameters,
                covariance=scene.covariance,
            )
        )
        # On rugged ground coarse robots walk otherwise (decision 56).
        coarse = robots.robot.printed.joints == "hubs" and design.printed_terrain is None
        (walks,) = sample_walks(robots, [gait], seed=seed, coarse=coarse)
        lateral = None
        if design.printed_terrain is None:
            lateral = predict_lateral_stability(body, gait, spec, printer, robot.springs)
        built = replace(design, other_parts=other_parts)
        candidates.append(RankedDesign(built, report, s, gait, walks, lateral))
        show("samples", (i + 1) / len(standing))
    candidates.sort(key=lambda c: (c.may_fall_sideways, c.is_doubtful, -c.spread.fitness))
    candidates = repeats_last(
        candidates,
        [c.design.morphology for c in candidates],
        [c.spread.fitness > 0 and not (c.is_doubtful or c.may_fall_sideways) for c in candidates],
    )
    reasons[_NOT_FAR_ENOUGH] += len(candidates[top:])
    left_out = {kind: n for kind, n in reasons.most_common() if n}
    return Shortlist(tuple(candidates[:top]), len(different), left_out)


def _filter_buildable(
    designs: Sequence[Design],
    spec: Specification,
    printer: Printer,
    springs: SpringParameters | None,
    reasons: Counter[str],
    show: Progress,
) -> list[tuple[Design, BuildReport]]:
    """The designs that pass the build filter; the others are counted in `reasons`."""
    buildable: list[tuple[Design, BuildReport]] = []
    for i, design in enumerate(designs):
        report = check(design.morphology, spec, printer, springs)
        violation = next((v.kind for v in report.violations if v.severity != "note"), None)
        if violation is not None:
            reasons[violation] += 1
        elif len(buildable) >= MAX_SIMULATED:
            reasons["not simulated: enough others"] += 1
        else:
            buildable.append((design, report))
        show("build filter", (i + 1) / len(designs))
    return buildable


def _screen(
    designs: Sequence[Design],
    robot: RobotParameters,
    max_count: int,
    reasons: Counter[str],
    show: Progress,
) -> list[tuple[ScreeningResult, Gait]]:
    """At most so many robots that stay upright in their best gait, the farthest first; the others are counted
    in `reasons`. Designs that evolved with a gait walk in it, and are in the order of their run, which knows
    them from more than one robot; but those that are like a better one come last, unless they walk nearly as
    far as the best one: another body that walks much less is no replacement."""
    gaits = [read_gait(design) for design in designs]
    bodies = [design.morphology for design in designs]
    if gaits and None not in gaits:
        max_count = max_count // _SAMPLED_PER_PLACE + 1  # their run has sampled them already
        reasons[_NOT_FAR_ENOUGH] += len(designs[max_count:])
        fitness = [_evolved_fitness(design) for design in designs]
        far = [x >= NEARLY_AS_FAR * max(fitness) > 0 for x in fitness]
        evolved = [(i, gaits[i]) for i in diverse_first(bodies, always=far)[:max_count]]
        return [(_as_evolved(i, designs[i], g, robot), g) for i, g in evolved if g is not None]
    screened = []
    ground = designs[0].printed_terrain if designs else None
    for s in screen(
        bodies,
        robot.printed,
        robot.springs,
        progress=lambda share: show("all phases", share),
        terrain=ground,
    ):
        if s.rejected:
            # Its reason names the number of mechanisms; together they count as one.
            reasons["mechanism" if s.mechanisms else "static margin"] += 1
        elif not np.isfinite(s.best):
            reasons["falls over, folds or buckles a coil"] += 1
        elif not s.exact or s.gait is None:
            reasons[_NOT_FAR_ENOUGH] += 1
        else:
            screened.append((s, s.gait))
    screened.sort(key=lambda pair: -pair[0].best)
    order = [s for s, _ in screened]
    screened = repeats_last(screened, [bodies[s.index] for s in order], [s.best > 0 for s in order])
    reasons[_NOT_FAR_ENOUGH] += len(screened[max_count:])
    return screened[:max_count]


def _evolved_fitness(design: Design) -> float:
    """The fitness of a design in the run in which it evolved with its gait; minus infinity if unknown."""
    walks = design.provenance.get("evolved_walk")
    if not isinstance(walks, dict) or walks["standard_error"] is None:
        return -np.inf
    deviation = walks["standard_error"] * np.sqrt(walks["samples"])
    return float(walks["expected"] - RISK * deviation)


def _as_evolved(index: int, design: Design, gait: Gait, robot: RobotParameters) -> ScreeningResult:
    """The screening of a design in the gait that evolved with it: the walk of its nominal robot."""
    nominal = build(design.morphology, robot)
    distance = walk(nominal, gait, robot.springs, terrain=design.printed_terrain)
    mechanisms = count_mechanisms(nominal.positions, nominal.springs)
    return ScreeningResult(index, static_margin(nominal), mechanisms, np.array([distance]), gait, True, "")


def _unique_bodies(designs: Sequence[Design]) -> list[Design]:
    """The first design of each body."""
    unique: dict[bytes, Design] = {}
    for design in designs:
        unique.setdefault(design.morphology.key, design)
    return list(unique.values())


def repeats_last(ranked: Sequence[_T], bodies: Sequence[Morphology], good: Sequence[bool]) -> list[_T]:
    """Those that are good and whose body none before them has, then the others; each in their order."""
    first = {body.body_key: i for i, body in reversed(list(enumerate(bodies)))}
    wanted = [g and first[body.body_key] == i for i, (g, body) in enumerate(zip(good, bodies, strict=True))]
    return [ranked[i] for i in sorted(range(len(ranked)), key=lambda i: not wanted[i])]


def spring_overlap(one: Morphology, other: Morphology) -> float:
    """Springs that two bodies have in common at the best position of one, or of its mirror image, on the
    other, as a share of all springs of both, 0 to 1. Bodies stand on the ground, anywhere along it."""
    a, b = _spring_positions(one), _spring_positions(other)
    width = round(np.ptp(other.positions[:, 0]) / HALF_SIDE * _GRID)
    max_shift = max(x for x, _ in a | b) // _GRID
    steps = range(-max_shift * _GRID, max_shift * _GRID + 1, _GRID)
    either = b, {(width - x, z) for x, z in b}
    return max(_jaccard(a, {(x + step, z) for x, z in side}) for step in steps for side in either)


def diverse_first(
    bodies: Sequence[Morphology], max_similarity: float = MAX_SIMILARITY, always: Sequence[bool] = ()
) -> list[int]:
    """Indices of the bodies that share at most `max_similarity` of their springs with each one chosen before,
    and of those that are `always` chosen; then those of the others. Both in their order."""
    chosen: list[int] = []
    for i, body in enumerate(bodies):
        wanted = i < len(always) and always[i]
        if wanted or all(spring_overlap(body, bodies[k]) <= max_similarity for k in chosen):
            chosen.append(i)
    return chosen + [i for i in range(len(bodies)) if i not in set(chosen)]


def _spring_positions(body: Morphology) -> set[tuple[int, int]]:
    """Middles of the springs on a grid, from the body's lower left corner."""
    middles = (body.positions[body.springs].mean(axis=1) - body.positions.min(axis=0)) / HALF_SIDE * _GRID
    return {(round(x), round(z)) for x, z in middles.tolist()}


def _jaccard(a: set[tuple[int, int]], b: set[tuple[int, int]]) -> float:
    return len(a & b) / len(a | b)
