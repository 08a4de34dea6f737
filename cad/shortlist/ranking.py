"""Rank the designs of a run for building: first the build filter, then the predicted walk as built.

The fitness in the paper's scene does not rank built robots (docs/reference/built.md). The walk as built
does: first in the best phases, or in the gait that evolved with the body; then over samples, robots of the
same design with slightly different parameters. A design is worth the mean walk of its samples, a fall
counted as no walk, less half their standard deviation. A walk that ties decide (`eldir.built.validity.ties`)
cannot be predicted well. Of bodies that evolved with a gait, those that differ come first.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cad.checks.buildability import check
from cad.checks.strip_law import built_parameters, hub_parameters, spring_parameters
from cad.checks.violations import BuildReport
from cad.kit.defaults import SEED, TOP
from cad.kit.fit import fitted_to_printer
from cad.kit.printer import Printer, load_printer
from cad.kit.specification import Specification, load_specification
from cad.shortlist.likeness import unlike_first
from eldir.built.gait import Gait, gait_of
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, NominalRobots, SampledWalks, sampled_walks
from eldir.built.scene import BuiltScene
from eldir.built.screening import Screened, screen
from eldir.built.statics import freedoms, static_margin
from eldir.built.validity.ties import TIED
from eldir.built.walking import walk
from eldir.design import Design
from eldir.errors import EldirError
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters

_BEATEN = "walks less far than others"
_HEAVIER = 4.0  # mass scaling of robots with hubs: the mean of 8 walks changes by 0.03, root mean square
_SAMPLED = 2  # designs to sample for each place on the list: samples change the order
MOST = 400  # designs to simulate as built, in the run's order; more take too long
Progress = Callable[[str, float], None]


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
        evolved = [(i, gaits[i]) for i in unlike_first(bodies)[:most]]
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
