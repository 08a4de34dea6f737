"""The whole circle, small, by the installed wheel: every file it writes, and whether the camera is right."""

import csv
import hashlib
import json
import pickle
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from eldir.design import Design, marked_masses
from eldir_app.catalogue.comparison import compared_run
from eldir_app.catalogue.runs import Index, find_runs
from eldir_app.commands.demo import _summary
from eldir_app.commands.packet import packet
from eldir_app.demo import DemoResult, folder_size
from eldir_hardware.planning.plan import PlanConfig, plan
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.virtual.rig import BodyFrame
from tests.installed_wheel import installation
from tests.paths import ROOT, SCHEMAS

pytestmark = [pytest.mark.slow(120), pytest.mark.timeout(3600)]

SEED, SAMPLES, CYCLES = 2, 2, 1
CIRCLE = f"""
import pickle
from pathlib import Path
from eldir.built import samples
from eldir_app.commands.packet import packet
from eldir_app.demo import DemoConfig, run_demo
samples.CYCLES = 1
truth = []
config = DemoConfig({SEED}, population=4, min_generations=0, max_generations=0, finalists=1,
    samples={SAMPLES}, cycles={CYCLES})
found = run_demo(Path("demo"), config, on_frame=truth.append)
Path("found.pickle").write_bytes(pickle.dumps((found, truth)))
"""


@pytest.fixture(scope="module")
def circle(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DemoResult, list[BodyFrame]]:
    """A population too small to walk far, two samples, one cycle; the rest is as in `eldir demo`. The wheel
    plays it, in an environment that holds nothing else, outside the checkout."""
    folder = tmp_path_factory.mktemp("circle")
    result = installation(tmp_path_factory).run("python", "-c", CIRCLE, folder=folder)
    assert result.returncode == 0, result.stderr
    found, truth = pickle.loads((folder / "found.pickle").read_bytes())
    return folder / "demo", found, truth


def test_every_stage_leaves_its_file(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    out, _, _ = circle
    assert {p.name for p in out.iterdir()} == {
        "run", "shortlist", "design.json", "packet", "rig.yaml", "schedule.json", "log.mcap",
        "metadata.yaml", "report",
    }  # fmt: skip
    assert folder_size(out) < 60e6
    for name, file in (("design", "design.json"), ("schedule", "schedule.json"), ("rig", "rig.yaml")):
        schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text())
        jsonschema.validate(yaml.safe_load((out / file).read_text()), schema)
    schedule = json.loads((out / "schedule.json").read_text())
    assert schedule["provenance"]["design"] == "design.json" and schedule["cycles"] == CYCLES


def test_the_report_tells_three_motions(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    out, found, _ = circle
    report = json.loads((out / "report" / "report.json").read_text())
    jsonschema.validate(report, json.loads((SCHEMAS / "report.schema.json").read_text()))
    walk = report["verdict"]["body_lengths_per_5_cycles"]
    low, high = walk["predicted_interval"]
    said = "\n".join(_summary(found))
    assert f"predicted {walk['predicted']:+.2f}, {low:+.2f} to {high:+.2f} for 95 %" in said, "as on the page"
    assert f"filmed    {walk['tracked']:+.2f}, " in said
    assert list(report["masses"]) == [f"m{i}" for i in range(1, len(report["masses"]) + 1)]
    walked = report["body_lengths_per_5_cycles"]
    assert walked == pytest.approx(found.report.displacement, abs=1e-8)
    assert len({round(v, 4) for v in walked.values()}) == 3, "the same motion twice"
    for mass in report["masses"].values():
        assert mass["vertical_range_m"]["predicted"] != mass["vertical_range_m"]["tracked"]
        assert mass["seen"] > 0.9
    assert report["tracking"]["notes"] == [], "a sound film of a sound robot"
    page = (out / "report" / "index.html").read_text()
    assert 'src="http' not in page and 'href="http' not in page, "the page must stand alone"
    assert page.count("data:image/png;base64,") == len(list((out / "report").glob("*.png")))


def test_the_catalogue_tells_what_the_report_says(
    circle: tuple[Path, DemoResult, list[BodyFrame]], tmp_path: Path
) -> None:
    out, _, _ = circle
    report = json.loads((out / "report" / "report.json").read_text())
    with Index(tmp_path / "index") as index:
        (run,) = find_runs([out], index).runs
    assert (run.rig, run.robot, run.ended) == (
        "virtual bench",
        "intact",
        "played to the end",
    )
    assert run.damage == "" and run.faults == ()
    told = report["verdict"]["body_lengths_per_5_cycles"]
    assert (run.expected, run.filmed) == (told["predicted"], told["tracked"])
    assert run.verdict == (told["agreement"] or "")
    compared = compared_run(out / "log.mcap", lambda frames, total: None)
    assert compared.motion.displacement() == pytest.approx(told["tracked"], abs=1e-8)


def test_one_wiring_from_packet_to_report(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    out, _, _ = circle
    with (out / "packet" / "wiring.csv").open() as file:
        packet = {(int(r["relay_channel"]), int(r["spring"]), r["face"]) for r in csv.DictReader(file)}
    entries = yaml.safe_load((out / "rig.yaml").read_text())["channels"]
    rig = {(c["channel"], c["spring"], c["face"]) for c in entries}
    schedule = json.loads((out / "schedule.json").read_text())
    events = {(e["channel"], e["spring"], e["face"]) for e in schedule["events"]}
    report = json.loads((out / "report" / "report.json").read_text())["wiring"]
    assert packet == {(c["channel"], c["spring"], c["face"]) for c in report["channels"]}
    assert events <= packet <= rig and events, "a spring may stay cold, a rig may have more channels"
    manifest = json.loads((out / "packet" / "manifest.json").read_text())
    assert manifest["wiring"]["sha256"] == report["sha256"] == schedule["provenance"]["digests"]["wiring"]
    assert report["as_packet"]


def test_the_camera_tells_where_the_body_truly_was(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    """Independent: the truth comes from the body, the tracks from the pictures through the tags."""
    out, found, truth = circle
    design = Design.load(out / "design.json")
    marks = marked_masses(design.morphology)
    seen = found.content.tracked.trajectory
    times = np.array([frame.time_s for frame in truth])
    nearest = np.abs(seen.times[:, None] - times).argmin(axis=1)
    assert np.abs(seen.times - times[nearest]).max() < 1e-3
    true = np.stack([truth[i].positions[marks] for i in nearest])
    error = np.linalg.norm(seen.positions - true, axis=2)
    assert np.sqrt(np.nanmean(error**2)) < 0.3e-3
    assert np.ptp(true[:, :, 0], axis=0).max() > 3e-3, "the body has to move for this to mean anything"


def test_the_log_is_read_by_ros_tools(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    with AnyReader([circle[0] / "log.mcap"]) as reader:
        types = {c.msgtype for c in reader.connections}
        assert "sensor_msgs/msg/CompressedImage" in types and "sensor_msgs/msg/Temperature" in types
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def test_the_example_reads_the_log(circle: tuple[Path, DemoResult, list[BodyFrame]]) -> None:
    example = ROOT / "examples" / "read_log.py"
    call = [sys.executable, str(example), str(circle[0] / "log.mcap")]
    said = subprocess.run(call, capture_output=True, text=True, check=True).stdout
    assert "first frame at" in said and "rig.yaml" in said and "channel1: closed" in said


def test_the_packet_comes_out_the_same_again(
    circle: tuple[Path, DemoResult, list[BodyFrame]], tmp_path: Path
) -> None:
    out, _, _ = circle
    packet(out / "design.json", tmp_path / "packet")
    assert _bytes(tmp_path / "packet") == _bytes(out / "packet")


@pytest.mark.stress
def test_the_schedule_comes_out_the_same_again(
    circle: tuple[Path, DemoResult, list[BodyFrame]], tmp_path: Path
) -> None:
    out, _, _ = circle
    design, rig = Design.load(out / "design.json"), Rig.load(out / "rig.yaml")
    plan(design, rig, PlanConfig(seed=SEED, samples=SAMPLES, cycles=CYCLES)).save(tmp_path / "schedule.json")
    assert _bytes(tmp_path / "schedule.json") == _bytes(out / "schedule.json")


def _bytes(path: Path) -> dict[str, str]:
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
