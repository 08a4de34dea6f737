"""What earlier adaptations tell of another robot of the same kit.

Parameters of the robots of a kit are those of the kit, which are not known, and a difference of each robot,
whose spread is the `Tolerance` of its field; for current and cooling the tolerances of the rig come to it.
Both are normal distributions, so what the beliefs of some robots tell of the next one is a closed form
(Gelman et al., Bayesian Data Analysis, 3rd ed., sect. 5.4). Each parameter counts by itself: covariances of
64 members are too coarse to be inverted. Single strips and springs stay as in every new robot.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from math import hypot, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldir.built.scene import PrintedScene
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.parameters.annotations import Tolerance, field_annotations
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.uncertain import (
    PARAMETERS,
    UncertainParameter,
    applicable_parameters,
    is_unobservable,
)
from eldir_calibration.adaptation.films import CURRENT

BELIEF, PRIOR = "belief.json", "prior.json"
"""Files of an adaptation: what is believed after its films, and before them."""
_SOURCES = "beliefs"  # entry of a prior's provenance
_MAX_KNOWN = 0.7
"""A belief tells of a parameter if it leaves at most this part of the variance before its films: that of 64
members is known to 18 %."""


class KitBelief(NamedTuple):
    """An earlier adaptation."""

    name: str
    before: PrintedScene | None
    """What was known before its films from other robots; None: nothing."""
    after: PrintedScene


def find_prior(
    folder: Path,
    given: Sequence[Path],
    nominal: RobotParameters,
    tolerances: RigTolerances,
    known: Collection[str] = (),
) -> PrintedScene | None:
    """What is known before the films of the adaptation in `folder`: that with which it began, else what the
    given folders tell, which is kept in it; None: nothing. `known`: parameters that were measured, of which
    nothing is to be told. Raises `InputError` for folders that it did not begin with."""
    prior = load_prior(given, nominal, tolerances, known) if given else None
    begun = PrintedScene.load(folder / PRIOR) if (folder / PRIOR).exists() else None
    if begun is not None and (late := set(known) & set(begun.parameters)):
        raise InputError(
            f"{folder} began before its {', '.join(late)} was measured",
            code="adapt.late-prior",
            remedy="give another --out",
        )
    if prior is not None:
        if begun is None and not (folder / "run_01").exists():
            prior.save(folder / PRIOR)
            return prior
        own = [] if begun is None else begun.provenance.get(_SOURCES, [])
        if own != prior.provenance[_SOURCES]:
            raise InputError(
                f"{folder} began with another prior",
                code="adapt.late-prior",
                expected=", ".join(own) or "no prior",
                found=", ".join(prior.provenance[_SOURCES]),
                remedy="leave --prior out, or give another --out",
            )
    return begun


def load_prior(
    folders: Sequence[Path], nominal: RobotParameters, tolerances: RigTolerances, known: Collection[str] = ()
) -> PrintedScene:
    """The prior of a robot from the folders of earlier adaptations. Raises `InputError` where one is no such
    folder, or is given twice."""
    beliefs: list[KitBelief] = []
    for folder in folders:
        if not (folder / BELIEF).exists():
            raise InputError(
                f"{folder} holds no belief",
                code="adapt.no-belief",
                expected="the folder of an adaptation with at least one run",
                remedy="give another --prior",
            )
        before = PrintedScene.load(folder / PRIOR) if (folder / PRIOR).exists() else None
        beliefs.append(KitBelief(folder.name, before, PrintedScene.load(folder / BELIEF)))
        _require_same_springs(folder, beliefs[-1].after, nominal)
        if any(beliefs[-1].after == other.after for other in beliefs[:-1]):
            raise InputError(
                f"{folder} holds the same belief as another one",
                code="adapt.prior-twice",
                expected="adaptations of different robots",
                remedy="name each one once",
            )
    return kit_prior(beliefs, nominal, tolerances, known)


def _require_same_springs(folder: Path, belief: PrintedScene, nominal: RobotParameters) -> None:
    """Raise `InputError` for a belief that deviates from other springs than those of the present rig file:
    its deviations would be added to a correction that was made of them. Supply and air may differ."""
    then = nominal.at(belief.parameters, belief.z).springs
    for part in fields(SpringParameters):
        if part.name in ("current_limit", "ambient"):
            continue
        here, there = getattr(then, part.name), getattr(belief.springs, part.name)
        if not np.allclose(here, there, rtol=1e-6, atol=0.0):
            raise InputError(
                f"{folder} began with other springs than those of this rig file",
                code="adapt.other-springs",
                expected="the same springs: what the films told would count twice",
                found=f"another {part.name}",
                remedy="leave --prior out, or begin with the rig file of that folder",
            )


def kit_prior(
    beliefs: Sequence[KitBelief],
    nominal: RobotParameters,
    tolerances: RigTolerances,
    known: Collection[str] = (),
) -> PrintedScene:
    """What is known of a robot before its films, from beliefs of other robots of the kit.

    `nominal`: the robot as designed, on its present supply.
    """
    names = tuple(name for name in applicable_parameters(nominal.printed) if name not in known)
    own = np.array([difference_between_robots(PARAMETERS[n], nominal, tolerances) ** 2 for n in names])
    kit = np.maximum(1.0 - own, 1e-9)  # variance of the kit's parameters before any film
    precision, weighted = 1.0 / kit, np.zeros(len(names))
    for belief in beliefs:
        told, value = _information(belief, names)
        share = told / (1.0 + told * own)  # of its information that is about the kit
        precision, weighted = precision + share, weighted + share * value
    mean, variance = weighted / precision, np.minimum(1.0 / precision + own, 1.0)
    scene = PrintedScene.of(nominal.at(names, mean), names, np.diag(variance), mean)
    return replace(scene, provenance={_SOURCES: [belief.name for belief in beliefs]})


def difference_between_robots(
    parameter: UncertainParameter, nominal: RobotParameters, tolerances: RigTolerances
) -> float:
    """Standard deviation of a parameter between robots of one kit on rigs alike, at most 1, in standard
    deviations of its prior."""
    kind, part = next(
        (kind, part)
        for kind, part in ((BuiltParameters, nominal.printed), (SpringParameters, nominal.springs))
        if hasattr(part, parameter.field)
    )
    value = float(getattr(part, parameter.field))
    spread = 0.0
    for name, tolerance in field_annotations(kind, Tolerance):
        if name == parameter.field and tolerance.joints in ("", nominal.printed.joints):
            unit = 1.0 if tolerance.form != "absolute" or parameter.additive else value
            spread = tolerance.spread / unit / (sqrt(3.0) if tolerance.form == "uniform" else 1.0)
    # Tolerances of a rig are two standard deviations.
    rig = {"current": tolerances.current / 2, "cooling": tolerances.convection / 2}
    return min(hypot(spread, rig.get(parameter.name, 0.0)) / parameter.spread, 1.0)


def _information(belief: KitBelief, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """What the films of a robot tell of each parameter without the prior: precision, and value."""
    before, after = belief.before, belief.after
    mean, variance = _marginals(belief.name, before, names)
    z, left = _marginals(belief.name, after, names)
    observable = np.array([not is_unobservable(name) for name in names])  # else narrower by chance
    told = observable & (left <= _MAX_KNOWN * variance)
    precision = np.where(told, 1.0 / np.where(told, left, 1.0) - 1.0 / variance, 0.0)
    weighted = np.where(told, z / np.where(told, left, 1.0) - mean / variance, 0.0)
    return precision, weighted / np.where(told, precision, 1.0)


def _marginals(
    name: str, scene: PrintedScene | None, names: tuple[str, ...]
) -> tuple[FloatArray, FloatArray]:
    """Mean and variance of each parameter; those of the priors without a scene, and for a current that was
    measured in those films and is not now."""
    known = {} if scene is None else dict(zip(scene.parameters, range(len(scene.z)), strict=True))
    if scene is not None and not set(names) ^ set(known) <= {CURRENT}:
        raise InputError(
            f"{name} has other parameters than this robot",
            code="adapt.other-parameters",
            expected=", ".join(names),
            found=", ".join(known),
            remedy="give adaptations by this version of eldir",
        )
    mean, variance = np.zeros(len(names)), np.ones(len(names))
    for i, parameter in enumerate(names):
        if scene is not None and parameter in known:
            k = known[parameter]
            mean[i], variance[i] = scene.z[k], scene.covariance[k, k]
    return mean, variance
