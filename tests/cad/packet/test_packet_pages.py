"""The packet's pages and tables say what is there: seen from the right side, as often as it is needed."""

import csv
import io
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from eldir.built.robot import build
from eldir.core.pictures import png
from eldir.design import Ballast, Variant
from eldir.parameters.wiring import FACES, wiring
from eldir_cad.checks.contacts import Lead
from eldir_cad.checks.violations import BuildReport, Violation
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._drawing import draw_assembly_map
from eldir_cad.packet._kit import draw_kit
from eldir_cad.packet._pages import draw_findings, draw_order_of_work, draw_traveller
from eldir_cad.packet._tables import bill_of_materials, wiring_table
from eldir_cad.packet.manifest import make_content
from eldir_cad.packet.shopping import parts_to_buy
from eldir_cad.packet.wiring_file import read_wiring
from tests.cad.drawn_bodies import BLOCK, HOURGLASS, WHEEL, body, design

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
GRAMS = 11.0
PICTURE = png(Figure(figsize=(1, 1)))


@pytest.fixture(scope="module")
def content():
    """A wheel with two motors and a ballast, on a printer whose two times of washing are unlike."""
    wash = PRINTER.wash.model_copy(update={"on_plate_min": 3.5, "off_plate_min": 8.0})
    printer = PRINTER.model_copy(update={"wash": wash})
    robot, ballast = design(*WHEEL, motors=(0, 4)), Variant(None, Ballast(GRAMS, 6))
    report = BuildReport.of((), {})
    return make_content(replace(robot, variant=ballast), report, SPEC, printer)


def words(pages):
    return " ".join(" ".join(text.get_text() for page in pages for text in page.texts).split())


def test_two_motors_need_a_coil_on_each_face_for_each(content):
    rows = {
        r["part"]: r for r in csv.DictReader(io.StringIO(bill_of_materials(content, parts_to_buy(content))))
    }
    assert rows["shape_memory_spring"]["count"] == "4"
    assert rows["spring_end"]["count"] == "8", "both ends of each coil"
    assert len(wiring(2)) == 4, "and each coil has its channel"


def test_parts_are_washed_as_long_as_the_printer_says_before_and_after_they_leave_the_plate(content):
    told = words(draw_traveller(content))
    assert f"Wash on the build plate: 3.5 min in {PRINTER.wash.solvent}" in told
    assert f"off the plate; wash 8 min in {PRINTER.wash.rinse}" in told
    assert "At most 3.6 A, with the fan on, pulses of 6 s every 30 s and a cut-off of 6.3 s" in told


def test_findings_that_fill_the_traveller_continue_on_another_page(content):
    """A robot of 33 masses had five findings, of which the last lay over the footer."""
    findings = [
        Violation("hinge", "note", (), 2.0, "parts", 8 * "a part of the body ", "") for _ in range(12)
    ]
    figures = draw_traveller(replace(content, report=BuildReport.of(findings, {})))
    assert len(figures) == 2
    for figure in figures:
        figure.draw_without_rendering()
        assert min(text.get_window_extent().y0 for text in figure.texts) > 0.02 * figure.bbox.height
    assert words(figures).count("note: ") == 12


def test_the_printing_time_is_that_of_the_layers_of_all_plates(content):
    assert "not in the printer's profile (layer_s)" in words(draw_kit(content, wiring(2), 100))
    timed = replace(content, printer=content.printer.model_copy(update={"layer_s": 9.0}))
    layers = sum(round(plate.height / 0.05) for plate in content.plates)
    assert f"all plates take {layers * 9 / 3600:.1f} h" in words(draw_kit(timed, wiring(2), 100))


def test_the_order_of_work_tells_the_ballast_of_both_holders_together(content):
    told = words(draw_order_of_work(content, wiring(2), PICTURE))
    shot, whole = map(float, re.search(r"glue ([\d.]+) g of .* each, ([\d.]+) g with", told).groups())
    holder = content.assembly.parts["ballast_holder"].volume * 1e-3 * PRINTER.material.density
    assert whole == pytest.approx(2 * (shot + holder), abs=0.02)
    assert whole == GRAMS


def test_springs_in_series_share_a_channel_on_all_pages(content, tmp_path):
    in_series = wiring(2, in_series=True)
    assert "join one lead of the front coil" in words(draw_order_of_work(content, in_series, PICTURE))
    assert "join one lead" not in words(draw_order_of_work(content, wiring(2), PICTURE))
    labels = [
        [t.get_text() for t in axes.texts if t.get_text().startswith("S")]
        for axes in draw_assembly_map(content.assembly, in_series).axes[:2]
    ]
    assert labels == [["S0 / 1", "S1 / 2"]] * 2
    leads = [Lead(motor, 0, 1.0, "strip", 100.0) for motor in range(2)]
    (tmp_path / "wiring.csv").write_text(wiring_table(content, in_series, leads))
    assert read_wiring(tmp_path) == in_series


def test_the_map_of_the_back_is_mirrored_as_the_robot_is_from_there():
    """Who walks around the robot sees its foremost mass on the other side, and no mass higher or lower."""
    made = assemble(body(*BLOCK), SPEC)
    figure = draw_assembly_map(made, wiring(1))
    front, back = (
        {int(t.get_text()): t.get_position() for t in axes.texts if t.get_text().isdigit()}
        for axes in figure.axes[:2]
    )
    assert [axes.get_title().split()[0] for axes in figure.axes[:2]] == list(FACES)
    assert "travel to the right" in figure.axes[0].get_title()
    assert "travel to the left" in figure.axes[1].get_title()
    foremost = int(made.centres[:, 0].argmax())
    assert max(front, key=lambda mass: front[mass][0]) == foremost
    assert min(back, key=lambda mass: back[mass][0]) == foremost
    assert len(front) == len(back) == len(made.centres)
    for (x, y), (seen_x, seen_y) in zip(front.values(), back.values(), strict=True):
        assert (seen_x, seen_y) == (pytest.approx(-x), pytest.approx(y))


@pytest.mark.parametrize("face", FACES)
def test_the_numbers_of_both_faces_can_be_read_from_outside(face):
    """A 7, cut through its engraving: one bar at its top, one along its right, above its lines."""
    made = assemble(body(*BLOCK), SPEC, marks=np.array([0]))
    (place,) = (p for p in made.placements if p.part == f"mass_07_{face}")
    plane = made.parts[place.part].solid.slice(SPEC.mass.engraving_depth / 2)
    holes = []
    for contour in plane.to_polygons():
        x, y = np.asarray(contour).T
        if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() < 0:  # clockwise: not the outline of the mass
            world = np.column_stack([x, y, np.zeros(len(x))]) @ place.rotation.T
            # From behind, +x of the world is to the left.
            holes.append(world[:, :2] * [1 if face == "front" else -1, 1])
    *lines, digit = sorted(holes, key=lambda corners: np.ptp(corners[:, 1]))
    assert len(lines) == FACES.index(face) + 1, "one under the numbers of the front, two under the back's"
    assert max(line[:, 1].max() for line in lines) < digit[:, 1].min()
    (left, bottom), (right, top) = digit.min(axis=0), digit.max(axis=0)
    assert top - bottom == pytest.approx(SPEC.mass.digit_height + SPEC.mass.stroke, abs=1e-6)
    assert right - left > 1.5 * SPEC.mass.stroke
    assert digit[digit[:, 0] < (left + right) / 2, 1].min() == pytest.approx(top - SPEC.mass.stroke, abs=1e-6)
    assert digit[digit[:, 1] < (bottom + top) / 2, 0].min() >= right - SPEC.mass.stroke - 1e-6


def test_a_cross_is_on_the_faulty_masses_alone():
    hourglass = body(*HOURGLASS)
    fault = Violation("crowded", "unfit", ("mass 3 front", "mass 1"), 1.0, "mm", "too near", "move it")
    hinge = Violation("hinge", "note", ("mass 2",), 1.0, "", "it turns", "look")
    axes = draw_findings(hourglass, build(hourglass), BuildReport.of((fault, hinge), {})).axes[0]
    at = {line.get_marker(): line.get_xydata() for line in axes.lines}
    assert at["X"].tolist() == hourglass.positions[[1, 3]].tolist()


def test_seats_are_drawn_on_the_front_face_alone_and_every_sign_is_in_the_legend():
    made = assemble(body(*BLOCK), SPEC)
    front, back, legend = draw_assembly_map(made, wiring(1)).axes
    rings = [[patch for patch in axes.patches if isinstance(patch, Circle)] for axes in (front, back)]
    assert [len(circles) for circles in rings] == [len(made.marks), 0]
    told = " ".join(text.get_text() for text in legend.texts)
    for sign in (
        "connector",
        "cap",
        "seat of a disc",
        "passive spring",
        "shape-memory spring",
        "relay channel",
    ):
        assert sign in told


@pytest.mark.parametrize(("rows", "beside"), [(["11111111"], False), (["1110"] * 6, True)])
def test_a_long_body_has_its_faces_above_each_other_and_a_high_one_beside(rows, beside):
    front, back, _ = draw_assembly_map(assemble(body(*rows), SPEC), wiring(1)).axes
    places = [axes.get_position() for axes in (front, back)]
    level, above = (np.isclose(*(getattr(place, edge) for place in places)) for edge in ("y0", "x0"))
    assert (level, above) == (beside, not beside)


def test_supports_are_left_to_the_slicer_which_is_told_where(content):
    told = words(draw_traveller(content))
    assert "The plates have no supports: let the slicer add them, " in told
    assert "4 and 37.3 mm above the plate: connector" in told
