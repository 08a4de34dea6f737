"""The whole circle of a robot on a terrain, small: evolution, shortlist, packet, virtual rig, report."""

from __future__ import annotations

import asyncio
import csv
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from eldir.built import samples
from eldir.built.gait import read_gait
from eldir.built.ground import lay_on_table
from eldir.built.robot import build
from eldir.built.samples import IdentifiedRobots, simulate_most_probable
from eldir.built.scene import PrintedScene
from eldir.built.walking import walk
from eldir.core.files import write_bytes, write_text
from eldir.core.worker_process import WorkerProcess
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir.terrain import Terrain, TerrainFile
from eldir_app.application import application
from eldir_app.watch.followed_run import FollowedRun
from eldir_app.watch.run_view import RunView
from eldir_calibration.comparison.motions import prepare_report
from eldir_calibration.comparison.recorded_run import open_run
from eldir_calibration.identification.identification import read_films
from eldir_calibration.report.comparison import MotionReport
from eldir_calibration.report.page import ReportInput, write_report
from eldir_hardware.images.video import write_webm
from eldir_hardware.log.reader import read_log
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.drive import DriveConfig, drive_rig
from eldir_hardware.virtual.bodies import default_physics
from eldir_hardware.virtual.rig import BodyFrame
from eldir_hardware.vision.printed_ground import CORNER, predict_ground
from eldir_hardware.vision.sources import LoggedFrames
from tests.raised import raises

pytestmark = [pytest.mark.stress, pytest.mark.timeout(3600)]

_X = np.array([-1.0, *np.arange(0.0, 1.2, 0.06)])
_SLOPES = np.array([0.0, *np.resize([0.1, -0.06], len(_X) - 1)])
"""Waves of a few millimetres that rise on average: a robot of the table walks on them too."""
_HEIGHTS = np.concatenate([[0.0], np.cumsum(np.diff(_X) * _SLOPES[:-1])])
WAVES = Terrain(_X, _SLOPES, _HEIGHTS - _SLOPES * _X)


@dataclass(frozen=True)
class Circle:
    folder: Path
    packet_said: str
    design: Design
    truth: list[BodyFrame]
    content: ReportInput
    report: MotionReport


def invoke(*arguments: str) -> str:
    result = CliRunner().invoke(application(), list(arguments))
    assert result.exit_code == 0, (arguments, result.output, result.exception)
    return result.output


@pytest.fixture(scope="module")
def circle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Circle]:
    """As `eldir demo` plays it, but on a terrain: commands as far as they have options for a small size."""
    folder = tmp_path_factory.mktemp("circle")
    with pytest.MonkeyPatch.context() as shorter:  # how far it walks in the end is no matter here
        shorter.setattr(samples, "CYCLES", 1)
        yield _play(folder)


def _play(folder: Path) -> Circle:
    TerrainFile("printed", WAVES).save(folder / "waves.json")
    size = ["--population", "4", "--generations", "0", "--seed", "5", "--lattice", "4x7"]
    ground = ["--terrain", str(folder / "waves.json")]
    invoke("evolve", "--objective", "printed", *size, *ground, "--out", str(folder / "run"))
    invoke("shortlist", str(folder / "run"), "--top", "1", "--out", str(folder / "shortlist"))
    design_file = folder / "shortlist" / "design_01.json"
    write_text(folder / "prices.yaml", "{format: eldir-prices/1, currency: EUR, resin_kg: 200}")
    priced = ["--prices", str(folder / "prices.yaml")]
    said = invoke("packet", str(design_file), "--out", str(folder / "packet"), *priced)
    design = Design.load(folder / "packet" / "design.json")
    write_text(folder / "rig.yaml", virtual_rig(4, "packet/design.json", physics=default_physics()))
    rig = Rig.load(folder / "rig.yaml")
    schedule = plan(design, rig, PlanConfig(seed=4, samples=2, cycles=1))
    schedule.save(folder / "schedule.json")
    truth: list[BodyFrame] = []
    driving = DriveConfig(folder / "packet" / "design.json", on_body=truth.append)
    drive_rig(schedule, rig, folder / "rig.yaml", folder / "log.mcap", driving)
    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        content = prepare_report(folder / "log.mcap", design, worker, samples=2)
    report = write_report(content, folder / "report")
    return Circle(folder, said, design, truth, content, report)


def test_every_stage_knows_the_ground(circle: Circle) -> None:
    run = json.loads((circle.folder / "run" / "run.json").read_text())
    assert run["config"]["terrain"] == WAVES.to_json()
    assert circle.design.printed_terrain == WAVES
    assert TerrainFile.load(circle.folder / "packet" / "ground" / "terrain.json").terrain == WAVES
    assert len(list((circle.folder / "packet" / "ground").glob("ground_*.stl"))) > 1


def test_the_packet_prices_the_resin_of_robot_and_ground(circle: Circle) -> None:
    with (circle.folder / "packet" / "bom.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["weight_g"]]
    assert {"ground_01", "passive_spring"} <= {row["part"] for row in rows}
    grams = sum(float(row["weight_g"]) * int(row["count"]) for row in rows)
    cost, robot = re.search(r"cost: robot (at least ([\d.]+) EUR), bench", circle.packet_said).groups()
    assert float(robot) == pytest.approx(0.2 * grams, abs=0.02), cost
    assert "without a price: resin of supports, shape_memory_spring" in circle.packet_said


def test_the_virtual_robot_stands_on_the_printed_ground(circle: Circle) -> None:
    """In every frame its lowest corners touch the surface, which is as high over the table as the plate."""
    terrain = lay_on_table(circle.design)
    assert terrain is not None
    corner = BuiltParameters().with_hubs().corner if default_physics() == "mujoco" else 0.0
    over = [
        (frame.positions[:, 1] - corner - terrain.height(frame.positions[:, 0])).min()
        for frame in circle.truth[5:]
    ]
    assert min(over) > -0.003 and max(over) < 0.003
    assert min(frame.positions[:, 1].min() for frame in circle.truth) > 0.012


def test_the_film_is_near_the_prediction_on_the_ground(circle: Circle) -> None:
    """In the first second the prediction stands as the filmed robot does; and the walk that the report says
    is that of the virtual robot."""
    found, film = circle.report.displacement, circle.content.tracked
    first = np.array([f.positions for f in circle.truth if f.time_s <= film.start])[-1]
    marks = circle.design.marks
    walked = (circle.truth[-1].positions - first)[marks, 0].mean() / film.body_length * 5 / film.cycles
    assert found["tracked"] == pytest.approx(walked, abs=0.1)
    assert np.isfinite(found["predicted"]) and np.isfinite(found["simulated"])


def test_the_report_draws_the_ground_and_says_what_is_not_measured(circle: Circle) -> None:
    assert any("printed ground" in remark for remark in circle.content.remarks)
    assert "Where the ground lies is not measured" in (circle.folder / "report" / "index.html").read_text()
    overlay = circle.content.overlay
    assert overlay is not None
    check_line_on_painted_ground(overlay)


def check_line_on_painted_ground(overlay: bytes) -> None:
    pixels = np.asarray(Image.open(BytesIO(overlay)).convert("RGB")).astype(int)
    cyan = (pixels[..., 0] < 60) & (pixels[..., 1] > 220) & (pixels[..., 2] > 220)
    rows, columns = np.nonzero(cyan)
    assert np.ptp(columns) > 0.3 * pixels.shape[1]
    # The painted ground, which is darker than the wall, begins at the line.
    inside = np.unique(columns)[20:-20:10]
    edges = [int(rows[columns == c].max()) for c in inside]
    below = np.array([pixels[e + 8, c].mean() for e, c in zip(edges, inside, strict=True)])
    above = np.array([pixels[e - 14, c].mean() for e, c in zip(edges, inside, strict=True)])
    assert np.median(above - below) > 15


def test_tracking_draws_the_ground_where_the_virtual_one_is(circle: Circle) -> None:
    """To 2 mm, though it does not know where that is."""
    log, overlay = circle.folder / "log.mcap", circle.folder / "track.png"
    invoke("track", str(log), "--out", str(circle.folder / "track.json"), "--overlay", str(overlay))
    check_line_on_painted_ground(overlay.read_bytes())
    rig, terrain = Rig.load(circle.folder / "rig.yaml"), lay_on_table(circle.design)
    predicted, path = predict_ground(circle.design, rig), circle.content.tracked.trajectory
    assert predicted is not None and terrain is not None
    line = predicted.in_plane(path.times, path.positions)
    assert line is not None
    corner = 0.0 if default_physics() == "mujoco" else CORNER
    assert line[:, 1] == pytest.approx(terrain.height(line[:, 0]) - corner, abs=0.002)


def test_a_camera_s_film_without_a_run_shows_no_ground(circle: Circle) -> None:
    """Nobody knows where the robot stood when such a film began."""
    frames, name = LoggedFrames(read_log(circle.folder / "log.mcap")), "film.webm"
    write_webm(circle.folder / name, (image[..., ::-1] for _, image in islice(frames, 20)), 10.0)
    write_bytes(circle.folder / "tags.json", frames.attachments["tags.json"])
    files = [
        "--tags",
        str(circle.folder / "tags.json"),
        "--design",
        str(circle.folder / "packet/design.json"),
    ]
    out = ["--out", str(circle.folder / "film.json"), "--overlay", str(circle.folder / "film.png")]
    said = invoke("track", str(circle.folder / name), *files, *out)
    assert "The printed ground is not drawn" in said
    pixels = np.asarray(Image.open(circle.folder / "film.png").convert("RGB")).astype(int)
    assert not ((pixels[..., 0] < 60) & (pixels[..., 1] > 220) & (pixels[..., 2] > 220)).any()


_NOT_YET = (None, "computing")


def test_the_live_page_gets_the_line_of_the_report(circle: Circle) -> None:
    async def follow() -> RunView:
        run = FollowedRun(None, circle.folder / "log.mcap")
        reading = asyncio.create_task(run.run())
        async with asyncio.timeout(120):
            while run.view is None or run.view.ground is None or run.view.prediction in _NOT_YET:
                await asyncio.sleep(0.1)
        reading.cancel()
        await asyncio.gather(reading, *run._readers, return_exceptions=True)  # its processes have ended
        return run.view

    view = asyncio.run(follow())
    begin, end = circle.content.tracked.start, circle.content.tracked.period * circle.content.tracked.cycles
    assert isinstance(view.prediction, list), view.prediction
    assert view.prediction[0] == [begin, 0.0, 0.0, 0.0]
    t, mean, low, high = view.prediction[-1]
    assert t == pytest.approx(begin + end) and low < mean < high, "as many cycles as the schedule has"
    ground = view.ground
    assert ground is not None and ground["colour"] == "rgb(0 255 255)"
    plane, path = circle.content.plane, circle.content.tracked.trajectory
    predicted = predict_ground(circle.design, Rig.load(circle.folder / "rig.yaml"))
    assert plane is not None and predicted is not None
    line = predicted.in_plane(path.times, path.positions)
    assert line is not None
    assert np.array(ground["corners"]) == pytest.approx(plane.to_pixels(line), abs=0.5)


@pytest.fixture(scope="module")
def scene(circle: Circle) -> Path:
    """A robot as `eldir calibrate dynamics` identifies it on a table: its springs contract less."""
    nominal = Rig.load(circle.folder / "rig.yaml").nominal_robot()
    found = PrintedScene.of(nominal.at(["hot_length"], [-1.0]), (), np.zeros((0, 0)))
    found.save(circle.folder / "scene.json")
    return circle.folder / "scene.json"


def test_walks_of_an_identified_robot_are_those_on_the_ground(circle: Circle, scene: Path) -> None:
    """As `eldir gait --scene` predicts them; the whole search takes two minutes."""
    known, gait = PrintedScene.load(scene), read_gait(circle.design)
    assert gait is not None
    body, ground = circle.design.morphology, circle.design.printed_terrain
    robots = IdentifiedRobots.of(circle.design, known, [])
    found = simulate_most_probable(robots, [gait], cycles=1)
    # But for rounding, and for the free lengths of the identified springs.
    assert found == pytest.approx(
        [walk(build(body, known.robot), gait, known.springs, cycles=1, terrain=ground)], abs=0.05
    )
    table = IdentifiedRobots.of(replace(circle.design, printed_terrain=None), known, [])
    assert abs(simulate_most_probable(table, [gait], cycles=1)[0] - found[0]) > 0.1


def test_a_report_predicts_an_identified_robot_on_the_ground(circle: Circle, scene: Path) -> None:
    log = circle.folder / "log.mcap"
    with WorkerProcess("eldir_calibration.comparison.predictions") as worker:
        content = prepare_report(log, circle.design, worker, scene=PrintedScene.load(scene), samples=2)
    assert content.before is not None and content.before.trajectory == circle.content.predicted.trajectory
    known, nominal = content.predicted.trajectory.positions, content.before.trajectory.positions
    assert np.abs(known - nominal).max() > 1e-3
    assert known[10, :, 1] == pytest.approx(nominal[10, :, 1], abs=0.002)  # cold, on the same ground


def test_wrong_scenes_and_a_design_without_the_ground_are_refused(circle: Circle, scene: Path) -> None:
    design, rig, out = (
        circle.folder / "packet" / "design.json",
        circle.folder / "rig.yaml",
        circle.folder / "no",
    )
    table = circle.folder / "table.json"
    replace(circle.design, printed_terrain=None).save(table)
    gait = ["gait", str(design), "--rig", str(rig), "--out", str(out)]
    report = ["report", str(circle.folder / "log.mcap"), "--out", str(out)]
    for wrong in ("waves.json", "missing.json"):
        for command in (gait, [*report, "--design", str(design)]):
            result = CliRunner().invoke(application(), [*command, "--scene", str(circle.folder / wrong)])
            assert result.exit_code == 1 and wrong in str(result.exception)
    refused = [*report, "--design", str(table), "--scene", str(scene)]
    result = CliRunner().invoke(application(), refused)
    assert isinstance(result.exception, InputError) and result.exception.code == "log.other-design"
    assert not out.exists()


def test_a_log_on_a_ground_is_not_taken_for_one_on_a_table(circle: Circle) -> None:
    table = replace(circle.design, printed_terrain=None)
    with raises(InputError, "log.other-design", match="another ground"):
        open_run(circle.folder / "log.mcap", table)
    with raises(InputError, "dynamics.terrain", match="printed ground"):
        read_films([circle.folder / "log.mcap"], circle.design)
