"""The plane of motion from tags, and pixels to metres and back."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from eldir.errors import InputError
from eldir_app.application import application
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import (
    BODY,
    MARKED,
    SPACE,
    SPRINGS,
    TIMES,
    cover,
    film,
    rms_mm,
)
from tests.paths import DATA, SCHEMAS
from tests.raised import raises

OLD = DATA / "old"


def test_plane_agrees_with_opencv_projection() -> None:
    focal, centre = 800.0, np.array([322.0, 236.0])
    turn, shift = (
        cv2.Rodrigues(np.radians([5.0, -7, 2]))[0] @ np.diag([1.0, -1, -1]),
        np.array([0.1, 0.05, 1.2]),
    )
    lens = np.array([-0.12, 0.03, 0, 0])
    unit = 400.0
    k = np.array([lens[0] * (unit / focal) ** 2, lens[1] * (unit / focal) ** 4])
    homography = np.diag([focal / unit, focal / unit, 1]) @ np.column_stack([turn[:, :2], shift])
    plane = Plane(640, 480, homography, centre, k, 0.0)
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    solid = np.column_stack([points, np.zeros(50)])
    expected, _ = cv2.projectPoints(solid, cv2.Rodrigues(turn)[0], shift, matrix, lens)
    np.testing.assert_allclose(plane.to_pixels(points), expected[:, 0], atol=1e-6)


@given(st.integers(0, 50), st.floats(-0.3, 0.5), st.floats(0, 0.3))
@settings(max_examples=25)
def test_pixels_and_metres_are_inverse(seed: int, x: float, y: float) -> None:
    from eldir_hardware.vision.virtual_camera import sample_pose

    _, lens = sample_pose(np.random.default_rng(seed), TagBoard.around(SPACE), (640, 480))
    there = lens.to_pixels(np.array([x, y]))
    np.testing.assert_allclose(lens.to_metres(there), [x, y], atol=1e-9)


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.stress) for s in (1, 2, 3))])
def test_plane_found_from_the_picture_is_the_cameras(seed: int) -> None:
    camera = VirtualCamera(seed, SPACE)
    plane = calibrate_plane([image for _, image in film(camera, TIMES[:10])], camera.board)
    x, y = np.linspace(SPACE.min_x, SPACE.max_x, 20), np.linspace(0, SPACE.height, 8)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    error = np.linalg.norm(plane.to_metres(camera.plane.to_pixels(points)) - points, axis=-1)
    assert error.max() < 2e-4
    assert np.sqrt((error**2).mean()) < 1e-4
    assert plane.rms_px < 0.1
    again = Plane.from_json(json.loads(json.dumps(plane.to_json())))
    assert again == plane
    for values, name in ((plane.to_json(), "plane"), (camera.board.to_json(), "tags")):
        jsonschema.validate(values, json.loads((SCHEMAS / f"{name}.schema.json").read_text()))


def test_apriltags_serve_as_well() -> None:
    board = TagBoard.around(SPACE)
    board = TagBoard.at(board.centres, 0.07, "DICT_APRILTAG_36h11")
    camera = VirtualCamera(3, SPACE, board=board)
    plane = calibrate_plane([image for _, image in film(camera, TIMES[:5])], board)
    assert rms_mm(plane.to_metres(camera.plane.to_pixels(BODY)), BODY) < 0.1


def test_too_few_or_misplaced_tags_are_named(filmed) -> None:
    camera, frames, _ = filmed
    image = frames[0][1].copy()
    for centre in camera.board.centres[:-3]:
        cover(image, camera, centre, 0.08)
    with raises(InputError, "plane.too-few-tags"):
        calibrate_plane([image], camera.board)
    small = TagBoard.at(camera.board.centres, 0.03)
    with raises(InputError, "plane.too-few-tags"):
        calibrate_plane([VirtualCamera(1, SPACE, board=small).render(BODY, SPRINGS, MARKED)], small)
    moved = camera.board.centres.copy()
    moved[2] += 0.01
    with raises(InputError, "plane.tags-elsewhere"):
        calibrate_plane([frames[0][1]], TagBoard.at(moved))
    with raises(InputError, "tags.unknown-dictionary"):
        calibrate_plane([frames[0][1]], TagBoard.at(camera.board.centres, dictionary="DICT_NONE"))


@pytest.mark.parametrize(
    ("side", "places", "message"),
    [
        (1e3, 1e3, "side of the tags is .* 0.01 to 0.5 m; found 60, which looks like millimetres;"),
        (1e2, 1e2, "found 6, which looks like centimetres or inches;"),
        (1 / 0.0254, 1 / 0.0254, "found 2.3622, which looks like centimetres or inches;"),
        (1e3, 1.0, "found 60, which looks like millimetres; give side_m, x_m and y_m .* in metres"),
        (1.0, 1e3, "the outermost tags is not .* 0.01 to 10 m; .* looks like millimetres or"),
        (1.0, 1e2, "between the outermost tags is not plausible; .* looks like .*centimetres or"),
        (1e-3, 1e-3, "found 6e-05; give"),
        (1.0, 0.0, "found 0; give"),
        (-1.0, 1.0, "found -0.06; give"),
    ],
)  # fmt: skip
def test_tags_in_another_unit_are_refused_with_its_name(
    filmed, tmp_path: Path, side: float, places: float, message: str
) -> None:
    """A plane from them would fit as well, and every length would be wrong by the same factor."""
    camera, frames, _ = filmed
    values = camera.board.to_json()
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "one.png"), frames[0][1])
    values["side_m"] = 0.06 * side
    for tag in values["tags"]:
        tag["x_m"], tag["y_m"] = places * tag["x_m"], places * tag["y_m"]
    tags, out = tmp_path / "tags.json", tmp_path / "plane.json"
    tags.write_text(json.dumps(values))
    words = ["calibrate", "plane", str(tmp_path / "pictures"), "--tags", str(tags), "--out", str(out)]
    result = CliRunner().invoke(application(words[0]), words)
    assert result.exit_code != 0 and not out.exists()
    assert re.search(message, str(result.exception)), result.exception


def test_files_of_version_0_1_0_are_read_and_written_as_they_are(tmp_path: Path) -> None:
    """The files, and what they gave, are of that version."""
    plane, board = Plane.load(OLD / "plane.json"), TagBoard.load(OLD / "tags.json")
    assert plane.to_metres(np.array([3.0, 4.0])) == pytest.approx([-0.35452088, 0.44204306], abs=1e-8)
    assert plane.board == board and board.corners.sum() == pytest.approx(7.6)
    for name, file in (("plane.json", plane), ("tags.json", board)):
        file.save(tmp_path / name)
        assert (tmp_path / name).read_bytes() == (OLD / name).read_bytes()


@pytest.mark.parametrize(
    ("damage", "place"),
    [
        (lambda v: v.update(side_m="6 cm"), "side_m"),
        (lambda v: v["tags"][2].pop("y_m"), "tags.2.y_m"),
        (lambda v: v["tags"][2].update(id=1.5), "tags.2.id"),
        (lambda v: v["tags"][2].update(x=0.1), "tags.2.x"),
        (lambda v: v["tags"][2].update(id=0), "[0]"),
        (lambda v: v.update(tags=v["tags"][:3]), "tags"),
        (lambda v: v.update(dictionary="AprilTags"), "dictionary"),
    ],
)
def test_a_mistake_in_a_tag_file_is_named_with_file_and_place(
    damage: Callable[[dict], object], place: str, tmp_path: Path
) -> None:
    values = json.loads((OLD / "tags.json").read_text())
    damage(values)
    path = tmp_path / "tags.json"
    path.write_text(json.dumps(values))
    with pytest.raises(InputError, match=rf"^{re.escape(str(path))}.*{re.escape(place)}") as found:
        TagBoard.load(path)
    assert "\n" not in str(found.value)
