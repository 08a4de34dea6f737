"""The lean of robots whose faces differ, compared with closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from eldir.built.gait import Gait, heat_faces
from eldir.built.robot import build
from eldir_cad.checks.buildability import check
from eldir_cad.checks.lateral_stability import spread_current
from eldir_cad.checks.lean import BiplaneSection, CoilTable, Condition, Frame, Lean, predict_lean
from eldir_cad.checks.strip_law import built_parameters
from eldir_cad.checks.tipping import (
    CURRENT_SPREAD,
    FACE_DIFFERENCE_MM,
    REQUIRED_MARGIN_DEG,
    lateral_section,
    smallest_gap,
    tipping_angle,
    twist_angle,
    with_gap,
)
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_hardware.planning.workshop import make_workshop
from tests.cad.drawn_bodies import TRIANGLE, body

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
PITCH, FRICTION = 0.057, 1e-4
SECTION = lateral_section(SPEC, PRINTER, built_parameters(SPEC, PRINTER))
APEX = np.array([[0.0, 0.0], [PITCH, 0.0], [PITCH / 2, PITCH * np.sqrt(3) / 2]])
"""A triangle that stands on a side."""
SPRINGS = np.array([[0, 1], [0, 2], [1, 2]])
MASSES = np.array([4e-3, 4e-3, 6e-3])
LENGTH = PITCH - 2 * SECTION.socket
NO_COILS = CoilTable(np.zeros((1, 0, 2)), np.zeros((1, 0, 2)))


def frame(section: BiplaneSection = SECTION, motors: tuple[int, ...] = ()) -> Frame:
    return Frame(SPRINGS, np.isin(np.arange(3), motors), MASSES, section)


def lean(section: BiplaneSection, condition: Condition) -> Lean:
    (found,) = predict_lean(frame(section), APEX[None], NO_COILS, [condition])
    return found


def test_a_robot_tips_where_its_centre_of_mass_is_above_its_outer_edge() -> None:
    rigid = replace(SECTION, play=0.0, edge_stiffness=1e3, foot_friction=10.0)
    height = MASSES @ APEX[:, 1] / MASSES.sum() + SECTION.corner
    tips = SECTION.outside / height
    assert lean(rigid, Condition(FRICTION)).tipping == pytest.approx([np.arctan(tips)])
    assert lean(rigid, Condition(FRICTION, 0.97 * tips)).max_roll < 0.01
    fallen = lean(rigid, Condition(FRICTION, 1.03 * tips))
    assert fallen.max_roll == np.pi / 2 and fallen.margin < 0 and np.isnan(fallen.yaw).all()
    assert fallen.roll[0] < 0, "to the back, where the table falls to"


def test_a_robot_sways_within_its_play_and_then_bends() -> None:
    """The sides of the triangle carry the apex and push it over; at both ends of both faces they bend."""
    tilt, weight = np.radians(0.5), 9.81 * MASSES[2]
    push = -weight / np.sqrt(3)  # in each side
    stiffness = 8 * SECTION.edge_stiffness + 2 * push * LENGTH
    sways = (8 * SECTION.edge_stiffness * SECTION.play + weight * tilt * LENGTH) / stiffness
    found = lean(SECTION, Condition(0.0, tilt))
    assert found.shifts[0, 2] - found.shifts[0, :2].mean() == pytest.approx(LENGTH * sways, rel=2e-3)
    # The rotation that fits a shift of the apex best, by hand.
    high = APEX[2, 1]
    fitted = 2 / 3 * high * LENGTH * sways / (2 / 3 * high**2 + 3 * SECTION.springs_at**2)
    assert found.roll[0] == pytest.approx(-fitted, rel=2e-3)
    other = lean(SECTION, Condition(0.0, -tilt))
    assert other.roll == pytest.approx(-found.roll, rel=1e-3)


def test_friction_holds_a_robot_that_would_sway() -> None:
    tilt, weight = np.radians(0.5), 9.81 * MASSES[2]
    held = 8 * FRICTION / np.radians(1.5) - 2 * weight / np.sqrt(3) * LENGTH
    found = lean(SECTION, Condition(FRICTION, tilt))
    sways = weight * tilt * LENGTH / held
    assert found.shifts[0, 2] - found.shifts[0, :2].mean() == pytest.approx(LENGTH * sways, rel=0.02)


@pytest.mark.parametrize("back", [(0.060, 100.0), (0.057, 50.0)])
def test_coils_of_the_faces_move_them_apart(back: tuple[float, float]) -> None:
    """Without weight and beside wide sockets, each coil pushes until their forces are equal."""
    free = replace(SECTION, play=1.0, gravity=1e-6)
    lengths, stiffness = np.array([[[0.055, back[0]]]]), np.array([[[100.0, back[1]]]])
    (found,) = predict_lean(
        frame(free, motors=(0,)), APEX[None], CoilTable(lengths, stiffness), [Condition(0.0)]
    )
    apart = 2 * SECTION.springs_at * (found.slopes[0, 1] - found.slopes[0, 0])[0]
    push = stiffness * (lengths - PITCH)
    assert apart == pytest.approx(2 * (push[0, 0, 1] - push[0, 0, 0]) / stiffness.sum(), rel=1e-3)


def walk_of(sign: int) -> tuple[CoilTable, np.ndarray]:
    """Poses of a triangle whose base extends and shortens again, the front coil longer or the back one."""
    t = np.linspace(0, 1, 9)
    grown = 0.006 * np.sin(np.pi * t)
    poses = np.repeat(APEX[None], len(t), axis=0)
    poses[:, 1, 0] += grown
    poses[:, 2, 0] += grown / 2
    poses[:, 2, 1] = np.sqrt(PITCH**2 - poses[:, 2, 0] ** 2)
    lengths = PITCH + grown[:, None, None] + 0.5 * sign * grown[:, None, None] * np.array([1.0, -1.0])
    return CoilTable(lengths, np.full((len(t), 1, 2), 100.0)), poses


def test_faces_changed_lean_to_the_other_side_and_alike_they_do_not() -> None:
    leans = []
    for sign in (1, -1, 0):
        coils, poses = walk_of(sign)
        leans += predict_lean(frame(motors=(0,)), poses, coils, [Condition(FRICTION)])
    assert leans[0].max_roll > np.radians(0.5)
    assert leans[0].roll == pytest.approx(-leans[1].roll, abs=1e-5)
    assert leans[2].max_roll < 1e-9 and leans[2].margin == pytest.approx(leans[2].tipping.min())


def test_poses_that_repeat_change_nothing() -> None:
    coils, poses = walk_of(1)
    (found,) = predict_lean(frame(motors=(0,)), poses, coils, [Condition(FRICTION)])
    twice = CoilTable(np.repeat(coils.lengths, 2, axis=0), np.repeat(coils.stiffness, 2, axis=0))
    (repeated,) = predict_lean(frame(motors=(0,)), np.repeat(poses, 2, axis=0), twice, [Condition(FRICTION)])
    assert (repeated.roll[::2] == found.roll).all() and (repeated.roll[1::2] == found.roll).all()


def test_the_difference_of_the_faces_is_that_of_the_heat_model() -> None:
    springs = make_workshop().springs
    table = heat_faces(
        Gait(23.0, np.zeros(1), np.array([6 / 23])), spread_current(springs, 1, CURRENT_SPREAD)
    )
    assert 1e3 * np.abs(np.diff(table.lengths, axis=1)).max() == pytest.approx(FACE_DIFFERENCE_MM, abs=0.1)
    mean = heat_faces(Gait(23.0, np.zeros(1), np.array([6 / 23])), spread_current(springs, 1, 0.0))
    assert np.ptp(mean.lengths, axis=1).max() == 0


def test_the_filter_says_how_wide_the_connectors_must_be() -> None:
    triangle = body(*TRIANGLE)
    wide = check(triangle, SPEC, PRINTER)
    assert wide.figures["sideways_margin_deg"] > REQUIRED_MARGIN_DEG
    assert not [v for v in wide.violations if v.kind == "sideways"]
    for gap, severity in ((13, "note"), (10, "unfit")):
        narrow = with_gap(SPEC, gap)
        report = check(triangle, narrow, PRINTER)
        (found,) = [v for v in report.violations if v.kind == "sideways"]
        assert found.severity == severity
        height = narrow.outside / np.tan(np.radians(report.figures["tipping_angle_deg"]))
        masses = build(triangle, built_parameters(narrow, PRINTER)).masses
        upper = triangle.positions[:, 1] > triangle.positions[:, 1].mean()
        above_lowest = SPEC.pitch * np.sqrt(3) / 2 * masses[upper].sum() / masses.sum()
        assert height == pytest.approx(SPEC.mass.across_corners / 2 + above_lowest, rel=1e-3)
        needed = smallest_gap(narrow, height)
        assert needed is not None and f"a gap of {needed} mm" in found.remedy
        margins = [
            tipping_angle(parts, height) - twist_angle(parts)
            for parts in (with_gap(SPEC, needed), with_gap(SPEC, needed - 1))
        ]
        assert margins[0] >= REQUIRED_MARGIN_DEG > margins[1]
    assert smallest_gap(SPEC, 5000.0) is None
