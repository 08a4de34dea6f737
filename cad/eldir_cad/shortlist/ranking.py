"""Rank the designs of a run for building: first the build filter, then the predicted walk as built.

The fitness in the paper's scene does not rank built robots (docs/reference/built.md). The walk as built
does: first in the best phases, or in the gait that evolved with the body; then over samples, robots of the
same design with slightly different parameters. A design is worth the mean walk of its samples, a fall
counted as no walk, less half their standard deviation. A walk that ties decide (`eldir.built.walking.TIED`)
cannot be predicted well. Of bodies that evolved with a gait, those that differ come first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eldir.built.gait import Gait, gait_of
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, NominalRobots, SampledWalks, sampled_walks
from eldir.built.scene import BuiltScene
from eldir.built.screening import Screened, screen
from eldir.built.statics import freedoms, static_margin
from eldir.built.walking import TIED, walk
from eldir.design import Design
from eldir.errors import EldirError
from eldir.lattice import HALF_SIDE
from eldir.morphology import Morphology
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.buildability import check
from eldir_cad.checks.strip_law import built_parameters, hub_parameters, spring_parameters
from eldir_cad.checks.violations import BuildReport
from eldir_cad.kit.defaults import SEED, TOP
from eldir_cad.kit.fit import fitted_to_printer
from eldir_cad.kit.printer import Printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification

_BEATEN = "walks less far than others"
_HEAVIER = 4.0  # mass scaling of robots with hubs: the mean of 8 walks changes by 0.03, root mean square
_SAMPLED = 2  # designs to sample for each place on the list: samples change the order
MOST = 400  # designs to simulate as built, in the run's order; more take too long
Progress = Callable[[str, float], None]
ALIKE = 0.8
"""Two bodies that share more than this are alike."""
_GRID = 4  # steps in half a side of a triangle: middles of springs lie on them, masses on every fourth


@dataclass(frozen=True)
class RankedDesign:
    """A design on the shortlist, with the values that rank it."""

    design: Design
    report: BuildReport
    screened: Screened
    gait: Gait
    spread: SampledWalks

    @property
    def tied(self) -> bool:
        """Whether ties make the prediction doubtful."""
        return self.spread.tie_share > TIED


@dataclass(frozen=True)
class Shortlist:
    """The best designs, best first, and why the others were left out."""

    candidates: tuple[RankedDesign, ...]
    considered: int
    """Different bodies in the run."""
    left_out: dict[str, int]
    """Number of designs that each reason rejected, the most frequent reason first."""

    def require_candidates(self, remedy: str) -> None:
        """Raise `EldirError` where no design is left."""
        if not self.candidates:
            reasons = ", ".join(f"{n} {kind}" for kind, n in self.left_out.items()) or "no designs"
            problem, found = (
                "no evolved design can be built and stands",
                f"{self.considered} bodies: {reasons}",
            )
            raise EldirError(problem, code="shortlist.empty", found=found, remedy=remedy)


def rank(
    designs: Sequence[Design],
    top: int = TOP,
    specification: Specification | None = None,
    printer: Printer | None = None,
    seed: int = SEED,
    progress: Progress | None = None,
    known: BuiltScene | None = None,
    springs: SpringParameters | None = None,
) -> Shortlist:
    """The `top` designs whose samples walk farthest (`SampledWalks.worth`), each in its best gait. Designs
    whose prediction is doubtful because of ties come after the others.

    `known`: an identified robot; samples are then drawn from its uncertainty. `springs`: nominal springs on
    the supply of a rig. `progress` is called with the name of the stage and the completed share of it.
    """
    show = progress or (lambda _stage, _share: None)
    printer = printer or load_printer()
    spec = fitted_to_printer(specification or load_specification(), printer)
    different = _different(designs)
    reasons: Counter[str] = Counter()
    sound = _filtered(different, spec, printer, reasons, show)
    nominal = RobotParameters(built_parameters(spec, printer), springs or spring_parameters(spec))
    robot = nominal if known is None else known.robot.uniform
    with_hubs = replace(nominal, printed=hub_parameters(spec, printer))
    standing = _standing([d for d, _ in sound], robot, _SAMPLED * top, reasons, show)
    candidates = []
    for i, (s, gait) in enumerate(standing):
        design, report = sound[s.index]
        body = design.morphology
        robots = (
            NominalRobots(body, with_hubs)
            if known is None
            else IdentifiedRobots(body, robot, parameters=known.parameters, covariance=known.covariance)
        )
        heavier = _HEAVIER if robots.robot.printed.joints == "hubs" else 1.0
        (walks,) = sampled_walks(robots, [gait], seed=seed, mass_scaling=heavier)
        candidates.append(RankedDesign(design, report, s, gait, walks))
        show("samples", (i + 1) / len(standing))
    candidates.sort(key=lambda c: (c.tied, -c.spread.worth))
    reasons[_BEATEN] += len(candidates[top:])
    left_out = {kind: n for kind, n in reasons.most_common() if n}
    return Shortlist(tuple(candidates[:top]), len(different), left_out)


def _filtered(
    different: Sequence[Design], spec: Specification, printer: Printer, reasons: Counter[str], show: Progress
) -> list[tuple[Design, BuildReport]]:
    """The designs that pass the build filter; the others are counted in `reasons`."""
    sound: list[tuple[Design, BuildReport]] = []
    for i, design in enumerate(different):
        report = check(design.morphology, spec, printer)
        against = next((v.kind for v in report.violations if v.severity != "note"), None)
        if against is not None:
            reasons[against] += 1
        elif len(sound) >= MOST:
            reasons["not simulated: enough others"] += 1
        else:
            sound.append((design, report))
        show("build filter", (i + 1) / len(different))
    return sound


def _standing(
    designs: Sequence[Design],
    robot: RobotParameters,
    most: int,
    reasons: Counter[str],
    show: Progress,
) -> list[tuple[Screened, Gait]]:
    """At most so many robots that stay upright in their best gait, the farthest first; the others are counted
    in `reasons`. Designs that evolved with a gait walk in it, and are in the order of their run, which knows
    them from more than one robot; but those that are like a better one come last."""
    gaits = [gait_of(design) for design in designs]
    bodies = [design.morphology for design in designs]
    if gaits and None not in gaits:
        most = most // _SAMPLED + 1  # their run has sampled them already
        reasons[_BEATEN] += len(designs[most:])
        evolved = [(i, gaits[i]) for i in diverse_first(bodies)[:most]]
        return [(_as_evolved(i, designs[i], g, robot), g) for i, g in evolved if g is not None]
    found = []
    for s in screen(bodies, robot.printed, robot.springs, progress=lambda share: show("all phases", share)):
        if s.rejected:
            # Its reason names the number of mechanisms; together they count as one.
            reasons["mechanism" if s.freedoms else "static margin"] += 1
        elif not np.isfinite(s.best):
            reasons["falls over, folds or buckles a coil"] += 1
        elif not s.exact or s.gait is None:
            reasons[_BEATEN] += 1
        else:
            found.append((s, s.gait))
    found.sort(key=lambda pair: -pair[0].best)
    reasons[_BEATEN] += len(found[most:])
    return found[:most]


def _as_evolved(index: int, design: Design, gait: Gait, robot: RobotParameters) -> Screened:
    """The screening of a design in the gait that evolved with it: the walk of its nominal robot."""
    nominal = build(design.morphology, robot)
    far = walk(nominal, gait, robot.springs)
    loose = freedoms(nominal.positions, nominal.springs)
    return Screened(index, static_margin(nominal), loose, np.array([far]), gait, True, "")


def _different(designs: Sequence[Design]) -> list[Design]:
    """The first design of each body."""
    seen: dict[bytes, Design] = {}
    for design in designs:
        seen.setdefault(design.morphology.key, design)
    return list(seen.values())


def shared_springs(one: Morphology, other: Morphology) -> float:
    """Springs that two bodies have in common when they stand best on each other, as a share of all springs
    of both, 0 to 1. Bodies stand on the ground and may be shifted along it, not turned round."""
    a, b = _spring_places(one), _spring_places(other)
    longest = max(x for x, _ in a | b) // _GRID
    steps = range(-longest * _GRID, longest * _GRID + 1, _GRID)
    return max(_share(a, {(x + step, z) for x, z in b}) for step in steps)


def diverse_first(bodies: Sequence[Morphology], alike: float = ALIKE) -> list[int]:
    """Indices of the bodies that share at most `alike` with each one chosen before; then those of the others.
    Both in their order."""
    chosen: list[int] = []
    for i, body in enumerate(bodies):
        if all(shared_springs(body, bodies[k]) <= alike for k in chosen):
            chosen.append(i)
    return chosen + [i for i in range(len(bodies)) if i not in set(chosen)]


def _spring_places(body: Morphology) -> set[tuple[int, int]]:
    """Middles of the springs on a grid, from the body's lower left corner."""
    middles = (body.positions[body.springs].mean(axis=1) - body.positions.min(axis=0)) / HALF_SIDE * _GRID
    return {(round(x), round(z)) for x, z in middles.tolist()}


def _share(a: set[tuple[int, int]], b: set[tuple[int, int]]) -> float:
    return len(a & b) / len(a | b)
