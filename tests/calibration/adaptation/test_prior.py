"""What beliefs of some robots of a kit tell of the next one, against the conditional normal distribution."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldir.built.scene import PrintedScene
from eldir.core.records import FloatArray
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.robot import RobotParameters
from eldir.parameters.tolerances import RigTolerances
from eldir.parameters.uncertain import PARAMETERS, applicable_parameters, is_unobservable
from eldir_calibration.adaptation.prior import (
    KitBelief,
    difference_between_robots,
    find_prior,
    kit_prior,
    load_prior,
)
from eldir_calibration.dynamics.belief import BeliefConfig, believe
from tests.calibration.dynamics.hidden_rigs import walker
from tests.raised import raises

NOMINAL = RobotParameters(BuiltParameters().with_hubs())
NAMES = applicable_parameters(NOMINAL.printed)
TOLERANCES = RigTolerances()
ERRORS = np.linspace(0.1, 0.4, len(NAMES))  # standard deviations with which a film tells each parameter


def conclude(
    seen: FloatArray, mean: FloatArray | float = 0.0, variance: FloatArray | float = 1.0
) -> PrintedScene:
    """The belief of a robot whose film shows `seen`, after what was known before."""
    precision = 1 / np.asarray(variance) + 1 / ERRORS**2
    z = (mean / np.asarray(variance) + seen / ERRORS**2) / precision
    return PrintedScene.of(NOMINAL.at(NAMES, z), NAMES, np.diag(1 / precision), z)


def own_variances() -> FloatArray:
    return np.array([difference_between_robots(PARAMETERS[n], NOMINAL, TOLERANCES) ** 2 for n in NAMES])


def test_two_robots_tell_of_a_third_as_the_joint_normal_distribution_does() -> None:
    rng = np.random.default_rng(3)
    films = rng.standard_normal((2, len(NAMES)))
    beliefs = [KitBelief(str(i), None, conclude(film)) for i, film in enumerate(films)]
    found = kit_prior(beliefs, NOMINAL, TOLERANCES)
    unseen = [is_unobservable(name) for name in NAMES]
    assert any(unseen) and not found.z[unseen].any()
    for k, own in enumerate(own_variances()):
        if unseen[k]:
            continue
        joint = np.full((3, 3), 1 - own) + own * np.eye(3)  # of the robots' parameters: the kit is common
        gain = joint[2, :2] @ np.linalg.inv(joint[:2, :2] + ERRORS[k] ** 2 * np.eye(2))
        assert found.z[k] == pytest.approx(gain @ films[:, k], abs=1e-6)
        assert found.covariance[k, k] == pytest.approx(1 - gain @ joint[:2, 2], abs=1e-6)


def test_a_belief_that_began_with_a_prior_tells_only_what_its_own_films_do() -> None:
    rng = np.random.default_rng(4)
    films = rng.standard_normal((2, len(NAMES)))
    first = KitBelief("a", None, conclude(films[0]))
    before = kit_prior([first], NOMINAL, TOLERANCES)
    errors = 0.5 * np.diag(before.covariance) >= ERRORS**2  # else its film tells too little to count
    second = KitBelief("b", before, conclude(films[1], before.z, np.diag(before.covariance)))
    alone = KitBelief("b", None, conclude(films[1]))
    found, expected = (kit_prior([first, one], NOMINAL, TOLERANCES) for one in (second, alone))
    assert errors.sum() > 5
    np.testing.assert_allclose(found.z[errors], expected.z[errors], atol=1e-9)


def test_what_differs_between_robots_is_not_learned_from_another_one() -> None:
    """The mass of a print scatters as much as it is unknown; the stiffness of a wire does not."""
    certain = PrintedScene.of(NOMINAL.at(NAMES, np.ones(len(NAMES))), NAMES, 1e-6 * np.eye(len(NAMES)),
                              np.ones(len(NAMES)))  # fmt: skip
    found = kit_prior([KitBelief("a", None, certain)], NOMINAL, TOLERANCES)
    left = dict(zip(NAMES, np.diag(found.covariance), strict=True))
    assert left["weight"] == pytest.approx(1.0) and left["hot_stiffness"] < 0.05 < left["friction"] < 0.5
    vague = replace(certain, covariance=0.8 * np.eye(len(NAMES)))
    assert not kit_prior([KitBelief("a", None, vague)], NOMINAL, TOLERANCES).z.any()


def test_of_a_current_that_was_measured_nothing_is_told_and_of_the_rest_the_same(tmp_path: Path) -> None:
    """Whether it is measured now, or was in the films of the other robot."""
    rest = [i for i, name in enumerate(NAMES) if name != "current"]
    names = tuple(NAMES[i] for i in rest)
    whole = conclude(np.random.default_rng(6).standard_normal(len(NAMES)))
    measured = PrintedScene.of(
        NOMINAL.at(names, whole.z[rest]), names, whole.covariance[np.ix_(rest, rest)], whole.z[rest]
    )
    expected = kit_prior([KitBelief("a", None, whole)], NOMINAL, TOLERANCES)
    for belief in (whole, measured):
        found = kit_prior([KitBelief("a", None, belief)], NOMINAL, TOLERANCES, ("current",))
        assert found.parameters == names and found.z.tolist() == expected.z[rest].tolist()
        assert found.springs.current_limit == pytest.approx(NOMINAL.at(names, found.z).springs.current_limit)
    later = kit_prior([KitBelief("a", None, measured)], NOMINAL, TOLERANCES)
    i = NAMES.index("current")
    assert later.z[i] == 0.0 and later.covariance[i, i] == pytest.approx(1.0)
    (tmp_path / "run_01").mkdir()
    expected.save(tmp_path / "prior.json")
    with raises(InputError, "adapt.late-prior", match="before its current was measured"):
        find_prior(tmp_path, [], NOMINAL, TOLERANCES, ("current",))


def test_without_films_a_belief_is_its_prior() -> None:
    rng = np.random.default_rng(5)
    mean = rng.uniform(-0.5, 0.5, len(NAMES))
    root = 0.1 * rng.standard_normal((len(NAMES), len(NAMES))) / np.sqrt(len(NAMES)) + 0.1 * np.eye(
        len(NAMES)
    )
    prior = PrintedScene.of(NOMINAL.at(NAMES, mean), NAMES, root @ root.T, mean)
    found = believe(walker(), [], NOMINAL, prior=prior, config=BeliefConfig(members=300)).scene
    np.testing.assert_allclose(found.z, mean, atol=0.04)
    np.testing.assert_allclose(found.covariance, prior.covariance, atol=0.008)


def test_folders_that_tell_nothing_are_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        conclude(np.zeros(len(NAMES))).save(tmp_path / name / "belief.json")
    (tmp_path / "empty").mkdir()
    for code, names in (("adapt.no-belief", ["a", "empty"]), ("adapt.prior-twice", ["a", "b"])):
        with raises(InputError, code):
            load_prior([tmp_path / name for name in names], NOMINAL, TOLERANCES)
    of_pins = PrintedScene.of(RobotParameters(), NAMES[:3], np.eye(3))
    of_pins.save(tmp_path / "pins" / "belief.json")
    with raises(InputError, "adapt.other-parameters"):
        load_prior([tmp_path / "pins"], NOMINAL, TOLERANCES)
    assert load_prior([tmp_path / "a"], NOMINAL, TOLERANCES).provenance == {"beliefs": ["a"]}


def test_an_adaptation_goes_on_with_the_prior_it_began_with(tmp_path: Path) -> None:
    for k, name in enumerate(("a", "b")):
        conclude(np.full(len(NAMES), k)).save(tmp_path / name / "belief.json")
    a, b, out = tmp_path / "a", tmp_path / "b", tmp_path / "out"
    assert find_prior(out, [], NOMINAL, TOLERANCES) is None and not out.exists()
    began = find_prior(out, [a], NOMINAL, TOLERANCES)
    (out / "run_01").mkdir()
    assert find_prior(out, [], NOMINAL, TOLERANCES) == began == find_prior(out, [a], NOMINAL, TOLERANCES)
    with raises(InputError, "adapt.late-prior"):
        find_prior(out, [a, b], NOMINAL, TOLERANCES)
    (out / "prior.json").unlink()
    with raises(InputError, "adapt.late-prior"):
        find_prior(out, [a], NOMINAL, TOLERANCES)
