"""A camera that is held another way up: its orientation tag is ignored, so that a lens keeps its centre."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image as Photograph
from typer.testing import CliRunner

from eldir_app.application import application
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.vision.sources import open_source
from tests.hardware.camera.known_camera import MATRIX, POSES, photographs
from tests.hardware.vision.walking_films import TIMES, rms_mm, truth

FORMATS = ("jpg", "png", "tif")


def store(path: Path, image: np.ndarray, orientation: int) -> None:
    """A picture whose pixels are `image`, with an orientation tag."""
    tags = Photograph.Exif()
    tags[0x0112] = orientation
    picture = Photograph.fromarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    how = {".jpg": {"quality": 95, "subsampling": 0}, ".png": {"compress_level": 1}}
    picture.save(path, exif=tags, **how.get(path.suffix, {}))


def run(*words: object) -> str:
    result = CliRunner().invoke(application(str(words[0])), [str(w) for w in words])
    return result.output + (str(result.exception) if result.exit_code else "")


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", FORMATS)
def test_a_picture_is_read_as_the_sensor_took_it(tmp_path: Path, ending: str, orientation: int) -> None:
    image = np.full((40, 64, 3), 30, np.uint8)
    image[4:16, 8:24] = (10, 200, 90)
    store(tmp_path / f"one.{ending}", image, orientation)
    ((_, found),) = open_source(tmp_path, rate=1.0)
    assert found.shape == image.shape and np.abs(found.astype(int) - image).mean() < 2
    data = np.frombuffer((tmp_path / f"one.{ending}").read_bytes(), np.uint8)
    np.testing.assert_array_equal(jpeg.decode(data), found)


def test_photographs_with_all_orientations_give_the_right_principal_point(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for i, (_, image) in enumerate(photographs()):
        store(tmp_path / "photos" / f"view{i}.{FORMATS[i % 3]}", image, 1 + i % 8)
    run("calibrate", "camera", tmp_path / "photos", "--out", tmp_path / "camera.json")
    lens = Lens.load(tmp_path / "camera.json")
    assert np.abs(lens.centre_px - MATRIX[:2, 2]).max() < 1.5
    assert np.abs(lens.focal_px - np.diag(MATRIX)[:2]).max() < 3.0
    assert (np.abs(lens.centre_px - MATRIX[:2, 2]) < 2 * lens.deviation[2:4]).all()


def test_a_photograph_that_a_program_has_turned_is_refused(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    for i, (_, image) in enumerate(photographs(POSES[:3])):
        turned = np.rot90(image) if i == 2 else image
        store(tmp_path / "photos" / f"view{i:02}.jpg", np.ascontiguousarray(turned), 1)
    text = run("calibrate", "camera", tmp_path / "photos", "--out", tmp_path / "camera.json")
    assert "480 x 640 in view02.jpg, rotated by 90 degrees" in text
    assert not (tmp_path / "camera.json").exists()


@pytest.mark.parametrize("orientation", [3, 6])
def test_pictures_of_a_camera_that_stands_any_way_up_are_tracked(
    recordings: Path, tmp_path: Path, orientation: int
) -> None:
    """The camera is mounted turned, and notes how its pictures are to be shown."""
    quarters = {3: 2, 6: 1}[orientation]
    (tmp_path / "pictures").mkdir()
    for file in ((recordings / "pictures" / f"frame{i}.png") for i in range(5)):
        sensor = np.ascontiguousarray(np.rot90(cv2.imread(str(file)), quarters))
        store(tmp_path / "pictures" / file.name, sensor, orientation)
    out = tmp_path / "walk.json"
    text = run("track", tmp_path / "pictures", "--rate", 10, "--tags", recordings / "tags.json",
               "--out", out, "--save-plane", tmp_path / "plane.json")  # fmt: skip
    assert "5 frames" in text
    found = np.array(json.loads(out.read_text())["positions_m"], float)
    assert rms_mm(found, truth(TIMES[:5])) < 0.1
    if orientation == 6:
        text = run("track", recordings / "pictures", "--rate", 10, "--plane", tmp_path / "plane.json",
                   "--out", tmp_path / "other.json")  # fmt: skip
        assert "expected 480 x 640 pixels; found 640 x 480, rotated by 90 degrees" in text


def test_a_film_that_notes_a_turn_is_read_as_the_sensor_took_it(filmed, tmp_path: Path) -> None:
    """A phone's film, held the other way up: the header says to show it upside down."""
    _, frames, _ = filmed
    plain, noted = tmp_path / "plain.mp4", tmp_path / "noted.mp4"
    video = cv2.VideoWriter(str(plain), cv2.VideoWriter_fourcc(*"mp4v"), 10, (640, 480))
    for _, image in frames[:3]:
        video.write(image)
    video.release()
    data = bytearray(plain.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40
    assert struct.unpack_from(">9i", data, matrix)[0] == 1 << 16, "the display matrix of the track"
    struct.pack_into(">9i", data, matrix, -(1 << 16), 0, 0, 0, -(1 << 16), 0, 640 << 16, 480 << 16, 1 << 30)
    noted.write_bytes(data)
    for (_, a), (_, b) in zip(open_source(plain), open_source(noted), strict=True):
        np.testing.assert_array_equal(a, b)
