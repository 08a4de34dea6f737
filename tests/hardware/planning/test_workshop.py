"""The conditions under which robots evolve for building are those of the parts and of the rig."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldir import defaults
from eldir.built.gait import Gait
from eldir.errors import InputError
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.lattice import Lattice
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_app import evolution_run
from eldir_cad.checks.buildability import check
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import Specification, load_specification
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.planning.workshop import allowed_timings, make_workshop
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.safety.limits import LimitError
from tests.cad.drawn_bodies import TOWER, WHEEL, design
from tests.eldir.evolution.printed.small_searches import SMALL
from tests.eldir.random_design import make_design
from tests.hardware.rigs_and_schedules import rig_with
from tests.raised import raises

UNSTATED: dict[str, Any] = dict.fromkeys(f.name for f in fields(evolution_run.NewRunOptions)) | {
    "objective": "printed",
    "terrain": "flat",
    "seed": 0,
}


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


def test_a_new_run_has_the_tolerances_of_its_rig(tmp_path: Path, template: Path) -> None:
    """And without a rig, or with the template's, none in its file."""
    rig = rig_with(tolerances={"current": 0.02, "ambient_min_c": 21, "ambient_max_c": 24})
    (tmp_path / "rig.yaml").write_bytes(rig.source)
    for number, file in enumerate((None, template, tmp_path / "rig.yaml")):
        options = evolution_run.NewRunOptions(**UNSTATED | {"rig": file})
        evolution_run.create_printed_run(tmp_path / f"run{number}", options)
        run = PrintedRun.open(tmp_path / f"run{number}")
        known = run.config.to_json().get("tolerances")
        assert run.config.tolerances == (RigTolerances() if number < 2 else rig.spring_tolerances())
        assert known == (None if number < 2 else rig.spring_tolerances().to_json())


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


CLOSE = make_design(0, Lattice(3, 6)).morphology
"""A body whose kit coil just clears the strips beside it."""


def test_the_build_filter_has_the_coil_of_the_rig(tmp_path: Path) -> None:
    """At once, and in a run that is resumed without the rig file: a body that the kit's coil clears is
    refused for one of 13 mm and 1.5 mm wire that extends to 90 mm."""
    wide = {"coil_diameter_mm": 13.0, "wire_diameter_mm": 1.5, "hot_length_mm": 90.0, "resistance_ohm": 0.49}
    (tmp_path / "rig.yaml").write_bytes(rig_with(springs=wide).source)
    conditions = make_workshop(tmp_path / "rig.yaml")
    assert make_workshop().rejection_reason(CLOSE) == ""
    assert conditions.rejection_reason(CLOSE) == "collision"
    config = replace(SMALL, springs=conditions.springs, printed=conditions.printed)
    for springs, reason in ((config.springs, "collision"), (make_workshop().springs, "")):
        run = PrintedRun.create(tmp_path / f"run{reason}", replace(config, springs=springs))
        (rejection_reason,) = evolution_run._conditions(run)
        assert rejection_reason(CLOSE) == reason


def test_other_coils_are_checked_as_those_of_a_parts_file() -> None:
    printer, kit = load_printer(), load_specification()
    longer = kit.model_dump() | {"coil": kit.coil.model_dump() | {"outer_diameter": 8.0, "hot_length": 66.0}}
    springs = replace(SpringParameters(), coil_diameter=7.25e-3, hot_length=81e-3)
    spec = kit.with_coil(springs)
    assert spec == Specification.model_validate(longer)
    found = check(CLOSE, kit, printer, springs)
    assert found.figures["collisions"] == check(CLOSE, spec, printer).figures["collisions"]
    wire = np.pi / 4 * 0.75e-3**2 * np.pi * 0.75e-3 * 26.7 * 6450
    heavier = found.figures["robot_g"] - check(CLOSE, kit, printer).figures["robot_g"]
    assert heavier == pytest.approx(2 * 1e3 * wire, abs=0.011), "two coils"


def test_the_kits_springs_leave_the_parts_and_the_report_as_they_are() -> None:
    printer = load_printer()
    spec = fit_to_printer(load_specification(), printer)
    for springs in (SpringParameters(), make_workshop().springs, rig_with().spring_parameters()):
        assert spec.with_coil(springs) == spec
        for body in (CLOSE, design(*TOWER).morphology):
            assert check(body, spec, printer, springs) == check(body, spec, printer)
