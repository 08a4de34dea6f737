"""The build filter on bodies whose freedoms, strokes and faults are known by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cad.buildability import check
from cad.law import StripLaw
from cad.rigidity import degrees_of_freedom, hinges, rigidity_matrix
from cad.specification import fit, load_printer, load_specification
from cad.stroke import Stroke, foot_stroke, nearest_contacts, shortening, stroke
from eldir.errors import InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.statics import freedoms
from tests.cad_bodies import BLOCK, HOURGLASS, RHOMBUS, TOWER, TRIANGLE, WHEEL, body

PRINTER = load_printer()
SPEC = fit(load_specification(), PRINTER)
LAW = StripLaw.of(SPEC, PRINTER)


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
    assert freedoms(found.positions, found.springs) == expected


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
    assert (
        degrees_of_freedom(wheel.positions[others], np.searchsorted(others, rim)) == 3
    )  # six bars in a ring


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000))
def test_freedoms_of_random_bodies(seed):
    lattice = Lattice(6, 11)
    found = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(seed), 2)[0])
    here, general = (
        degrees_of_freedom(found.positions, found.springs),
        freedoms(found.positions, found.springs),
    )
    assert here >= general >= max(0, 2 * len(found.positions) - 3 - len(found.springs))
    less = degrees_of_freedom(found.positions, found.springs[~found.active])
    assert here <= less <= here + found.motors
    # Each mass that alone holds two parts lets them turn.
    assert general >= sum(h.separates for h in hinges(found))


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
    assert hinges(body(*WHEEL)) == []
    (hinge,) = hinges(body(*HOURGLASS))
    assert (hinge.fans, hinge.separates) == (2, True)
    assert [h.separates for h in hinges(body(*TOWER))] == [True, True]
    (held,) = hinges(body("01111", "01101", "01101", "00111"))  # a ring, closed by a vertex on one side
    assert (held.fans, held.separates) == (2, False)


def test_a_free_rhombus_follows_its_motor():
    """The motor is the short diagonal: it reaches its free lengths, and the other follows the circle."""
    rhombus = body(*RHOMBUS, motors=(2,))
    degree = np.bincount(rhombus.springs.ravel())
    shared = int(np.flatnonzero((degree[rhombus.springs] == 3).all(axis=1))[0])
    rhombus = body(*RHOMBUS, motors=(shared,))
    motion = stroke(rhombus, SPEC, LAW)
    a, b = rhombus.springs[shared]
    tips = np.flatnonzero(degree == 2)
    for pose, diagonal in zip(motion.poses[[2, 5]], SPEC.motor_range, strict=True):
        assert np.linalg.norm(pose[a] - pose[b]) == pytest.approx(diagonal, abs=0.7)
        across = 2 * np.sqrt(SPEC.pitch**2 - (np.linalg.norm(pose[a] - pose[b]) / 2) ** 2)
        assert np.linalg.norm(np.subtract(*pose[tips])) == pytest.approx(across, abs=0.05)
    assert shortening(motion, rhombus)[~rhombus.active].max() < 0.05


def test_a_stiff_wheel_holds_its_motor():
    motion = stroke(body(*WHEEL), SPEC, LAW)
    assert np.abs(motion.poses - motion.rest).max() < 0.1


def test_contacts_are_measured_between_surfaces():
    wheel = body(*WHEEL)
    rest = (wheel.positions - wheel.positions.min(axis=0)) / 0.05 * SPEC.pitch
    assert nearest_contacts(Stroke(rest, rest[None]), wheel, SPEC) == []
    i = int(np.argmin(rest[:, 0]))
    j = int(np.argmax(rest[:, 0]))
    near = rest.copy()
    near[j] = rest[i] + [0, -10.0]
    (first, *_) = [
        c
        for c in nearest_contacts(Stroke(rest, near[None]), wheel, SPEC)
        if c.parts == (f"mass {i}", f"mass {j}")
    ]
    assert first.gap == pytest.approx(10 - 2 * SPEC.mass.across_flats / np.sqrt(3))


def test_feet_that_the_motors_move():
    rest = np.array([[0, 0], [50, 0], [25, 43.0]])
    pose = np.array([[-3, 0], [51, 0], [25, 42.0]])
    assert foot_stroke(Stroke(rest, pose[None])) == pytest.approx(4.0)
    assert foot_stroke(Stroke(rest[1:], pose[None, 1:])) == 0.0


def test_a_body_outside_the_workspace_is_refused():
    lattice = Lattice(13, 22)
    big = develop(lattice, random_genotypes(lattice, 1, np.random.default_rng(1), 2)[0])
    report = check(big, SPEC, PRINTER)
    assert not report.buildable
    with pytest.raises(InputError, match=r"13 x \d+ triangles.*workspace is 6 x 11.*--lattice 6x11"):
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
    with pytest.raises(InputError, match=message):
        report.require_buildable()


def test_what_is_told_of_a_tower_of_triangles():
    report = check(body(*TOWER), SPEC, PRINTER)
    kinds = [v.kind for v in report.violations]
    assert report.buildable and not report.fit
    assert "mechanism" in kinds and "hinge" in kinds
    assert all(v.remedy and v.parts for v in report.violations)


def test_a_rigid_block_is_unfit_but_buildable():
    block = body(*BLOCK)
    inside = np.bincount(block.springs.ravel())[block.springs] == 6
    motor = int(np.flatnonzero(inside.all(axis=1))[0])
    report = check(body(*BLOCK, motors=(motor,)), SPEC, PRINTER)
    assert [v.kind for v in report.violations if v.severity == "unfit"] == ["rigid"]
    assert report.figures["static_margin_mm"] > 20
