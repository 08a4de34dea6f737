"""The conditions under which robots evolve for building are those of the parts and of the rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from eldir import defaults
from eldir.built.gait import Gait
from eldir.errors import InputError
from eldir_cad.checks.buildability import check
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.workshop import allowed_timings, make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.safety.limits import LimitError
from tests.cad.drawn_bodies import TOWER, WHEEL, design
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rigs") / "rig.yaml"
    path.write_text(virtual_rig(1))
    return path


def test_the_default_times_of_heating_are_allowed_by_the_rig_of_the_template(template: Path) -> None:
    rig = Rig.load(template)
    for period, heating in defaults.PRINTED_TIMINGS:
        for phase in (0.0, 0.5):  # both motors at once, too
            compile_schedule(Gait(period, np.array([0.0, phase]), np.full(2, heating / period)), rig)


def test_without_a_rig_the_springs_are_those_of_the_template(template: Path) -> None:
    usual, known = make_workshop(), make_workshop(template)
    assert usual.springs.current(0.0) == pytest.approx(known.springs.current(0.0), rel=1e-3)
    assert usual.printed == known.printed and usual.motors == known.motors == defaults.PRINTED_MOTORS
    assert set(usual.timings) <= set(known.timings)


def test_a_rig_with_tighter_limits_allows_less() -> None:
    tight = rig_with(limits={"max_on_s": 5.2})
    found = allowed_timings(tight)
    assert found and all(t.heating <= 5.2 + 1e-9 for t in found)
    for t in found:
        compile_schedule(Gait(t.period, np.array([0.0, 0.5]), np.full(2, t.heating / t.period)), tight)
    with pytest.raises(LimitError):
        compile_schedule(Gait(20.0, np.array([0.0, 0.5]), np.full(2, 0.3)), tight)


def test_the_build_filter_refuses() -> None:
    given = make_workshop()
    printer = load_printer()
    for body in (design(*TOWER).morphology, design(*WHEEL).morphology):
        kinds = [
            v.kind for v in check(body, load_specification(), printer).violations if v.severity != "note"
        ]
        assert given.rejection_reason(body) == (kinds[0] if kinds else "")
    assert given.rejection_reason(design(*WHEEL).morphology)


def test_a_missing_rig_is_named(tmp_path: Path) -> None:
    with raises(InputError, "file.missing", match=r"rig\.yaml"):
        make_workshop(tmp_path / "rig.yaml")
