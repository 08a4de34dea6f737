"""The build filter on bodies whose freedoms, strokes and faults are known by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

from eldir.built.robot import build, count_mechanisms
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.buildability import check
from eldir_cad.checks.contacts import find_contacts, find_leads
from eldir_cad.checks.kinematics import (
    AT_REST,
    Stroke,
    degrees_of_freedom,
    find_hinges,
    find_mechanisms,
    foot_stroke,
    max_shortening,
    rigidity_matrix,
    simulate_stroke,
    socket_turns,
)
from eldir_cad.checks.strip_law import StripLaw
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._pages import draw_findings
from tests.cad.drawn_bodies import BLOCK, HOURGLASS, RHOMBUS, TOWER, TRIANGLE, WHEEL, body
from tests.raised import raises

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
LAW = StripLaw.of(SPEC, PRINTER)
WIDE_COIL = SPEC.model_copy(update={"coil": SPEC.coil.model_copy(update={"outer_diameter": 9.0})})


@pytest.mark.parametrize(
    ("positions", "springs", "expected"),
    [
        ([[0, 0], [1, 0], [0, 1]], [[0, 1], [0, 2], [1, 2]], 0),
        ([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [0, 3]], 1),
        ([[0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1], [1, 2], [2, 3], [0, 3], [0, 2]], 0),
        ([[0, 0], [1, 0], [3, 1]], [[0, 1], [1, 2]], 1),
        # Three masses in a line, all joined: stiff in general position, loose in this one.
        ([[0, 0], [1, 0], [2, 0]], [[0, 1], [1, 2], [0, 2]], 1),
        ([[0, 0], [1, 0], [2, 0], [3, 1], [4, 0]], [[0, 1], [1, 2], [2, 3], [3, 4]], 3),
    ],
)
def test_degrees_of_freedom_of_hand_made_frames(positions, springs, expected):
    assert degrees_of_freedom(np.array(positions, float), np.array(springs)) == expected


@pytest.mark.parametrize(
    ("rows", "expected"),
    [(TRIANGLE, 0), (RHOMBUS, 0), (WHEEL, 0), (HOURGLASS, 1), (TOWER, 2), (BLOCK, 0)],
)
def test_degrees_of_freedom_of_bodies(rows, expected):
    found = body(*rows)
    assert degrees_of_freedom(found.positions, found.springs) == expected
    assert count_mechanisms(found.positions, found.springs) == expected


def test_degrees_of_freedom_without_motors():
    rhombus = body(*RHOMBUS)
    shared = next(
        i
        for i, (a, b) in enumerate(rhombus.springs)
        if np.bincount(rhombus.springs.ravel())[[a, b]].min() == 3
    )
    assert degrees_of_freedom(rhombus.positions, np.delete(rhombus.springs, shared, axis=0)) == 1
    wheel = body(*WHEEL)
    hub = int(np.bincount(wheel.springs.ravel()).argmax())
    spokes = (wheel.springs == hub).any(axis=1)
    assert degrees_of_freedom(wheel.positions, np.delete(wheel.springs, 0, axis=0)) == 0  # one spare
    rim = wheel.springs[~spokes]
    others = np.delete(np.arange(7), hub)
    # Six bars in a ring.
    assert degrees_of_freedom(wheel.positions[others], np.searchsorted(others, rim)) == 3


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_freedoms_of_random_bodies(seed):
    lattice = Lattice(6, 11)
    found = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), 2)[0])
    here, general = (
        degrees_of_freedom(found.positions, found.springs),
        count_mechanisms(found.positions, found.springs),
    )
    assert here >= general >= max(0, 2 * len(found.positions) - 3 - len(found.springs))
    less = degrees_of_freedom(found.positions, found.springs[~found.active])
    assert here <= less <= here + found.motors
    # Each mass that alone holds two parts lets them turn.
    assert general >= sum(h.separates for h in find_hinges(found))


def test_rigidity_matrix_is_the_derivative_of_lengths():
    found = body(*WHEEL)
    a, b = found.springs.T

    def lengths(x):
        return np.linalg.norm(x.reshape(-1, 2)[a] - x.reshape(-1, 2)[b], axis=1)

    x, step = found.positions.ravel(), 1e-6
    numeric = np.stack(
        [(lengths(x + step * e) - lengths(x - step * e)) / (2 * step) for e in np.eye(len(x))], axis=1
    )
    np.testing.assert_allclose(rigidity_matrix(found.positions, found.springs), numeric, atol=1e-8)


def test_hinges():
    assert find_hinges(body(*WHEEL)) == []
    (hinge,) = find_hinges(body(*HOURGLASS))
    assert (hinge.parts, hinge.separates) == (2, True)
    assert [h.separates for h in find_hinges(body(*TOWER))] == [True, True]
    (held,) = find_hinges(body("01111", "01101", "01101", "00111"))  # a ring, closed by a vertex on one side
    assert (held.parts, held.separates) == (2, False)


def test_a_free_rhombus_follows_its_motor():
    """The motor is the short diagonal: it reaches its free lengths, and the other follows the circle."""
    rhombus = body(*RHOMBUS, motors=(2,))
    degree = np.bincount(rhombus.springs.ravel())
    shared = int(np.flatnonzero((degree[rhombus.springs] == 3).all(axis=1))[0])
    rhombus = body(*RHOMBUS, motors=(shared,))
    motion = simulate_stroke(rhombus, SPEC, LAW)
    a, b = rhombus.springs[shared]
    tips = np.flatnonzero(degree == 2)
    for pose, diagonal in zip(motion.poses[[2, 5]], SPEC.motor_range, strict=True):
        assert np.linalg.norm(pose[a] - pose[b]) == pytest.approx(diagonal, abs=0.7)
        across = 2 * np.sqrt(SPEC.pitch**2 - (np.linalg.norm(pose[a] - pose[b]) / 2) ** 2)
        assert np.linalg.norm(np.subtract(*pose[tips])) == pytest.approx(across, abs=0.05)
    assert max_shortening(motion, rhombus)[~rhombus.active].max() < 0.05


def test_a_stiff_wheel_holds_its_motor():
    moves = np.abs(simulate_stroke(body(*WHEEL), SPEC, LAW).poses - at_pitch(body(*WHEEL))).max()
    assert moves < 0.1
    # What does not yield moves as the force of the hot coil, by the third power of its diameter.
    softer = np.abs(simulate_stroke(body(*WHEEL), WIDE_COIL, LAW).poses - at_pitch(body(*WHEEL))).max()
    assert softer == pytest.approx(moves * (6.5 / 8.25) ** 3, rel=0.02)


def moved(found, pose, label="with S0 hot"):
    """A stroke that goes to one pose."""
    return Stroke(at_pitch(found), np.array([pose]), (label,))


def at_pitch(found):
    return (found.positions - found.positions.min(axis=0)) * SPEC.scale


def test_contacts_are_measured_between_surfaces():
    wheel = body(*WHEEL)
    rest = at_pitch(wheel)
    assert find_contacts(moved(wheel, rest), wheel, SPEC) == []
    i = int(np.argmin(rest[:, 0]))
    j = int(np.argmax(rest[:, 0]))
    near = rest.copy()
    near[j] = rest[i] + [0, -10.0]
    (first, *_) = [
        c for c in find_contacts(moved(wheel, near), wheel, SPEC) if c.parts == (f"mass {i}", f"mass {j}")
    ]
    assert first.gap == pytest.approx(10 - 2 * SPEC.mass.across_flats / np.sqrt(3))
    assert first.pose == "with S0 hot"


@pytest.mark.parametrize("angle", [30, 33, 36, 60])
def test_a_coil_and_the_strip_beside_it_at_one_mass(angle):
    """The coil begins 7.5 mm from the mass; at an angle of less than 34 degrees it meets the strip."""
    triangle = body(*TRIANGLE, motors=(0,))
    (a, b), (c, d) = triangle.springs[0], triangle.springs[1]
    (corner,) = {a, b} & {c, d}
    motor, strip = ({a, b} - {corner}).pop(), ({c, d} - {corner}).pop()
    pose = at_pitch(triangle)
    pose[motor] = pose[corner] + [SPEC.pitch, 0]
    pose[strip] = pose[corner] + SPEC.pitch * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    gap = SPEC.coil_seat * np.sin(np.radians(angle)) - (7.25 + 1) / 2
    found = find_contacts(moved(triangle, pose), triangle, SPEC)
    assert [c.gap for c in found] == ([] if gap >= SPEC.clearance else [pytest.approx(gap)])


def test_contacts_at_rest_come_first_and_say_so():
    """Coils so wide that they touch at rest: 7.6 beside 7.5 mm apart."""
    wide = SPEC.model_copy(update={"coil": SPEC.coil.model_copy(update={"outer_diameter": 7.6})})
    triangle = body(*TRIANGLE, motors=(0, 1))
    (contact,) = find_contacts(moved(triangle, at_pitch(triangle)), triangle, wide)
    assert contact.pose == AT_REST and contact.gap == pytest.approx(7.5 - 7.6)


def test_leads_leave_beside_their_masses():
    wheel = body(*WHEEL, motors=(0, 5))
    found = find_leads(moved(wheel, at_pitch(wheel)), wheel, SPEC)
    assert [(lead.motor, lead.mass) for lead in found] == [
        (m, mass) for m, spring in enumerate(wheel.springs[wheel.active].tolist()) for mass in spring
    ]
    assert min(lead.clearance for lead in found) > SPEC.clearance
    rest = at_pitch(wheel)
    first = found[0]
    other = wheel.springs[wheel.active][0].sum() - first.mass
    hole = rest[first.mass] + SPEC.guide_at * (rest[other] - rest[first.mass]) / SPEC.pitch
    assert first.length == pytest.approx(rest[:, 1].max() - hole[1])
    # A mass put over the hole leaves no room.
    far = int(np.linalg.norm(rest - hole, axis=1).argmax())
    rest[far] = hole
    blocked = find_leads(moved(wheel, rest), wheel, SPEC)[0]
    assert blocked.nearest == f"mass {far}"
    assert blocked.clearance == pytest.approx(-12 / np.sqrt(3) - SPEC.fitting.wire_guide / 2)


def test_turns_in_the_sockets_are_what_the_mass_cannot_take_up():
    """The springs of a corner open by ten degrees: the mass turns by half, each socket takes the rest."""
    triangle = body(*TRIANGLE)
    rest = at_pitch(triangle)
    corner, one, other = 0, 1, 2
    pose = rest.copy()
    c, s = np.cos(np.radians(10)), np.sin(np.radians(10))
    pose[one] = rest[corner] + np.array([[c, -s], [s, c]]) @ (rest[one] - rest[corner])
    turns = np.degrees(socket_turns(moved(triangle, pose), triangle))
    assert turns[corner] == pytest.approx(5.0)
    rigid = (rest - rest[0]) @ np.array([[c, s], [-s, c]]) + rest[0]
    assert socket_turns(moved(triangle, rigid), triangle) == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(pose[other] - rest[other]) == 0


@pytest.mark.parametrize(("rows", "free"), [(WHEEL, 0), (HOURGLASS, 1), (TOWER, 2)])
def test_mechanisms_change_no_length_and_hold_nothing_rigid(rows, free):
    found = body(*rows)
    motions = find_mechanisms(found.positions, found.springs)
    assert len(motions) == free
    matrix = rigidity_matrix(found.positions, found.springs)
    for motion in motions:
        assert matrix @ motion.ravel() == pytest.approx(0, abs=1e-9)
        assert motion.sum(axis=0) == pytest.approx([0, 0], abs=1e-9)
        x, y = (found.positions - found.positions.mean(axis=0)).T
        assert x @ motion[:, 1] - y @ motion[:, 0] == pytest.approx(0, abs=1e-9)
    flat = motions.reshape(free, 2 * len(found.positions))
    assert flat @ flat.T == pytest.approx(np.eye(free))


def test_the_drawing_shows_every_way_to_fold():
    hourglass = body(*HOURGLASS)
    figure = draw_findings(hourglass, build(hourglass), check(hourglass, SPEC, PRINTER))
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:2] == ["hinges, feet and faults", "folds with all springs (1 of 1)"]
    arrows = figure.axes[1].collections[-1]
    lengths = np.hypot(arrows.U, arrows.V)
    # One triangle turns about the mass that both share, the other stands still.
    assert sorted(lengths)[:3] == pytest.approx([0, 0, 0], abs=2e-3)
    assert min(sorted(lengths)[3:]) > 0.02


def test_a_ballast_moves_the_centre_of_mass():
    """By its weight over that of the robot. Higher up it makes the robot tip earlier."""
    block, grams = body(*BLOCK), 45.0
    bare, robot = check(block, SPEC, PRINTER).figures, build(block)
    plane, (x, y) = 1e3 * robot.masses.sum(), 1e3 * robot.positions.T
    centre = 1e3 * (robot.masses @ robot.positions) / robot.masses.sum()
    front, top = int(np.lexsort((y, -x))[0]), int(np.argmax(y))
    for mass in (front, top):
        ballast = np.zeros(len(x))
        ballast[mass] = 1e-3 * grams / 2
        loaded = check(block, SPEC, PRINTER, ballast=ballast).figures
        moved = (robot.positions[mass] * 1e3 - centre) * (grams / 2) / (plane + grams / 2)
        feet = x[y < 1e-6]
        margin = min(centre[0] + moved[0] - feet.min(), feet.max() - centre[0] - moved[0])
        assert loaded["static_margin_mm"] == pytest.approx(margin, abs=1e-6) != bare["static_margin_mm"]
        height = SPEC.outside / np.tan(np.radians([loaded["tipping_angle_deg"], bare["tipping_angle_deg"]]))
        assert height[0] - height[1] == pytest.approx(moved[1], abs=1e-4)


def test_feet_that_the_motors_move():
    rest = np.array([[0, 0], [50, 0], [25, 43.0]])
    pose = np.array([[-3, 0], [51, 0], [25, 42.0]])
    assert foot_stroke(Stroke(rest, pose[None], ("",))) == pytest.approx(4.0)
    assert foot_stroke(Stroke(rest[1:], pose[None, 1:], ("",))) == 0.0


def test_a_body_outside_the_workspace_is_refused():
    lattice = Lattice(13, 22)
    big = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(1), 2)[0])
    report = check(big, SPEC, PRINTER)
    assert not report.buildable
    with raises(
        InputError, "design.not-buildable", match=r"13 x \d+ triangles.*workspace is 6 x 11.*--lattice 6x11"
    ):
        report.require_buildable()


def test_the_workspace_itself_fits():
    lattice = Lattice(6, 11)
    full = body(*["1" * 11] * 6)
    assert len(full.positions) == len(lattice.vertices)
    assert check(full, SPEC, PRINTER).buildable


@pytest.mark.parametrize(("motors", "message"), [((), "no active spring"), ((0, 1, 2), "3 active springs")])
def test_motors_are_counted(motors, message):
    report = check(body(*WHEEL, motors=motors), SPEC, PRINTER)
    assert [v.kind for v in report.violations] == ["motors"]
    with raises(InputError, "design.not-buildable", match=message):
        report.require_buildable()


def test_what_is_told_of_a_tower_of_triangles():
    report = check(body(*TOWER), SPEC, PRINTER)
    kinds = [v.kind for v in report.violations]
    assert report.buildable and not report.fit
    assert "mechanism" in kinds and "hinge" in kinds
    assert all(v.remedy and v.parts and v.amount > 0 for v in report.violations)
    # Strips that are clamped hold what pins let fold: then it is only told.
    clamped = SPEC.model_copy(update={"strip": SPEC.strip.model_copy(update={"turn_deg": 0.0})})
    severity = {v.kind: v.severity for v in check(body(*TOWER), clamped, PRINTER).violations}
    assert severity["mechanism"] == "note"


def test_parts_that_later_commands_do_not_know_are_told():
    def told(**parts):
        own = SPEC.model_copy(update=parts)
        return [v for v in check(body(*WHEEL), own, PRINTER).violations if v.kind == "parts"]

    assert not told()
    assert not told(connector=SPEC.connector.model_copy(update={"gap": 45.0}))  # as `tipping` advises
    (note,) = told(strip=SPEC.strip.model_copy(update={"thickness": 1.2}))
    assert note.severity == "note" and "(tension, buckling, bending, strip)" in note.message
    (note,) = told(pitch=50.0)
    assert "(pitch, " in note.message
    (note,) = told(coil=WIDE_COIL.coil)
    assert note.severity == "note" and "(coil_diameter)" in note.message
    assert "coil_diameter_mm: 8.25, cold_length_mm: 35, hot_length_mm: 75" in note.remedy


def test_a_strip_that_is_bent_too_far_is_named():
    """With a resin so weak that 1 / 2.1 of the found strain breaks it, the same design is unfit."""
    wheel = body(*WHEEL)
    figures = check(wheel, SPEC, PRINTER).figures
    weak = PRINTER.material.model_copy(update={"flexural_strength": 1e3 * figures["greatest_strain"]})
    report = check(wheel, SPEC, PRINTER.model_copy(update={"material": weak}))
    (first, *_) = [v for v in report.violations if v.kind == "strain"]
    assert first.severity == "unfit" and first.parts[0].startswith("spring ")
    assert first.amount == pytest.approx(2.1 * SPEC.safety.strain, rel=0.02)


def test_a_rigid_block_is_unfit_but_buildable():
    block = body(*BLOCK)
    inside = np.bincount(block.springs.ravel())[block.springs] == 6
    motor = int(np.flatnonzero(inside.all(axis=1))[0])
    report = check(body(*BLOCK, motors=(motor,)), SPEC, PRINTER)
    assert [v.kind for v in report.violations if v.severity == "unfit"] == ["rigid", "coil"]
    assert report.figures["static_margin_mm"] > 20
    (feet,) = [v for v in report.violations if v.kind == "feet"]
    assert feet.amount == pytest.approx(SPEC.safety.foot_stroke - report.figures["foot_stroke_mm"], abs=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_a_motor_that_strips_hold_is_named(seed):
    """Held is a motor whose length no motion of the strips alone changes."""
    lattice, rng = Lattice(6, 11), np.random.default_rng(seed)
    design = develop(lattice, random_genotypes(lattice, 1, rng, 2)[0])
    report = check(design, SPEC, PRINTER)
    if "coil_buckling_mm" not in report.figures:
        return  # refused before
    at = design.positions + 0.01 * rng.uniform(-1, 1, design.positions.shape)
    rows = rigidity_matrix(at, design.springs)
    motions = null_space(rows[~design.active], rcond=1e-9)
    held = {f"spring {m}" for m in np.flatnonzero(design.active) if np.abs(rows[m] @ motions).max() < 1e-7}
    assert {p for v in report.violations if v.kind == "coil" for p in v.parts} == held
    assert report.figures["held_motors"] == len(held)
    assert report.figures["coil_buckling_mm"] == pytest.approx(2.03, abs=0.01)


def test_parts_plates_resin_and_weight():
    """Of a triangle by hand: 6 masses, 4 strips, 4 ends, 3 connectors, on two plates for their heights."""
    figures = check(body(*TRIANGLE), SPEC, PRINTER).figures
    assert (figures["masses"], figures["motors"], figures["parts"], figures["plates"]) == (3, 1, 17, 2)
    assert figures["resin_g"] == pytest.approx(1.15e-3 * figures["resin_mm3"], rel=1e-3)
    coils = 2 * 1e3 * SpringParameters().mass
    assert figures["robot_g"] == pytest.approx(figures["resin_g"] + coils, abs=0.02)
    heavier = check(body(*TRIANGLE), WIDE_COIL, PRINTER).figures
    assert heavier["robot_g"] == pytest.approx(heavier["resin_g"] + coils * 8.25 / 6.5, abs=0.02)
    # The built scene weighs one plane of the same robot, every mass as one with four springs.
    weight = 1e3 * build(body(*TRIANGLE)).masses.sum()
    assert figures["robot_g"] / 2 == pytest.approx(weight, rel=0.05)
