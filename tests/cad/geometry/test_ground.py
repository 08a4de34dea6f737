"""The printed ground: its surface is the terrain, its pieces fit each other and the plate."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold

from eldir.built.ground import PLATE_THICKNESS, on_table, printed_range
from eldir.core.records import FloatArray
from eldir.errors import EldirError
from eldir.evolution.paper.configuration import make_terrain
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain
from eldir_cad.geometry.ground import Ground, GroundPiece, make_ground
from eldir_cad.geometry.shapes import box, stl
from eldir_cad.kit.printer import load_printer
from tests.eldir.built.grounds import plane, steps
from tests.raised import raises

PRINTER = load_printer()
BODY = np.array([[0.0, 0.0], [0.12, 0.0], [0.06, 0.1]])
CLEARANCE = 0.2
GROUNDS = {
    **{
        kind: make_terrain(kind, 3).scaled(BuiltParameters().scale)
        for kind in ("level", "incline", "decline")
    },
    "slope": plane(0.3),
    "steps": steps(),
}


def ground_of(terrain: Terrain, body: FloatArray = BODY) -> Ground:
    return make_ground(terrain, body, 36.0, CLEARANCE, PRINTER)


def lying(piece: GroundPiece, margin: float = 0.0) -> Manifold:
    """The piece where it lies, forward along x and up along y."""
    x, y = piece.part.solid.bounding_box()[:2]
    assert abs(x) + abs(y) < 1e-9
    return piece.part.solid.translate((piece.start - margin, piece.block, 0.0))


def highest(piece: GroundPiece, x: float) -> float:
    """Height of the piece's mesh at x, from its own bottom."""
    cut = trimesh.intersections.mesh_plane(piece.part.mesh, [1, 0, 0], [x - piece.start, 0, 0])
    return float(cut[..., 1].max())


@pytest.mark.parametrize("name", GROUNDS)
def test_the_surface_is_the_terrain(name: str) -> None:
    """Rays from above meet each piece at the height of the terrain, wherever it is not a vertical face."""
    terrain = on_table(GROUNDS[name], BODY)
    pieces = ground_of(GROUNDS[name]).pieces
    assert pieces[0].start == pytest.approx(1e3 * printed_range(BODY)[0])
    assert pieces[-1].end == pytest.approx(1e3 * printed_range(BODY)[1])
    lowest = np.inf
    for piece in pieces:
        x = np.linspace(piece.start + 0.5, piece.end - 0.5, 40)
        expected = 1e3 * terrain.height(1e-3 * x)
        tops = np.array([highest(piece, at) for at in x])
        assert np.abs(tops + piece.block - expected).max() < 0.02
        lowest = min(lowest, piece.surface[:, 1].min())
    assert lowest == pytest.approx(1e3 * PLATE_THICKNESS)


@pytest.mark.parametrize("name", GROUNDS)
def test_pieces_are_closed_and_fit_on_the_plate(name: str) -> None:
    for piece in ground_of(GROUNDS[name]).pieces:
        mesh = piece.part.mesh
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
        assert mesh.body_count == 1
        size = np.sort(mesh.extents[:2])
        assert (size <= np.sort(np.array(PRINTER.volume[:2]) - 2 * PRINTER.margin) + 1e-6).all()
        assert mesh.extents[2] == pytest.approx(36.0 + 20.0)
        assert mesh.volume < 0.9 * np.prod(mesh.extents)  # hollow


@pytest.mark.parametrize("name", GROUNDS)
def test_each_tongue_fits_into_the_next_groove(name: str) -> None:
    """Two pieces as they lie touch nowhere inside, and a piece that is moved up by more than the clearance
    meets its neighbour."""
    pieces = ground_of(GROUNDS[name]).pieces
    assert len(pieces) > 1
    for rear, front in pairwise(pieces):
        one, other = lying(rear), lying(front)
        assert (one ^ other).volume() < 1e-3
        for shift in (0.5 * CLEARANCE, -0.5 * CLEARANCE):
            assert (one ^ other.translate((0.01, shift, 0))).volume() < 1e-3
        for shift in (2 * CLEARANCE, -2 * CLEARANCE):
            assert (one ^ other.translate((0.01, shift, 0))).volume() > 1.0


def test_a_high_ground_stands_on_blocks() -> None:
    """A slope of one rises by more than a plate: its pieces stand on blocks, which fit under them."""
    pieces = ground_of(plane(1.0)).pieces
    blocks = [piece.block for piece in pieces]
    assert blocks[0] == 0.0 and blocks == sorted(blocks) and blocks[-1] > 200
    assert all(block % 10 == 0 for block in blocks)
    assert all(p.surface[:, 1].min() - p.block >= 1e3 * PLATE_THICKNESS - 1e-6 for p in pieces)


def test_the_front_face_has_number_and_marks() -> None:
    """A section just under the front face lacks the piece's number, and a mark under each end of the
    robot."""
    ground = ground_of(GROUNDS["level"])
    assert ground.marks == (0.0, pytest.approx(120.0))
    found = 0
    for piece in ground.pieces:
        front, inside = (piece.part.solid.slice(ground.width - depth) for depth in (0.3, 5.0))
        engraved = inside - front
        for mark in ground.marks:
            if piece.start < mark <= piece.end:
                x = mark - piece.start
                assert (engraved ^ box(x - 1, 0, x + 1, 1e3)).area() == pytest.approx(0.8 * 1.4, rel=0.1)
                found += 1
        end = piece.end - piece.start
        assert (engraved ^ box(end - 10, 0, end, 12)).area() > 4
    assert found == 2


def test_a_ground_that_no_plate_holds_is_refused() -> None:
    with raises(EldirError, "ground.too-large", match="mm high"):
        ground_of(plane(15.0))
    flat = PRINTER.model_copy(update={"volume": (195.0, 115.0, 40.0)})
    with raises(EldirError, "ground.too-large", match="56 mm deep"):
        make_ground(GROUNDS["level"], BODY, 36.0, CLEARANCE, flat)


def ridge(width: float) -> Terrain:
    """Level, with a ridge 20 mm high and this wide at its base and half as wide at its top [m], at 50 mm."""
    x = 0.05 + width * np.array([0.0, 0.25, 0.75, 1.0])
    slope = 0.02 / (0.25 * width)
    slopes = np.array([0.0, slope, 0.0, -slope, 0.0])
    heights = np.array([0.0, 0.0, 0.02, 0.02, 0.0])
    x0 = np.array([-1.0, *x])
    return Terrain(x0, slopes, heights - slopes * x0)


@pytest.mark.parametrize(
    ("width", "is_thin"), [(0.0004, True), (0.0008, True), (0.0016, False), (0.01, False)]
)
def test_a_ridge_thinner_than_the_printer_s_walls_is_refused(width: float, is_thin: bool) -> None:
    """0.6 mm is the printer's thinnest wall; a ridge is half to whole as thick as its base is wide."""
    if not is_thin:
        assert ground_of(ridge(width)).pieces
        return
    with raises(EldirError, "ground.too-thin", match="piece [12] of the ground") as error:
        ground_of(ridge(width))
    assert "x = 50 mm" in str(error.value) and "at least 0.6 mm" in str(error.value)
    thickness = float(str(error.value).split("found ")[1].split(" mm")[0])
    assert 0.5e3 * width < thickness < 1e3 * width


def test_a_printer_that_prints_no_wall_of_the_pieces_is_told() -> None:
    coarse = PRINTER.model_copy(update={"minimum": PRINTER.minimum.model_copy(update={"wall": 3.0})})
    with raises(EldirError, "ground.too-thin", match="piece 1"):
        make_ground(GROUNDS["level"], BODY, 36.0, CLEARANCE, coarse)


def test_the_mesh_in_the_file_is_the_piece() -> None:
    piece = ground_of(GROUNDS["level"]).pieces[0]
    again = trimesh.load(trimesh.util.wrap_as_stream(stl(piece.part.mesh)), file_type="stl")
    assert again.is_watertight and again.volume == pytest.approx(piece.part.volume, rel=1e-5)
