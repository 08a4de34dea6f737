"""Sheets and tag file for one robot: in their true size, and a bench with these tags can be calibrated."""

from io import BytesIO

import cv2
import numpy as np
import pytest
from matplotlib.image import imread

from eldir.core.files import parse_json
from eldir.core.pictures import png
from eldir_hardware.camera.plane import FieldOfView, TagBoard
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.markers.placement import placement_files, starter_board
from eldir_hardware.markers.registration import load_kind
from eldir_hardware.markers.sheet import marker_pages, tag_pages
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.cad.drawn_bodies import WHEEL, design
from tests.raised import raises

ROBOT = design(*WHEEL, motors=(0, 4))
SCALE = 1.14


def words(page):
    return [text.get_text() for text in page.texts]


def test_the_tag_file_calibrates_a_camera_that_sees_such_a_bench():
    files = placement_files(ROBOT, SCALE)
    board = TagBoard.from_json(parse_json(files["tags.json"], "tags.json"))
    assert board == starter_board(ROBOT, SCALE)
    body = SCALE * (ROBOT.morphology.positions - ROBOT.morphology.positions.min(axis=0))
    camera = VirtualCamera(3, FieldOfView.around(body), board=board)
    image = camera.render(body, ROBOT.morphology.springs, ROBOT.marks)
    plane = calibrate_plane([image], board)
    assert len(plane.provenance["tags"]) >= 5
    assert np.abs(plane.to_metres(camera.plane.to_pixels(body)) - body).max() < 1e-4
    assert files["markers.pdf"].startswith(b"%PDF")
    assert files == placement_files(ROBOT, SCALE), "the same bytes"


def test_the_sheets_have_the_tags_of_the_file_in_its_size():
    """A page at 100 dots an inch, read by OpenCV: 60 mm are 236 dots."""
    board = starter_board(ROBOT, SCALE)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    found = {}
    for page in tag_pages(board.dictionary, len(board.ids), board.side_m):
        picture = (255 * imread(BytesIO(png(page, dpi=100)))[..., :3]).astype(np.uint8)
        corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
        found |= {int(i): c[0] for i, c in zip(ids.ravel(), corners, strict=True)}
    assert sorted(found) == board.ids
    for square in found.values():
        sides = np.linalg.norm(square - np.roll(square, 1, axis=0), axis=1)
        assert sides == pytest.approx(board.side_m / 0.0254 * 100, abs=1.5)
        assert (square[1] - square[0])[0] > 0, "upright"


@pytest.mark.parametrize("kind", ["discs", "aruco"])
def test_a_robots_sheet_has_its_markers_alone_with_their_masses(kind):
    (page,) = marker_pages(load_kind(kind), [7, 2, 5])
    told = words(page)
    assert [told.count(f"m{i}, mass {mass}") for i, mass in ((1, 7), (2, 2), (3, 5))] == [4, 4, 4]
    assert not any(text.startswith("m4") for text in told)
    (whole,) = marker_pages(load_kind(kind))
    assert [words(whole).count(f"m{i}") for i in range(1, 6)] == [4] * 5
    pictures = [np.asarray(axes.images[0].get_array()) for axes in page.axes]
    same = [np.asarray(axes.images[0].get_array()) for axes in whole.axes]
    assert all(np.array_equal(one, other) for one, other in zip(pictures, same, strict=False))


def test_a_tag_that_no_page_holds_is_refused():
    with raises(Exception, "input.wrong-value", "side of the tags", match="at most 0.128 m"):
        list(tag_pages("DICT_4X4_50", 4, 0.13))
    assert len(list(tag_pages("DICT_4X4_50", 4, 0.128))) == 4


def test_a_long_robot_has_tags_that_can_be_printed():
    assert starter_board(ROBOT, 8 * SCALE).side_m == 0.128
