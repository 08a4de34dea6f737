"""Packets of robots without a motor and with a ballast, and whom their pages are for."""

import csv
import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait, read_gait
from eldir.built.robot import build, static_margin
from eldir.design import Ballast, Design, Variant, marked_masses
from eldir.errors import InputError
from eldir_app.commands.packet import packet as command
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.folder import apply_variant, write_packet
from eldir_hardware.markers.placement import placement_files
from tests.cad.drawn_bodies import BLOCK, design
from tests.raised import raises

SPEC = fit_to_printer(load_specification(), load_printer())
ROBOT = design(*BLOCK, motors=(3, 20))


@pytest.fixture(scope="module")
def control(tmp_path_factory):
    """The paper's control robot, and the pages of its packet: one motor replaced by a passive spring, 9 g in
    front."""
    path, pages = tmp_path_factory.mktemp("packets") / "control", []
    robot = replace(ROBOT, provenance={"generation": 3, "id": 24})
    variant = Variant(0, Ballast.parse("9g@front", ROBOT.morphology))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eldir_cad.packet.folder.pdf", lambda figures: pages.extend(figures) or b"")
        return path, write_packet(robot, path, variant=variant), pages


def test_every_page_says_which_robot_it_is_for(control):
    path, _, pages = control
    digest = hashlib.sha256((path / "design.json").read_bytes()).hexdigest()
    assert len(pages) == 3 + 1 + 6, "assembly, traveller, kit"
    for page in pages:
        assert f"robot 24 of generation 3; design.json {digest[:12]}; " in page.texts[-1].get_text()


def test_the_papers_control_robot(control):
    path, made, _ = control
    ballast = Ballast.parse("9g@front", ROBOT.morphology)
    built = Design.load(path / "design.json")
    found, was = built.morphology, ROBOT.morphology
    assert found.motors == 1
    assert np.flatnonzero(found.active) == np.flatnonzero(was.active)[1]
    np.testing.assert_array_equal(built.controller.w2, ROBOT.controller.w2[1:])
    assert made.manifest.to_json()["variant"] == {
        "without_motor": 0,
        "ballast": {"grams": 9.0, "mass": ballast.mass},
    }
    assert was.positions[ballast.mass, 0] == was.positions[:, 0].max()
    assert built.variant.to_json() == made.manifest.to_json()["variant"]
    assert list(made.manifest.marks.values()) == built.marks.tolist() == ROBOT.marks.tolist()
    heavier = build(found, ballast=built.ballast / 2).masses - build(found).masses
    assert heavier[ballast.mass] == pytest.approx(4.5e-3) == heavier.sum()
    (row,) = [
        r for r in csv.DictReader((path / "bom.csv").read_text().splitlines()) if r["part"] == "ballast"
    ]
    holder = made.manifest.to_json()["parts"]["ballast_holder"]
    shot = float(row["purpose"].split("shot, ")[1].split(" g")[0])
    assert row["count"] == "2" and holder["count"] == 2
    assert 2 * (shot + holder["weight_g"]) == pytest.approx(9.0, abs=0.02)
    assert made.manifest.clearance.tightest_mm == pytest.approx(SPEC.clearance, rel=0.02)
    assert made.manifest.parts["passive_spring"].count == 2 * (len(was.springs) - 1)


def test_the_build_filter_knows_the_ballast(control):
    """Report and page of findings: the centre of mass is that of the robot with the weight."""
    path, made, pages = control
    built = Design.load(path / "design.json")
    robot = build(built.morphology, ballast=built.ballast / 2)
    assert made.report.figures["static_margin_mm"] == pytest.approx(1e3 * static_margin(robot))
    (page,) = [p for p in pages if p.texts and p.texts[0].get_text() == "Findings of the build filter"]
    (centre,) = [line.get_xydata() for line in page.axes[0].lines if line.get_marker() == "P"]
    expected = robot.masses @ built.morphology.positions / robot.masses.sum()
    np.testing.assert_allclose(centre, [expected])


def test_a_packet_of_a_packets_design_is_that_of_the_same_robot(control, tmp_path):
    """With the same weights and without the same motor, whether its variant is given again or not."""
    path, made, _ = control
    built = Design.load(path / "design.json")
    assert apply_variant(built, made.manifest.variant) == built
    again = write_packet(built, tmp_path / "again")
    for name in ("variant", "parts", "marks", "totals"):
        assert again.manifest.to_json()[name] == made.manifest.to_json()[name]
    for name in ("design.json", "parts/ballast_holder.stl", "bom.csv"):
        assert (again.path / name).read_bytes() == (path / name).read_bytes()


def test_a_changed_robot_is_not_changed_again(control, tmp_path):
    path, *_ = control
    built = Design.load(path / "design.json")
    for other in (Variant(None, Ballast(9.0, 4)), Variant(0), replace(built.variant, without_motor=None)):
        with raises(InputError, "design.has-variant", match="without motor 0, with 9 g on mass"):
            write_packet(built, tmp_path / "packet", variant=other)
    assert list(tmp_path.iterdir()) == []


def test_a_ballast_hides_no_disc_and_suits_its_holder(tmp_path):
    for text, code, key, said in (
        (f"9g@{ROBOT.marks[2]}", "ballast.hides-disc", None, "found m3"),
        ("1g@front", "input.wrong-value", "ballast", "two holders"),
    ):
        variant = Variant(None, Ballast.parse(text, ROBOT.morphology))
        with raises(InputError, code, key, match=said):
            write_packet(ROBOT, tmp_path / "packet", variant=variant)
    assert list(tmp_path.iterdir()) == []


def test_marks_stay_where_they_are_without_a_motor(tmp_path):
    """In a tower whose motors are far apart, the five nearest masses would be others with one of them."""
    tower = design(*["1110"] * 6, motors=(0, 33))
    for motor in (0, 1):
        built = apply_variant(tower, Variant(motor))
        assert built.marks.tolist() == tower.marks.tolist() != marked_masses(built.morphology).tolist()
        built.save(tmp_path / "built.json")
        assert Design.load(tmp_path / "built.json").marks.tolist() == tower.marks.tolist()
    moved = json.loads((tmp_path / "built.json").read_text())
    moved["marks"] = [0, 99]
    (tmp_path / "built.json").write_text(json.dumps(moved))
    with raises(InputError, "design.inconsistent", "marks"):
        Design.load(tmp_path / "built.json")


@pytest.mark.parametrize(
    ("text", "key"),
    [(text, "ballast") for text in ("9", "9kg@front", "g@front", "9g@top", "-1g@front")]
    + [("0g@front", "weight of the ballast"), ("900g@front", "weight of the ballast")]
    + [("9g@99", "mass of the ballast")],
)
def test_ballasts_that_cannot_be(text, key):
    with raises(InputError, "input.wrong-value", key):
        Ballast.parse(text, ROBOT.morphology)


def test_the_least_ballast_is_told():
    with raises(
        InputError,
        "input.wrong-value",
        "weight of the ballast",
        match="more than 0 and at most 100 g; found 0 g",
    ):
        Ballast.parse("0g@rear", ROBOT.morphology)


def test_a_gait_is_that_of_the_motors_left_and_no_walk_of_the_evolved_robot_is_kept():
    gait = Gait(24.0, np.array([0.0, 0.4]), np.array([0.2, 0.25]), "evolved")
    walks = {"predicted": {}, "evolved_walk": {"expected": 1.0, "standard_error": 0.1, "samples": 16}}
    robot = replace(ROBOT, provenance={"id": 24, "gait": gait.to_json(), **walks})
    for motor, phase, duty in ((0, [0.4], [0.25]), (1, [0.0], [0.2]), (None, [0.0, 0.4], [0.2, 0.25])):
        built = apply_variant(robot, Variant(motor, Ballast.parse("9g@front", ROBOT.morphology)))
        assert built.provenance.keys() == {"id", "gait"}
        assert read_gait(built) == Gait(24.0, np.array(phase), np.array(duty), "evolved")
    assert apply_variant(robot, Variant()).provenance == robot.provenance


def test_markers_are_drawn_on_the_robot_that_is_built(tmp_path):
    """As for the design of the packet, not as for the one with all motors."""
    ROBOT.save(tmp_path / "design.json")
    command(tmp_path / "design.json", tmp_path / "packet", without_motor=0)
    built = Design.load(tmp_path / "packet" / "design.json")
    drawn = (tmp_path / "packet" / "markers.pdf").read_bytes()
    assert built.morphology.motors == 1
    assert drawn == placement_files(built, 1e-3 * SPEC.scale)["markers.pdf"]
    assert drawn != placement_files(ROBOT, 1e-3 * SPEC.scale)["markers.pdf"]


def test_a_motor_that_is_not_there():
    with raises(InputError, "input.wrong-value", "without_motor", match="0 to 1; found 2"):
        apply_variant(ROBOT, Variant(2))


def test_without_the_only_motor_nothing_is_built(tmp_path):
    with raises(InputError, "design.not-buildable", match="no active spring"):
        write_packet(design(*BLOCK), tmp_path / "packet", variant=Variant(0))
    assert list(tmp_path.iterdir()) == []
