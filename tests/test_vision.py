"""Eyes: the plane from tags, discs to a part of a pixel, and tracks against the virtual camera's truth."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hardware.vision
from calibration.camera import calibrate_plane
from calibration.plane import Plane, TagBoard, Workspace
from eldir.controller import Controller
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.genotype import random_genotypes
from eldir.lattice import Lattice
from eldir.marks import marked_masses
from eldir.morphology import develop
from eldir.scene import Scene
from eldir.trajectory import Trajectory
from hardware.commands.track import track as track_command
from hardware.log.reader import read_log
from hardware.log.recorder import Recorder
from hardware.vision import jpeg
from hardware.vision.colour import ColourModel
from hardware.vision.disc import measure
from hardware.vision.pipeline import plane_of, track, track_log
from hardware.vision.sheet import MARK_DIAMETER, PALETTE
from hardware.vision.sources import open_source
from hardware.vision.tracker import Tracker
from hardware.vision.virtual_camera import VirtualCamera

NAMES = tuple(PALETTE)
SCHEMAS = Path(__file__).parent.parent / "docs" / "schemas"

# A rear edge of five masses that carry the marks, and five more columns of body before it.
_ROWS = np.arange(5)
BODY = np.concatenate(
    [np.stack([0.05 * c + 0.025 * (_ROWS % 2), 0.014 + 0.0433 * _ROWS], axis=1) for c in range(6)]
)
SPRINGS = np.array([(i, j) for j in range(30) for i in range(j) if np.hypot(*(BODY[i] - BODY[j])) < 0.06])
MARKED = np.arange(5)
SPACE = Workspace.around(BODY)
TIMES = np.arange(0, 6, 0.1)


def walk(t: float) -> np.ndarray:
    """The body at time t [m]: it travels, stretches, lifts and turns."""
    angle = 0.12 * np.sin(0.7 * t)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    stretched = BODY * [1 + 0.1 * np.sin(1.3 * t), 1 + 0.05 * np.sin(2 * t)]
    return stretched @ turn.T + [0.02 * t, 0.02]


def film(camera: VirtualCamera, times: np.ndarray = TIMES, motion=walk) -> list[tuple[float, np.ndarray]]:
    return [(t, camera.render(motion(t), SPRINGS, MARKED)) for t in times.tolist()]


def truth(times: np.ndarray = TIMES, motion=walk) -> np.ndarray:
    return np.array([motion(t)[MARKED] for t in times])


def rms_mm(found: np.ndarray, true: np.ndarray) -> float:
    return float(1e3 * np.sqrt(np.nanmean(((found - true) ** 2).sum(axis=-1))))


def cover(image: np.ndarray, camera: VirtualCamera, place: np.ndarray, width: float = 0.03) -> None:
    """Hold a grey card before a place in the picture."""
    x, y = np.round(camera._secrets.lens.to_pixels(place)).astype(int)
    half = round(width / 2 * camera._secrets.lens.pixels_per_metre(place))
    image[y - half : y + half + 1, x - half : x + half + 1] = 90


@pytest.fixture(scope="module")
def filmed() -> tuple[VirtualCamera, list[tuple[float, np.ndarray]], Plane]:
    camera = VirtualCamera(7, SPACE)
    frames = film(camera)
    return camera, frames, calibrate_plane([image for _, image in frames[:10]], camera.board)


# The plane


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
    plane = Plane((640, 480), homography, centre, k, 0.0)
    points = np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2))
    matrix = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    solid = np.column_stack([points, np.zeros(50)])
    expected, _ = cv2.projectPoints(solid, cv2.Rodrigues(turn)[0], shift, matrix, lens)
    np.testing.assert_allclose(plane.to_pixels(points), expected[:, 0], atol=1e-6)


@given(st.integers(0, 50), st.floats(-0.3, 0.5), st.floats(0, 0.3))
def test_pixels_and_metres_are_inverse(seed: int, x: float, y: float) -> None:
    from hardware.vision.virtual_camera import _pose

    lens = _pose(np.random.default_rng(seed), TagBoard.around(SPACE), (640, 480))
    there = lens.to_pixels(np.array([x, y]))
    np.testing.assert_allclose(lens.to_metres(there), [x, y], atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_plane_found_from_the_picture_is_the_cameras(seed: int) -> None:
    camera = VirtualCamera(seed, SPACE)
    plane = calibrate_plane([image for _, image in film(camera, TIMES[:10])], camera.board)
    x, y = np.linspace(SPACE.x_from, SPACE.x_to, 20), np.linspace(0, SPACE.height, 8)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    error = np.linalg.norm(plane.to_metres(camera._secrets.lens.to_pixels(points)) - points, axis=-1)
    assert error.max() < 2e-4
    assert np.sqrt((error**2).mean()) < 1e-4
    assert plane.rms_px < 0.1
    again = Plane.from_json(json.loads(json.dumps(plane.to_json())))
    assert again == plane
    for values, name in ((plane.to_json(), "plane"), (camera.board.to_json(), "tags")):
        jsonschema.validate(values, json.loads((SCHEMAS / f"{name}.schema.json").read_text()))


def test_apriltags_serve_as_well() -> None:
    board = TagBoard.around(SPACE)
    board = TagBoard(board.ids, board.centres, 0.07, "DICT_APRILTAG_36h11")
    camera = VirtualCamera(3, SPACE, board=board)
    plane = calibrate_plane([image for _, image in film(camera, TIMES[:5])], board)
    assert rms_mm(plane.to_metres(camera._secrets.lens.to_pixels(BODY)), BODY) < 0.1


def test_too_few_or_misplaced_tags_are_named(filmed) -> None:
    camera, frames, _ = filmed
    image = frames[0][1].copy()
    for centre in camera.board.centres[:-3]:
        cover(image, camera, centre, 0.08)
    with pytest.raises(InputError, match="too few tags"):
        calibrate_plane([image], camera.board)
    small = TagBoard(camera.board.ids, camera.board.centres, 0.03)
    with pytest.raises(InputError, match="too few tags"):
        calibrate_plane([VirtualCamera(1, SPACE, board=small).render(BODY, SPRINGS, MARKED)], small)
    moved = camera.board.centres.copy()
    moved[2] += 0.01
    with pytest.raises(InputError, match="do not lie"):
        calibrate_plane([frames[0][1]], TagBoard(camera.board.ids, moved))
    with pytest.raises(InputError, match="unknown tag dictionary"):
        calibrate_plane(
            [frames[0][1]], TagBoard(camera.board.ids, camera.board.centres, dictionary="DICT_NONE")
        )


# Discs


def test_a_circles_centroid_is_its_centre_within_a_fiftieth_of_a_millimetre() -> None:
    """Perspective moves the centroid of a projected circle off its centre: how much, exactly."""
    from hardware.vision.virtual_camera import _pose

    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    for seed in range(10):
        lens = _pose(np.random.default_rng(seed), TagBoard.around(SPACE), (640, 480))
        for place in np.array([(SPACE.x_from, 0), (SPACE.x_to, SPACE.height)]):
            ring = place + MARK_DIAMETER / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            x, y = lens.to_pixels(ring).T
            cross = x * np.roll(y, -1) - y * np.roll(x, -1)
            area = cross.sum() / 2
            centroid = np.array([((v + np.roll(v, -1)) * cross).sum() for v in (x, y)]) / (6 * area)
            assert np.linalg.norm(lens.to_metres(centroid) - place) < 2e-5


def test_rendered_discs_are_where_the_lens_projects_them() -> None:
    camera = VirtualCamera(5, SPACE, noise=0.0)
    lens = camera._secrets.lens
    colour = ColourModel.learn(camera.render(walk(0), SPRINGS, MARKED))
    for t in np.linspace(0, 5, 30):
        body = walk(t)
        image = camera.render(body, SPRINGS, MARKED)
        for mass in MARKED:
            true = lens.to_pixels(body[mass])
            disc = measure(image, colour, true + 1.0, MARK_DIAMETER / 2 * lens.pixels_per_metre(body[mass]))
            assert disc is not None
            assert np.linalg.norm(disc.centre - true) < 0.04  # of which rounding to 8 bits is a part


def test_same_seed_same_frames_and_others_differ() -> None:
    first, second = (VirtualCamera(4, SPACE).render(BODY, SPRINGS, MARKED) for _ in range(2))
    assert first.dtype == np.uint8 and first.shape == (480, 640, 3)
    assert np.array_equal(first, second)
    assert not np.array_equal(first, VirtualCamera(5, SPACE).render(BODY, SPRINGS, MARKED))


# Tracks


@pytest.mark.parametrize("seed", range(3))
def test_tracks_agree_with_the_truth(seed: int) -> None:
    camera = VirtualCamera(seed, SPACE)
    frames = film(camera)
    found = track(frames, calibrate_plane([f for _, f in frames[:10]], camera.board), layout=BODY[MARKED])
    assert np.isfinite(found.positions).all()
    assert rms_mm(found.positions, truth()) < 0.1
    lens = camera._secrets.lens
    off = lens.to_pixels(found.positions) - lens.to_pixels(truth())
    assert np.sqrt((off**2).sum(axis=-1).mean()) < 0.05


def test_tracks_from_the_logs_jpeg_agree_with_the_truth(filmed) -> None:
    camera, frames, _ = filmed
    images = [(t, jpeg.decode(jpeg.encode(image))) for t, image in frames]
    assert np.mean([len(jpeg.encode(image)) for _, image in frames]) < 20_000
    plane = calibrate_plane([image for _, image in images[:10]], camera.board)
    found = track(images, plane, layout=BODY[MARKED])
    assert np.isfinite(found.positions).all()
    assert rms_mm(found.positions, truth()) < 0.1


def test_noise_light_and_blur_of_a_poor_camera() -> None:
    camera = VirtualCamera(11, SPACE, noise=6.0)
    frames = [(t, cv2.GaussianBlur(image, (0, 0), 0.9)) for t, image in film(camera)]
    found = track(frames, calibrate_plane([f for _, f in frames[:10]], camera.board), layout=BODY[MARKED])
    assert np.isfinite(found.positions).mean() > 0.99
    assert rms_mm(found.positions, truth()) < 0.2


def test_what_is_covered_is_nan_and_found_again(filmed) -> None:
    camera, frames, plane = filmed
    hidden = []
    for i, (t, whole) in enumerate(frames):
        image = whole.copy()
        if 20 <= i < 30:
            cover(image, camera, truth()[i, 2])
        hidden.append((t, image))
    found = track(hidden, plane, layout=BODY[MARKED]).positions
    missing = np.isnan(found[..., 0])
    assert missing[20:30, 2].all()
    assert missing.sum() == 10
    assert rms_mm(found, truth()) < 0.1


def test_a_half_covered_mark_is_right_or_missing(filmed) -> None:
    """A card slides over m3 pixel by pixel: a centroid of what is left would be millimetres off."""
    camera, frames, plane = filmed
    lens = camera._secrets.lens
    tracker = Tracker(plane, NAMES, BODY[MARKED])
    tracker.update(frames[0][1], 0.0)
    x, y = np.round(lens.to_pixels(truth()[0, 2])).astype(int)
    outcomes = []
    for edge in np.arange(-12, 13):
        image = frames[0][1].copy()
        image[y - 15 : y + 16, x - 20 : x + edge] = 90
        found = tracker.update(image, 0.1 + 0.01 * edge)[2]
        outcomes.append(np.isnan(found[0]))
        assert np.isnan(found[0]) or np.linalg.norm(found - truth()[0, 2]) < 6e-4
    assert outcomes[-1] and not outcomes[0]


def test_marks_that_cross_keep_their_names(filmed) -> None:
    """m2 and m4 swap places, one passing before the other."""

    def swap(t: float) -> np.ndarray:
        body = BODY + np.array([0.1, 0.02])
        middle, reach = (body[1] + body[3]) / 2, (body[3] - body[1]) / 2
        turn = np.pi * np.clip((t - 1) / 3, 0, 1)
        side = np.array([np.sin(2 * turn) * 0.004, 0])
        body[1], body[3] = middle - reach * np.cos(turn) + side, middle + reach * np.cos(turn) - side
        return body

    camera, _, plane = filmed
    found = track(film(camera, TIMES, swap), plane, layout=BODY[MARKED]).positions
    error = np.linalg.norm(found - truth(TIMES, swap), axis=-1)
    assert np.nanmax(error) < 1e-3
    assert np.isfinite(error[-10:]).all()
    assert np.isfinite(error[:, [0, 2, 4]]).mean() > 0.7  # m3 is in between for a while


def test_coloured_things_about_do_not_confuse(filmed) -> None:
    _, frames, plane = filmed
    red, blue = (tuple(int(c) for c in PALETTE[m][::-1]) for m in ("m1", "m4"))
    disturbed = []
    for t, whole in frames:
        image = whole.copy()
        cv2.circle(image, (600, 250), 30, red, -1)
        cv2.rectangle(image, (560, 180), (570, 200), blue, -1)
        disturbed.append((t, image))
    found = track(disturbed, plane, layout=BODY[MARKED])
    assert rms_mm(found.positions, truth()) < 0.1


def test_fewer_marks_than_five(filmed) -> None:
    camera, _, plane = filmed
    frames = [(t, camera.render(walk(t), SPRINGS, MARKED[:3])) for t in TIMES[:10].tolist()]
    found = track(frames, plane, NAMES[:3], BODY[MARKED[:3]])
    assert rms_mm(found.positions, truth(TIMES[:10])[:, :3]) < 0.1


def test_a_body_that_has_folded_is_tracked_all_the_same(filmed) -> None:
    def folded(t: float) -> np.ndarray:
        bent = BODY.copy()
        bent[3:5] += [[-0.03, -0.02], [-0.07, -0.05]]
        return bent + np.array([0.02 * t + 0.05, 0.02])

    camera, _, plane = filmed
    times = TIMES[:10]
    found = track(film(camera, times, folded), plane, layout=BODY[MARKED])
    assert rms_mm(found.positions, truth(times, folded)) < 0.1


def test_what_is_wrong_with_marks_and_pictures_is_named(filmed) -> None:
    camera, frames, plane = filmed
    bare = [(t, camera.render(walk(t), SPRINGS, MARKED[:0])) for t in (0.0, 0.1)]
    with pytest.raises(InputError, match=r"never seen all together.*m1, m2, m3, m4, m5"):
        track(bare, plane)
    few = [(0.0, camera.render(BODY, SPRINGS, MARKED[:3]))]
    with pytest.raises(InputError, match="none like m4, m5"):
        track(few, plane)
    with pytest.raises(InputError, match=r"as it seems m4 where m2 should be, m2 where m4 should be"):
        track(frames[:3], plane, layout=BODY[[0, 3, 2, 1, 4]])
    with pytest.raises(InputError, match="do not lie as in the design"):
        track(frames[:3], plane, layout=BODY[MARKED[::-1]])
    with pytest.raises(InputError, match=r"640 x 480.*320 x 240"):
        track([(0.0, frames[0][1][::2, ::2])], plane)


def test_the_tracker_knows_nothing_of_the_renderer() -> None:
    folder = Path(hardware.vision.__file__).parent
    for file in folder.glob("*.py"):
        if file.name == "virtual_camera.py":
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            imported = [a.name for a in getattr(node, "names", [])] if isinstance(node, ast.Import) else []
            imported += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any("virtual_camera" in name for name in imported), file.name


# Sources and the command


@pytest.fixture(scope="module")
def recordings(filmed, tmp_path_factory) -> Path:
    """The same 20 frames as video, folder and log, and the tags' places."""
    camera, frames, _ = filmed
    folder = tmp_path_factory.mktemp("recordings")
    (folder / "tags.json").write_text(json.dumps(camera.board.to_json()))
    video = cv2.VideoWriter(str(folder / "walk.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    (folder / "pictures").mkdir()
    with Recorder(folder / "walk.mcap") as log:
        log.attach("tags.json", "application/json", (folder / "tags.json").read_bytes())
        for i, (t, image) in enumerate(frames[:20]):
            video.write(image)
            cv2.imwrite(str(folder / "pictures" / f"frame{i}.png"), image)
            log.on_frame(t, image)
    video.release()
    return folder


@pytest.mark.parametrize(("name", "worst_mm"), [("walk.avi", 0.3), ("pictures", 0.1), ("walk.mcap", 0.1)])
def test_every_source_gives_the_same_motion(recordings: Path, name: str, worst_mm: float) -> None:
    source = open_source(recordings / name, rate=10.0)
    found = track(source, plane_of(source, TagBoard.load(recordings / "tags.json")))
    np.testing.assert_allclose(found.times, TIMES[:20], atol=1e-6)
    assert rms_mm(found.positions, truth(TIMES[:20])) < worst_mm


def test_bad_sources_are_named(recordings: Path, tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("no video")
    (tmp_path / "cut.avi").write_bytes((recordings / "walk.avi").read_bytes()[:3000])
    (tmp_path / "empty").mkdir()
    for path, rate, message in (
        (tmp_path / "none.mp4", None, "does not exist"),
        (tmp_path / "text.mp4", None, "cannot be decoded"),
        (tmp_path / "cut.avi", None, "cannot be decoded"),
        (tmp_path / "empty", 10.0, "holds no pictures"),
        (recordings / "pictures", None, "give their rate"),
    ):
        with pytest.raises(InputError, match=message):
            list(open_source(path, rate))
    # In a process of its own, where nothing has used a video before: not a word from the codecs.
    code = "import sys; from hardware.vision.sources import open_source; list(open_source(sys.argv[1]))"
    call = [sys.executable, "-c", code, str(tmp_path / "text.mp4")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert "moov" not in done.stderr and "WARN" not in done.stderr
    assert "InputError" in done.stderr


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
    with pytest.raises(EldirError, match=r"walk\.png exists already"):
        track_command(recordings / "walk.mcap", out=tmp_path / "no.json", overlay=overlay)
    with pytest.raises(InputError, match="does not say where the plane"):
        track_command(recordings / "walk.avi", out=tmp_path / "no.json")
    assert not (tmp_path / "no.json").exists()


def test_trajectory_files_keep_what_was_not_seen(tmp_path: Path) -> None:
    positions = np.array([[[0.1, 0.2], [np.nan, np.nan]]])
    there = Trajectory(("m1", "m2"), np.array([0.5]), positions)
    there.save(tmp_path / "t.json")
    assert Trajectory.load(tmp_path / "t.json") == there
    values = json.loads((tmp_path / "t.json").read_text())
    assert values["positions_m"] == [[[0.1, 0.2], [None, None]]]
    (tmp_path / "bad.json").write_text(json.dumps(values | {"times_s": [1, 2]}))
    with pytest.raises(InputError, match=r"bad\.json is damaged"):
        Trajectory.load(tmp_path / "bad.json")


def test_a_log_with_its_design_is_all_it_takes(tmp_path: Path) -> None:
    lattice = Lattice(6, 11)
    body = random_genotypes(lattice, 1, np.random.default_rng(3), 2)[0]
    robot = develop(lattice, body)
    controller = Controller.random(len(robot.positions), robot.motors, np.random.default_rng(0))
    design = Design(lattice, body, controller, Scene.preset("paper"))
    places, marked = robot.positions - np.array([0, 0.09]), marked_masses(robot)
    camera = VirtualCamera(2, Workspace.around(places))
    with Recorder(tmp_path / "a.mcap") as log:
        log.attach("tags.json", "application/json", json.dumps(camera.board.to_json()).encode())
        log.attach("design.json", "application/json", json.dumps(design.to_json()).encode())
        for i in range(12):
            log.on_frame(0.1 * i, camera.render(places + np.array([0.004 * i, 0]), robot.springs, marked))
    found = track_log(read_log(tmp_path / "a.mcap"))
    true = np.array([places[marked] + np.array([0.004 * i, 0]) for i in range(12)])
    assert found.names == NAMES[: len(marked)]
    assert rms_mm(found.positions, true) < 0.1


def test_a_damaged_attachment_is_named(filmed, tmp_path: Path) -> None:
    _, frames, _ = filmed
    with Recorder(tmp_path / "a.mcap") as log:
        log.attach("tags.json", "application/json", b'{"tags": []}')
        log.on_frame(*frames[0])
    with pytest.raises(InputError, match=r"tags\.json in .*a\.mcap is damaged.*side_m"):
        track_log(read_log(tmp_path / "a.mcap"))
