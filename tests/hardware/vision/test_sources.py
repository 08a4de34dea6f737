"""Where frames come from, and the command that tracks them."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eldir.controller import Controller
from eldir.design import Design, marked_masses
from eldir.errors import EldirError, InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.morphology import develop
from eldir.scene import Scene
from eldir.trajectory import Trajectory
from eldir_app.commands.track import track as track_command
from eldir_hardware.camera.plane import FieldOfView, TagBoard
from eldir_hardware.images.jpeg import decode
from eldir_hardware.log.reader import read_attachment, read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.vision.pipeline import track_frames, track_log
from eldir_hardware.vision.recording_setup import calibrate_from_frames
from eldir_hardware.vision.sources import open_source
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.vision.walking_films import (
    NAMES,
    TIMES,
    rms_mm,
    truth,
)
from tests.paths import SCHEMAS
from tests.raised import raises


@pytest.mark.parametrize(("name", "worst_mm"), [("walk.avi", 0.3), ("pictures", 0.1), ("walk.mcap", 0.1)])
def test_every_source_gives_the_same_motion(recordings: Path, name: str, worst_mm: float) -> None:
    source = open_source(recordings / name, rate=10.0)
    found = track_frames(
        source, calibrate_from_frames(source, TagBoard.load(recordings / "tags.json"))
    ).trajectory
    np.testing.assert_allclose(found.times, TIMES[:20], atol=1e-6)
    assert rms_mm(found.positions, truth(TIMES[:20])) < worst_mm


def test_bad_sources_are_named(recordings: Path, tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "cut.avi").write_bytes((recordings / "walk.avi").read_bytes()[:3000])
    (tmp_path / "nothing.mp4").write_bytes(b"")
    (tmp_path / "noise.mp4").write_bytes(bytes(range(128, 256)) * 8)
    (tmp_path / "log.mp4").write_bytes((recordings / "walk.mcap").read_bytes())
    (tmp_path / "empty").mkdir()
    for path, rate, code, said in (
        (tmp_path / "none.mp4", None, "file.missing", r"none\.mp4"),
        (tmp_path / "text.mp4", None, "file.other-kind", r"text\.mp4 is a text file"),
        (tmp_path / "cut.avi", None, "film.not-decoded", r"cut\.avi .* 3000 bytes; it was cut off"),
        (tmp_path / "nothing.mp4", None, "file.empty", r"nothing\.mp4"),
        (tmp_path / "noise.mp4", None, "film.not-decoded", r"noise\.mp4"),
        (tmp_path / "log.mp4", None, "file.other-kind", r"log\.mp4 is an MCAP log .* rename it"),
        (Path("/dev/null"), None, "file.not-a-file", "/dev/null"),
        ("http:/127.0.0.1/video", None, "camera.no-address", "http:/127.0.0.1/video"),
        ("ftp://127.0.0.1/video", None, "camera.no-address", "ftp://127.0.0.1/video"),
        ("file:///walk.mp4", None, "camera.no-address", "file:///walk.mp4"),
        ("camera:", None, "camera.no-address", "camera:"),
        ("camera:99999999999", None, "camera.no-address", "camera:99999999999"),
        ("", None, "camera.no-address", "the name of the source is empty"),
        (tmp_path / "empty", 10.0, "film.no-pictures", "empty"),
        (recordings / "pictures", None, "film.no-timestamps", "give their rate"),
    ):
        with raises(InputError, code, match=said):
            list(open_source(path, rate))
    # In a process of its own, where nothing has used a video before: not a word from the codecs.
    code = "import sys; from eldir_hardware.vision.sources import open_source; list(open_source(sys.argv[1]))"
    call = [sys.executable, "-c", code, str(tmp_path / "text.mp4")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert "moov" not in done.stderr and "WARN" not in done.stderr
    assert "InputError" in done.stderr


def test_a_picture_that_claims_to_be_huge_is_named(tmp_path: Path) -> None:
    """60000 x 60000 pixels in a header."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "huge.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with raises(InputError, "film.not-decoded", match=r"huge\.png"):
        list(open_source(tmp_path, rate=1.0))
    with raises(InputError, "file.damaged"):
        decode(np.frombuffer((tmp_path / "huge.png").read_bytes(), np.uint8))


def test_an_address_keeps_its_slashes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def refuse(name: object, *_: object) -> None:
        asked.append(name)
        raise InputError("no camera here")

    monkeypatch.setattr("eldir_hardware.vision.sources.open_source", refuse)
    command = typer.Typer()
    command.command()(track_command)
    CliRunner().invoke(command, ["http://127.0.0.1:9/video", "--out", str(tmp_path / "tracks.json")])
    assert asked == ["http://127.0.0.1:9/video"]


def test_the_command_writes_trajectory_plane_and_overlay(recordings: Path, tmp_path: Path, capsys) -> None:
    out, overlay, plane = tmp_path / "walk.json", tmp_path / "walk.png", tmp_path / "plane.json"
    track_command(recordings / "walk.mcap", out=out, overlay=overlay, save_plane=plane)
    assert "20 frames over 1.9 s" in capsys.readouterr().out
    jsonschema.validate(
        json.loads(out.read_text()), json.loads((SCHEMAS / "trajectory.schema.json").read_text())
    )
    found = Trajectory.load(out)
    assert found.names == NAMES
    assert rms_mm(found.positions, truth(TIMES[:20])) < 0.1
    assert cv2.imread(str(overlay)).shape == (960, 1280, 3)
    again = tmp_path / "again.json"
    track_command(recordings / "walk.mcap", out=again, plane=plane)
    assert Trajectory.load(again) == found
    with raises(EldirError, "file.exists", match=r"walk\.png"):
        track_command(recordings / "walk.mcap", out=tmp_path / "no.json", overlay=overlay)
    with raises(InputError, "film.no-plane"):
        track_command(recordings / "walk.avi", out=tmp_path / "no.json")
    assert not (tmp_path / "no.json").exists()


def test_what_a_video_lacks_is_told(recordings: Path, tmp_path: Path, capsys) -> None:
    whole, cut = recordings / "walk.avi", tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    for film, note in ((whole, ""), (cut, "announces 2.0 s, ")):
        track_command(str(film), out=tmp_path / f"{film.stem}.json", tags=recordings / "tags.json")
        said = capsys.readouterr().out
        assert ("announces" in said) == bool(note) and note in said


def test_outputs_have_names_of_their_own(recordings: Path, tmp_path: Path) -> None:
    film, out = str(recordings / "walk.mcap"), tmp_path / "walk.json"
    with raises(EldirError, "file.named-twice", match=r"walk\.json"):
        track_command(film, out=out, save_plane=tmp_path / "." / "walk.json")
    with raises(InputError, "file.wrong-extension", match=r"--overlay; .*\.png"):
        track_command(film, out=out, overlay=tmp_path / "walk.txt")
    assert not list(tmp_path.iterdir())


def test_trajectory_files_keep_what_was_not_seen(tmp_path: Path) -> None:
    positions = np.array([[[0.1, 0.2], [np.nan, np.nan]]])
    there = Trajectory(("m1", "m2"), np.array([0.5]), positions)
    there.save(tmp_path / "t.json")
    assert Trajectory.load(tmp_path / "t.json") == there
    values = json.loads((tmp_path / "t.json").read_text())
    assert values["positions_m"] == [[[0.1, 0.2], [None, None]]]
    (tmp_path / "bad.json").write_text(json.dumps(values | {"times_s": [1, 2]}))
    with pytest.raises(InputError, match=r"bad\.json"):
        Trajectory.load(tmp_path / "bad.json")


def test_a_log_with_its_design_is_all_it_takes(tmp_path: Path) -> None:
    lattice = Lattice(6, 11)
    body = random_genotypes(lattice, 1, np.random.default_rng(3), 2)[0]
    robot = develop(lattice, body)
    controller = Controller.random(len(robot.positions), robot.motors, np.random.default_rng(0))
    design = Design(lattice, body, controller, Scene.preset("paper"))
    places, marked = robot.positions - np.array([0, 0.09]), marked_masses(robot)
    camera = VirtualCamera(2, FieldOfView.around(places))
    with Recorder(tmp_path / "a.mcap") as log:
        log.attach("tags.json", json.dumps(camera.board.to_json()).encode())
        log.attach("design.json", json.dumps(design.to_json()).encode())
        for i in range(12):
            log.on_frame(0.1 * i, camera.render(places + np.array([0.004 * i, 0]), robot.springs, marked))
    found = track_log(read_log(tmp_path / "a.mcap"))
    true = np.array([places[marked] + np.array([0.004 * i, 0]) for i in range(12)])
    assert found.names == NAMES[: len(marked)]
    assert rms_mm(found.positions, true) < 0.1


def test_files_attached_to_a_recording_are_named_where_they_are_damaged() -> None:
    assert read_attachment({}, "run.mcap", "rig.yaml", dict) is None
    assert read_attachment({"rig.yaml": b"a: 1"}, "run.mcap", "rig.yaml", dict) == {"a": 1}
    for name, data in (("rig.yaml", b"a: ["), ("rig.yaml", b"\xff\xfe\x00"), ("design.json", b"{")):
        with raises(InputError, "file.damaged", match=f"{name} in run.mcap .*found"):
            read_attachment({name: data}, "run.mcap", name, dict)


def test_a_damaged_attachment_is_named(filmed, tmp_path: Path) -> None:
    _, frames, _ = filmed
    with Recorder(tmp_path / "a.mcap") as log:
        log.attach(
            "tags.json",
            b'{"format": "eldir-tags/1", "dictionary": "DICT_4X4_50", "tags": []}',
        )
        log.on_frame(*frames[0])
    with pytest.raises(InputError, match=r"tags\.json in .*a\.mcap is damaged.*side_m"):
        track_log(read_log(tmp_path / "a.mcap"))
