"""What is measured on a mesh, against solids whose walls, slots, overhangs and hollows are known by hand."""

import csv
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import CrossSection, Manifold

from eldir.errors import EldirError
from eldir_app.commands.coupon import coupon as command
from eldir_cad.geometry import parts
from eldir_cad.geometry.inspection import inspect, measure_inclined, require_printable, self_intersections
from eldir_cad.geometry.shapes import to_mesh
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet.coupon import allowance_table, coupon_part, write_coupon
from tests.raised import raises

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)


def block(x, y, z, at=(0.0, 0.0, 0.0)):
    return Manifold.cube((x, y, z)).translate(at)


def measured(solid):
    return inspect(to_mesh(solid, "test"), PRINTER)


def test_a_block_has_nothing_but_walls():
    found = measured(block(10, 4, 20))
    assert found.wall == pytest.approx(4)
    assert math.isinf(found.gap)
    assert found.overhangs == found.islands == found.cups == found.sealed == ()
    assert found.supports == "none"


@pytest.mark.parametrize("turn", [0.0, 17.0, 45.0])
def test_walls_and_slots_by_hand(turn):
    """A slot of 0.8 that leaves a wall of 0.7 on one side and a floor of 0.9, however it is turned."""
    solid = block(10, 10, 5) - block(0.8, 20, 5, (0.7, -5, 0.9))
    found = measured(solid.rotate((0, 0, turn)))
    assert found.wall == pytest.approx(0.7, abs=1e-5)
    assert found.gap == pytest.approx(0.8, abs=1e-5)
    assert measured(block(10, 10, 5) - block(9, 20, 3, (0.5, -5, 1.4))).wall == pytest.approx(0.5, abs=1e-5)
    low = measured(block(10, 10, 5) - block(20, 20, 0.3, (2, -5, 2)))
    assert (low.wall, low.gap) == (pytest.approx(2), pytest.approx(0.3, abs=1e-5))


def test_a_wall_between_a_lying_hole_and_a_side():
    """A hole of 2 along y, 0.6 under the top: sides that lean are measured along their normals."""
    hole = Manifold.cylinder(20, 1.0, circular_segments=64).rotate((90, 0, 0)).translate((5, 15, 0))
    mesh = to_mesh(block(10, 10, 6) - hole.translate((0, 0, 4.4)), "test")
    found = inspect(mesh, PRINTER)
    assert found.wall == pytest.approx(0.6, abs=0.01)
    assert found.gap == pytest.approx(2.0, abs=0.01)
    every = measure_inclined(mesh, np.arange(len(mesh.faces)))
    assert found.wall == pytest.approx(every[0], abs=0.01)


@pytest.mark.parametrize("tilt", [0.0, 90.0])
def test_sides_that_taper_by_40_degrees_are_a_wall_and_a_slot_too(tilt):
    """A wedge, 0.8 at its thin end, upright and lying. Where it is w wide, a ray at right angles to one side,
    which leans by 20 degrees, meets the other one after w cos 20 / cos 40."""
    lean = math.tan(math.radians(20))
    ends = [(-0.4, 0.0), (0.4, 0.0), (0.4 + 5 * lean, 5.0), (-0.4 - 5 * lean, 5.0)]
    wedge = Manifold.extrude(CrossSection([np.array(ends)]), 6.0)
    across = math.cos(math.radians(20)) / math.cos(math.radians(40))
    nearest, farthest = 0.8 * across, (0.8 + 2 * 2.5 * lean) * across  # from the thin end, from the middle
    placed = wedge.rotate((tilt, 0, 0))
    assert nearest < measured(placed.translate((0, 0, -placed.bounding_box()[2]))).wall < farthest
    hollow = block(8, 7, 6, (-4, -1, 0)) - wedge.translate((0, 1.0001, 0))
    placed = hollow.rotate((tilt, 0, 0))
    assert nearest < measured(placed.translate((0, 0, -placed.bounding_box()[2]))).gap < farthest


def test_overhangs_and_islands():
    stem, head = block(4, 4, 5), block(14, 4, 2, (-5, 0, 5))
    (over,) = measured(stem + head).overhangs
    reach = PRINTER.layer  # that the layer below carries
    assert (over.z, over.size) == (5.0, pytest.approx(2 * (5 - reach) * 4, rel=0.01))
    cone = Manifold.cylinder(5, 3, 7.9)  # less than 45 degrees
    assert measured(cone).overhangs == () and measured(cone).supports == "none"
    assert measured(Manifold.cylinder(5, 3, 30)).overhangs  # far more
    narrow = block(10, 10, 4) - block(0.9, 20, 2, (4, -5, -1))
    assert measured(narrow).overhangs == ()  # a bridge of less than a millimetre
    wide = block(10, 10, 4) - block(1.6, 20, 2, (4, -5, -1))
    (ceiling,) = measured(wide).overhangs  # 0.05 of it held on either side by the layer below
    assert (ceiling.z, ceiling.size) == (1.0, pytest.approx(1.5 * 10, rel=0.01))
    hook = head + block(4, 4, 5) + block(2, 4, 3, (-5, 0, 2))  # hangs down from the head, 2 above the plate
    (island,) = measured(hook).islands
    assert (island.z, island.size) == (2.0, pytest.approx(8))
    assert measured(hook).supports.startswith(f"{8 + measured(hook).overhangs[0].size:.0f} mm2 from below")


def test_cups_and_sealed_hollows():
    pit, pot = block(4, 4, 6, (3, 3, 2)), block(10, 10, 5)
    (cup,) = measured(pot - pit).cups
    assert (cup.z, cup.size) == (2.0, pytest.approx(4 * 4 * 3))
    assert measured(pot - pit).sealed == ()
    through = measured(pot - block(4, 4, 9, (3, 3, -2)))
    assert len(through.cups) == 1  # the plate closes it
    aside = measured(pot - pit - block(20, 2, 1, (5, 4, 3)))  # a drain half-way up
    assert aside.cups == () or aside.cups[0].size < 4 * 4 * 3
    drained = measured(pot - pit - block(20, 2, 9, (5, 4, 2)))
    assert drained.cups == drained.sealed == ()
    (below,) = measured(pot - block(4, 4, 2, (3, 3, -1))).sealed
    assert (below.z, below.size) == (0.0, pytest.approx(4 * 4 * 1))
    (inside,) = measured(pot - block(4, 4, 2, (3, 3, 1))).sealed
    assert (inside.z, inside.size) == (1.0, pytest.approx(4 * 4 * 2))
    # One that parts into two keeps its volume once.
    split = pot - block(6, 4, 1, (2, 3, -1e-9)) - block(1, 4, 1, (2, 3, 1)) - block(1, 4, 1, (7, 3, 1))
    assert sum(f.size for f in measured(split).sealed) == pytest.approx(6 * 4 + 2 * 4, rel=1e-3)


def test_surfaces_that_cross():
    one, other = (trimesh.creation.box((2, 2, 2)) for _ in range(2))
    other.apply_transform(trimesh.transformations.rotation_matrix(0.3, (1, 1, 0), (0, 0, 0)))
    apart = trimesh.util.concatenate([one, other.copy().apply_translation((3, 0, 0))])
    assert self_intersections(apart) == []
    crossed = trimesh.util.concatenate([one, other.apply_translation((1, 0.3, 0))])
    pairs = self_intersections(crossed)
    assert pairs and all(a < 12 <= b or b < 12 <= a for a, b in pairs)
    assert crossed.is_watertight  # closed is not enough
    with raises(EldirError, "part.cuts-itself", match="part two"):
        require_printable("two", crossed, measured(block(1, 1, 1)), PRINTER)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000))
def test_unions_do_not_cross_themselves(seed):
    """Random blocks, joined: what manifold gives has no crossing, what is merely put together has some."""
    rng = np.random.default_rng(seed)
    solids = [
        block(*rng.uniform(2, 5, 3))
        .rotate(tuple(rng.uniform(0, 90, 3)))
        .translate(tuple(rng.uniform(0, 1, 3)))
        for _ in range(3)
    ]
    joined = to_mesh(solids[0] + solids[1] + solids[2], "test")
    assert self_intersections(joined) == []
    heap = trimesh.util.concatenate([to_mesh(s, "test") for s in solids])
    assert self_intersections(heap)


@pytest.mark.parametrize("sockets", [(0,), (0, 1, 2, 3, 4, 5)])
def test_the_kits_masses_as_they_are_measured(sockets):
    found = inspect(parts.mass(SPEC, 1, sockets, "front").mesh, PRINTER)
    # Between the bars and the line of the number; walls between sockets are 1.1, to the peg's hole 0.8.
    assert found.wall == pytest.approx(0.6, abs=1e-3)
    assert found.gap == pytest.approx(0.6, abs=1e-3)
    (cup,) = found.cups  # the peg's hole, which the sockets do not reach
    hole = math.sqrt(3) / 2 * SPEC.mass.peg_hole**2 * SPEC.mass.socket_depth
    assert (cup.z, cup.size) == (SPEC.mass.floor, pytest.approx(hole, rel=1e-3))
    seat = inspect(parts.mass(SPEC, 1, sockets, "front", "m1").mesh, PRINTER)
    assert seat.supports.endswith("from below, at 0.4 mm")
    rim = (SPEC.mass.across_flats - SPEC.mass.disc_diameter) / 2
    assert seat.wall == pytest.approx(min(0.6, rim), abs=0.01)


def test_a_part_finer_than_the_printer_is_refused():
    mesh = to_mesh(block(10, 0.5, 4), "test")
    with raises(EldirError, "part.too-fine", match=r"part fin has a wall.*at least 0\.6 mm; found 0\.50 mm"):
        require_printable("fin", mesh, inspect(mesh, PRINTER), PRINTER)
    mesh = to_mesh(block(10, 10, 4) - block(0.3, 20, 4, (4, -5, 2)), "test")
    with raises(EldirError, "part.too-fine", match=r"part comb has a gap.*at least 0\.5 mm; found 0\.30 mm"):
        require_printable("comb", mesh, inspect(mesh, PRINTER), PRINTER)


def test_a_strip_in_each_socket_of_the_coupon_has_that_clearance():
    spec = load_specification()
    bar = coupon_part(spec)
    assert len(bar.mesh.split()) == 1 and inspect(bar.mesh, PRINTER).wall >= PRINTER.minimum.wall - 1e-3
    advance = 1.25 * spec.mass.across_flats
    bottom = spec.mass.floor + 0.1
    gauge = parts.strip(spec).solid.rotate((0, 0, 90)).translate((0, -spec.strip.length / 2, bottom))
    # Its bulb sits as deep behind the bar's side as in a mass, behind the side of that.
    inset = spec.mass.across_flats / 2 - spec.bulb_radius_at + spec.strip.bulb_diameter / 2
    for i, clearance in enumerate(spec.coupon_steps):
        placed = gauge.translate(((i + 0.5) * advance, inset, 0))
        gap = bar.solid.min_gap(placed, 2.0)
        assert gap == pytest.approx(min(clearance, 0.1), abs=0.012), (i, clearance)


def test_the_coupons_folder(tmp_path, capsys):
    command(tmp_path / "coupon")
    said = "write its `allowance_for_the_profile_mm` from coupon.csv as `allowance` into the profile of"
    assert said in capsys.readouterr().out
    found = sorted(p.relative_to(tmp_path / "coupon").as_posix() for p in (tmp_path / "coupon").rglob("*.*"))
    assert found == [
        "coupon.csv", "parts/cap.stl", "parts/fit_coupon.stl", "parts/passive_spring.stl",
        "plates/plate_01.3mf", "plates/plate_01.stl",
    ]  # fmt: skip
    rows = list(csv.DictReader((tmp_path / "coupon" / "coupon.csv").read_text().splitlines()))
    assert [r["number"] for r in rows] == [str(i + 1) for i in range(len(rows))]
    # A printer that makes every slot 0.05 narrower fits at 0.15 and wants that much more everywhere.
    (row,) = [r for r in rows if float(r["clearance_mm"]) == 0.15]
    wanted = PRINTER.model_copy(update={"allowance": float(row["allowance_for_the_profile_mm"])})
    assert fit_to_printer(load_specification(), wanted).clearance == pytest.approx(0.15)
    with raises(EldirError, "file.exists"):
        write_coupon(tmp_path / "coupon")
    assert allowance_table(SPEC).count("\n") == len(rows) + 1
