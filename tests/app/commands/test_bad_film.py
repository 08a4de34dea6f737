"""Every bad film, log and calibration that a user may give is named in one line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from eldir.controller import Controller
from eldir.design import Design
from eldir.errors import EldirError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir_app.application import application
from eldir_hardware.camera.plane import FieldOfView, Image
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import BODY, MARKED, SPACE, SPRINGS, walk


def record(
    path: Path, images: Sequence[Image], board: dict | None = None, design: Design | None = None
) -> None:
    with Recorder(path) as log:
        if board is not None:
            log.attach("tags.json", json.dumps(board).encode())
        if design is not None:
            log.attach("design.json", json.dumps(design.to_json()).encode())
        for i, image in enumerate(images):
            log.on_frame(0.5 * i, image)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Films and logs, each wrong in its own way."""
    folder = tmp_path_factory.mktemp("bad")
    camera = VirtualCamera(7, SPACE)
    board = camera.board.to_json()
    lattice = Lattice(6, 11)
    body = random_genotypes(lattice, 1, np.random.default_rng(3), 2)[0]
    robot = develop(lattice, body)
    controller = Controller.random(len(robot.positions), robot.motors, np.random.default_rng(0))
    design = Design(lattice, body, controller, Scene.preset("paper"))
    design.save(folder / "design.json")
    good = [camera.render(walk(0.1 * i), SPRINGS, MARKED) for i in range(8)]
    record(folder / "good.mcap", good, board)
    record(folder / "bare.mcap", [camera.render(walk(0.1), SPRINGS, MARKED[:0])], board)
    record(folder / "few.mcap", [camera.render(walk(0.1), SPRINGS, MARKED[:3])], board)
    record(folder / "moved.mcap", good + good[:4] + [np.roll(image, 9, axis=1) for image in good], board)
    record(folder / "no_tags.mcap", good[:2], None, design)
    record(folder / "mirrored.mcap", [np.ascontiguousarray(good[0][:, ::-1])], board)
    grey = good[0].mean(axis=2, keepdims=True).astype(np.uint8)
    record(folder / "grey.mcap", [np.repeat(grey, 3, axis=2)], board)
    record(folder / "dark.mcap", [image // 3 for image in good[:2]], board)
    record(folder / "still.mcap", [], board, design)
    record(folder / "design_only.mcap", good[:2], board, design)
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "cut.mcap").write_bytes((folder / "good.mcap").read_bytes()[:-500])
    (folder / "text.mp4").write_text("no video")
    (folder / "pictures").mkdir()
    cv2.imwrite(str(folder / "pictures" / "a.png"), good[0][::2, ::2])
    for name, table in (("nan", "a.png,nan"), ("lost", "a.png,0\nb.png,1"), ("nothing", "")):
        (folder / name).mkdir()
        (folder / name / "a.png").write_bytes((folder / "pictures" / "a.png").read_bytes())
        (folder / name / "times.csv").write_text(f"file,t_s\n{table}\n")
    for name, change in (
        ("twice", {"tags": board["tags"] * 2}),
        ("odd", {"dictionary": "ArucoDetector"}),
        ("nowhere", {"tags": [{**tag, "x_m": float("nan")} for tag in board["tags"]]}),
    ):
        (folder / f"{name}_tags.json").write_text(json.dumps(board | change))
    (folder / "mixed").mkdir()
    cv2.imwrite(str(folder / "mixed" / "a.png"), good[0])
    cv2.imwrite(str(folder / "mixed" / "b.png"), good[0][::2, ::2])
    other = VirtualCamera(2, FieldOfView.around(BODY, 1.0))
    (folder / "tags.json").write_text(json.dumps(board))
    (folder / "other_tags.json").write_text(json.dumps(other.board.to_json()))
    run("calibrate", "plane", folder / "good.mcap", "--out", folder / "plane.json")
    record(folder / "other.mcap", [other.render(walk(0.1), SPRINGS, MARKED)], other.board.to_json())
    return folder


def run(*words: object) -> None:
    application(str(words[0]))([str(word) for word in words], standalone_mode=False)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("track bare.mcap", "no frame shows all markers.*none like m1, m2, m3, m4, m5"),
        ("track few.mcap", "none like m4, m5.*give the number of markers with --marks"),
        ("track good.mcap --plane design.json", "design.json.*eldir-plane/1"),
        ("track other.mcap --plane plane.json", "camera has moved since its plane was calibrated, at 0.0 s"),
        ("track pictures --rate 10 --plane plane.json", "640 x 480 pixels.*320 x 240"),
        ("track moved.mcap", r"camera has moved since its plane was calibrated, at 6\.0 s.*found 9\.0 px"),
        ("track empty.mcap", "empty.mcap is empty"),
        ("track cut.mcap", "cut.mcap is not a complete MCAP log.*eldir recover"),
        ("track still.mcap", "still.mcap holds no frames"),
        ("track no_tags.mcap", "has neither a plane of motion nor reference tags.*--tags"),
        ("track nan --tags tags.json", r"nan/times\.csv is damaged.*found a\.png at nan s"),
        ("track lost --tags tags.json", r"lost/b\.png does not exist.*times\.csv names"),
        ("track nothing --tags tags.json", r"nothing/times\.csv is damaged.*found no picture"),
        (
            "track good.mcap --tags twice_tags.json",
            r"twice_tags\.json is invalid: duplicate tag numbers",
        ),
        ("track good.mcap --tags odd_tags.json", r"invalid dictionary.*\^DICT_.*found 'ArucoDetector'"),
        ("track good.mcap --tags nowhere_tags.json", "NaN is not a number"),
        ("track mixed --rate 10 --tags tags.json", "differ in size.*found 320 x 240 and 640 x 480"),
        ("track text.mp4 --tags tags.json", "text.mp4 is a text file.*check the path"),
        ("track mirrored.mcap", "too few tags.*found 8, 9; the pictures are mirrored"),
        ("track grey.mcap", "no frame shows all markers.*in the only frame.*have no colours"),
        ("track dark.mcap", "no frame shows all markers.*one of the 2 frames.*dark: give more light"),
        ("track good.mcap --tags other_tags.json", "are not at the places in the tag file|too few tags"),
        ("report good.mcap --design design.json", r"good.mcap has no design.json.*tags.json"),
        ("report design_only.mcap --design design.json", "design_only.mcap has no schedule.json"),
        ("report empty.mcap --design design.json", "empty.mcap is empty"),
        ("calibrate camera pictures", "too few views.*found 0, 1 show no pattern"),
        ("calibrate plane pictures --tags tags.json", "too few tags"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str, message: str
) -> None:
    monkeypatch.chdir(place)
    with pytest.raises(EldirError, match=message) as found:
        run(*call.split(), "--out", tmp_path / "out")
    assert "\n" not in str(found.value)
    assert not (tmp_path / "out").exists()
