"""`eldir gait` takes the gait that evolved with a design, and says what the rig took away from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eldir.built import gait_search
from eldir.built.gait import Gait, read_gait
from eldir.built.gait_search import HeatingLimits, find_gait, fit_evolved_gait
from eldir.built.samples import NominalRobots, SampledWalks
from eldir.errors import InputError
from eldir.lattice import Lattice
from eldir.parameters.robot import RobotParameters
from eldir_hardware.planning.plan import heating_limits
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

OWN = Gait(20.0, np.array([0.0, 0.42]), np.array([0.3, 0.3]), "evolved")
DESIGN = make_design(10, Lattice(3, 6))
EVOLVED = replace(DESIGN, provenance={"gait": OWN.to_json()})
ROBOTS = NominalRobots(DESIGN.morphology, RobotParameters())


@pytest.fixture(scope="module")
def limits() -> HeatingLimits:
    return heating_limits(rig_with())


def test_a_design_keeps_its_gait() -> None:
    assert read_gait(DESIGN) is None
    assert read_gait(EVOLVED) == OWN
    for damage, code, key in (
        ({"phase": [0.0]}, "gait.inconsistent", None),
        ({"period_s": "soon"}, "gait.wrong-value", "period_s"),
        ({"duty": None}, "gait.inconsistent", "duty"),
    ):
        with raises(InputError, code, key):
            read_gait(replace(DESIGN, provenance={"gait": OWN_VALUES | damage}))


OWN_VALUES = OWN.to_json()


def test_an_allowed_gait_is_taken_as_it_is(limits: HeatingLimits, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_search(*_: object) -> Gait:
        raise AssertionError("phases were searched anew")

    tried = []

    def walks(robots: NominalRobots, gaits: list[Gait], *_: int, **quick: object) -> list[SampledWalks]:
        assert robots.robot.printed.joints == "hubs"
        tried.extend(gaits)
        return [SampledWalks(np.array([1.0, 1.1])) for _ in gaits]

    monkeypatch.setattr(gait_search, "search_gait", no_search)
    monkeypatch.setattr(gait_search, "sample_walks", walks)
    found = find_gait(EVOLVED, limits)
    assert found.method == "evolved" and found.gait == OWN and found.reason == ""
    assert list(found.gaits) == ["evolved"] and tried == [OWN], "nothing is simulated that nobody asked for"
    both = find_gait(EVOLVED, limits, imitate=True)
    assert both.method == "imitate" and list(both.gaits) == ["evolved", "imitate"] and len(tried) == 3


def test_a_rig_with_less_heat_gets_the_best_times_that_it_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judged by a stand-in that likes a later phase; falls count more than the mean."""
    weak = heating_limits(rig_with(supply={"max_total_current_a": 8}, limits={"max_on_s": 5.2}))
    assert not weak.allowed(OWN)

    def walks(robots: NominalRobots, gaits: list[Gait], *_: int, **quick: float) -> list[SampledWalks]:
        return [
            SampledWalks(np.array([3.0, -np.inf]) if g.phase[1] < 0.4 else np.full(2, float(g.phase[1])))
            for g in gaits
        ]

    monkeypatch.setattr(gait_search, "sample_walks", walks)
    gait, reason = fit_evolved_gait(ROBOTS, OWN, weak)
    assert weak.allowed(gait) and gait.duty[0] * gait.period <= 5.2 + 1e-6
    assert gait.phase[1] == pytest.approx(0.47)
    assert reason.startswith("the rig does not allow the evolved 6.0 s of heating in 20 s; ")


def test_a_rig_that_allows_nothing_is_told_by_the_compiler(limits: HeatingLimits) -> None:
    nothing = replace(limits, allowed=lambda gait: False)
    assert fit_evolved_gait(ROBOTS, OWN, nothing) == (OWN, "")
