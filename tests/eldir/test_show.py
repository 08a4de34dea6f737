"""Pictures and videos of designs."""

import resource
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import typer

from eldir.core.pictures import MOTOR_LONG, MOTOR_SHORT
from eldir.design import marked_masses
from eldir.errors import EldirError, InputError
from eldir.show import Drawing, frames, picture, placed
from eldir_app.commands.show import show
from eldir_hardware.images.video import write_webm
from tests.eldir.random_design import make_design
from tests.raised import raises


def decoded(png: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].astype(int)


def share_of(image: np.ndarray, colour: tuple[int, int, int]) -> float:
    return float((np.abs(image - colour).max(axis=-1) < 12).mean())


MOTORS, GREY, SAND = (213, 94, 0), (154, 154, 154), (217, 205, 184)


def test_a_picture_shows_motors_springs_and_ground():
    design = make_design(3)
    image = decoded(picture(design))
    assert image.shape[1] == 1280
    assert share_of(image, MOTORS) > 0.0003
    assert share_of(image, GREY) > 0.005
    assert share_of(image, SAND) > 0.05
    assert picture(design) == picture(design)
    # Motors are thicker than the others but fewer: a robot all of motors shows more of their colour.
    springs = np.ones_like(design.genotype.springs)
    genotype = type(design.genotype)(design.genotype.triangles, springs)
    everything = SimpleNamespace(
        morphology=replace(design.morphology, active=np.ones(len(design.morphology.springs), bool)),
        scene=design.scene,
        genotype=genotype,
        marks=design.marks,
    )
    image = decoded(picture(everything))
    assert share_of(image, MOTORS) > 0.01
    assert share_of(image, GREY) < 0.003


def test_a_control_robot_keeps_the_marks_of_its_design():
    """With one motor fewer the rule names other masses; the discs are on those of the evolved robot."""
    design = make_design(3)
    kept = tuple(int(mass) for mass in marked_masses(design.morphology)[::-1])
    control = replace(design, kept_marks=kept)
    rest = placed(control)
    drawing = Drawing(control, rest[None])
    drawing.at(rest, np.zeros(control.morphology.motors))
    assert [name.get_text() for name in drawing._names] == [f"m{i}" for i in range(1, len(kept) + 1)]
    assert [name.xy for name in drawing._names] == [tuple(rest[mass]) for mass in kept]


def test_a_robot_is_drawn_above_the_ground():
    design = make_design(1)
    rest = placed(design)
    gap = rest[:, 1] - design.scene.terrain.height(rest[:, 0])
    assert gap.min() == pytest.approx(0.0, abs=1e-12) or gap.min() > 0
    assert np.allclose(np.diff(rest, axis=0), np.diff(design.morphology.positions, axis=0))


def make_motion(design, steps: int):
    rest = placed(design)
    shift = np.linspace(0.0, 0.2, steps + 1)[:, None, None] * [1.0, 0.0]
    actuation = np.linspace(-1.0, 1.0, steps)[:, None].repeat(design.morphology.motors, axis=1)
    return SimpleNamespace(positions=rest + shift, activations=actuation)


def test_a_video_has_the_right_frames(tmp_path):
    design = make_design(2)
    design = replace(design, scene=design.scene.replace(steps=50))
    path = tmp_path / "robot.webm"
    write_webm(path, frames(design, make_motion(design, 50), 25), 25)
    film = cv2.VideoCapture(str(path))
    assert film.get(cv2.CAP_PROP_FPS) == 25
    assert int(film.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little") == b"VP90"
    seen = []
    while (read := film.read())[0]:
        seen.append(read[1].astype(int))
    assert len(seen) == 6  # 0.2 s and both ends
    assert np.abs(seen[0] - seen[-1]).max() > 100  # it moved
    assert [p.name for p in tmp_path.iterdir()] == ["robot.webm"]
    whole = path.read_bytes()
    write_webm(path, frames(design, make_motion(design, 50), 25), 25)
    assert path.read_bytes() == whole, "the same pictures give the same bytes"


def test_motors_are_coloured_by_their_actuation():
    design = make_design(3)
    seen = [f.astype(int) for f in frames(design, make_motion(design, 100), 25)]
    short, long = (tuple(bytes.fromhex(c[1:])) for c in (MOTOR_SHORT, MOTOR_LONG))
    assert share_of(seen[0], short) > 0.0003 > share_of(seen[-1], short)
    assert share_of(seen[-1], long) > 0.0003 > share_of(seen[0], long)
    middle = seen[len(seen) // 2]
    assert share_of(middle, short) < 0.0003 > share_of(middle, long)
    assert share_of(middle, GREY) > 0.005


def test_a_robot_that_blew_up_is_shown_until_then():
    design = make_design(2)
    motion = make_motion(design, 50)
    motion.positions[25:] = np.nan
    assert len(list(frames(design, motion, 25))) == 3


def test_nothing_is_left_of_a_video_that_failed(tmp_path):
    def broken():
        yield np.zeros((64, 64, 3), np.uint8)
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_webm(tmp_path / "a.webm", broken(), 25)
    with pytest.raises(InputError, match="one frame"):
        write_webm(tmp_path / "a.webm", [], 25)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").write_text("")
    with raises(EldirError, "file.not-written"):
        write_webm(tmp_path / "file" / "a.webm", [np.zeros((64, 64, 3), np.uint8)], 25)


NOISE = np.random.default_rng(1).integers(0, 255, (10, 160, 320, 3), np.uint8)


@pytest.fixture(scope="module")
def film_of_noise(tmp_path_factory):
    path = tmp_path_factory.mktemp("noise") / "a.webm"
    write_webm(path, NOISE, 25)
    return path.read_bytes()


@pytest.mark.parametrize("room", [0, 1, 200, 5000, 60_000, 131_000])
def test_a_full_disk_costs_the_new_video_and_not_the_old_one(room, film_of_noise, tmp_path, capfd):
    """No file may grow beyond `room` bytes: each write fails as on a full disk."""
    path, old = tmp_path / "a.webm", film_of_noise
    path.write_bytes(old)
    assert len(old) > 131_000
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, kept[1]))
    try:
        with raises(EldirError, "file.not-written", match=r"a\.webm") as refused:
            write_webm(path, NOISE, 25)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    assert "\n" not in str(refused.value) and capfd.readouterr().err == ""
    assert path.read_bytes() == old and list(tmp_path.iterdir()) == [path]


def test_the_command(tmp_path, capsys):
    path = tmp_path / "design.json"
    make_design(0).save(path)
    show(path)
    assert capsys.readouterr().out.strip() == str(tmp_path / "design.png")
    assert decoded((tmp_path / "design.png").read_bytes()).shape[2] == 3
    with pytest.raises(typer.BadParameter, match=r"\.webm"):
        show(path, tmp_path / "design.gif")


def test_a_rollout_is_filmed(tmp_path):
    path, film = tmp_path / "design.json", tmp_path / "film" / "robot.webm"
    design = make_design(4)
    replace(design, scene=design.scene.replace(steps=30)).save(path)
    show(path, film)
    assert cv2.VideoCapture(str(film)).read()[0]
