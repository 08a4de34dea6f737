# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""What the graph records and replays is what the library records and tracks."""

import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import PATIENCE, Graph, require_unless_busy, wait_until  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from schedules import CONFIG, LONG, MIDDLE  # noqa: E402
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from eldir.design import Design  # noqa: E402
from eldir_calibration.comparison.predictions import predict_live  # noqa: E402
from eldir_hardware.log.messages import CAMERA_INFO, IMAGE  # noqa: E402
from eldir_hardware.log.reader import read_log  # noqa: E402
from eldir_hardware.rig.configuration import Rig  # noqa: E402
from eldir_hardware.run.drive import DriveConfig, drive_rig  # noqa: E402
from eldir_hardware.schedule import ActuationSchedule  # noqa: E402
from eldir_hardware.vision.pipeline import track_log  # noqa: E402
from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES  # noqa: E402
from eldir_ros.base.qualities import COMPLETE  # noqa: E402
from eldir_ros.conversions import marks, nanoseconds, runs  # noqa: E402


@pytest.fixture(scope="module")
def filmed():
    """Stamps of the pictures that the camera published for `recorded` [ns]."""
    return []


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, filmed):
    """The log of a run on the graph."""
    folder = tmp_path_factory.mktemp("graph")
    with Graph(folder) as graph:
        note = lambda m: filmed.append(nanoseconds(m.header.stamp))  # noqa: E731
        graph.node.create_subscription(CameraInfo, "camera/camera_info", note, COMPLETE)
        graph.ready()
        assert graph.result(graph.send(MIDDLE)).outcome == runs.FINISHED
        wait_until(lambda: "wrote" in graph.said("mcap_recorder"), 10)
        wait_until(lambda: "cycle 1: tracked" in graph.said("range_of_motion"), 30)
    (log,) = folder.glob("run-*/log.mcap")
    return log


@pytest.fixture(scope="module")
def direct(tmp_path_factory):
    """The log of the same schedule driven by the library alone, on the same kind of bench, in real time."""
    folder = tmp_path_factory.mktemp("direct")
    (folder / "rig.yaml").write_text(
        (CONFIG / "rig.yaml").read_text().replace("clock: virtual", "clock: wall")
    )
    plan = ActuationSchedule.from_json(MIDDLE)
    rig = Rig.load(folder / "rig.yaml")
    # In one process with the emulated board: the engine must have been compiled before it answers.
    predict_live(Design.load(CONFIG / "design.json"), plan, rig)
    drive_rig(plan, rig, folder / "rig.yaml", folder / "log.mcap", DriveConfig(CONFIG / "design.json"))
    return folder / "log.mcap"


def shape(path):
    """What a log consists of: topics with types, definitions and qualities; attachments; metadata."""
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        channels = {
            c.topic: (summary.schemas[c.schema_id].name, summary.schemas[c.schema_id].data, dict(c.metadata))
            for c in summary.channels.values()
        }
        return {
            "header": (reader.get_header().profile, reader.get_header().library),
            "channels": channels,
            "attachments": {a.name: a.media_type for a in reader.iter_attachments()},
            # Written again whenever there are new topics, as tracks are here.
            "metadata": {r.name for r in reader.iter_metadata()},
        }


def test_the_recorder_leaves_no_picture_out(recorded, filmed):
    kept = np.array([stamp for stamp, _ in read_log(recorded).pictures])
    shown = np.array([t for t in filmed if kept[0] - 1000 < t < kept[-1] + 1000])
    assert len(kept) > 50 and kept.shape == shown.shape
    assert np.abs(kept - shown).max() < 1000, "a log's times are rounded, by less than a microsecond"


def test_the_recorders_log_is_the_librarys(recorded, direct):
    ours, theirs = shape(recorded), shape(direct)
    tracks = {t for t in ours["channels"] if t.startswith("/marks")}
    assert tracks == {"/marks", "/marks/m1", "/marks/m2", "/marks/m3", "/marks/m4", "/marks/m5"}
    assert {t: c for t, c in ours["channels"].items() if t not in tracks} == theirs["channels"]
    for part in ("header", "metadata"):
        assert ours[part] == theirs[part], part
    assert ours["attachments"] == theirs["attachments"] | {"plane.json": "application/json"}
    a, b = read_log(recorded), read_log(direct)
    assert (a.channels, a.springs) == (b.channels, b.springs)
    assert a.statuses[-1][1:] == b.statuses[-1][1:] == ("player", "played to the end")
    for name in ("schedule.json", "design.json"):
        assert a.attachments[name] == b.attachments[name], name
    # The same pulses: contacts closed for the same time, springs equally hot, by the reports.
    at = np.arange(0.5, 11.0, 0.5)
    heats = [np.stack([np.interp(at, x.temperature_times, c) for c in x.temperatures.T]) for x in (a, b)]
    print(f"temperatures differ by at most {np.abs(heats[0] - heats[1]).max():.2f} K")
    assert np.abs(heats[0] - heats[1]).max() < 3.0


def test_tracks_on_the_graph_are_those_of_the_log_tracked_anew(recorded):
    log = read_log(recorded)
    again = track_log(log)
    np.testing.assert_array_equal(log.tracks.times, again.times)
    np.testing.assert_array_equal(log.tracks.positions, again.positions)
    # Enough to compare; a busy computer renders fewer pictures.
    assert len(again.times) > 30 and np.isfinite(again.positions).all()


def test_a_replayed_log_gives_the_same_tracks(recorded, tmp_path):
    wanted = track_log(read_log(recorded))
    epoch = read_log(recorded).epoch_ns
    seen, drawn = {}, set()

    def on_marks(message):
        stamp, _, places = marks.tracks_from(message)
        seen[stamp] = places

    with Graph(tmp_path, nodes=()) as graph:
        graph.node.create_subscription(MarkerArray, "marks", on_marks, COMPLETE)
        graph.node.create_subscription(
            JointState, "joint_states", lambda m: drawn.add(nanoseconds(m.header.stamp)), 100
        )
        graph.start("robot_model", log=recorded, design="", autostart=True)
        wait_until(lambda: graph.state("robot_model") == "active", 60)
        graph.start("mass_tracker", log=recorded, design="", autostart=True)
        graph.start("camera", source=recorded, speed=4.0, wait_for='["mass_tracker"]', autostart=True)
        wait_until(lambda: "pictures shown" in graph.said("camera"), 60)
        time.sleep(1.0)
        wait_until(lambda: max(seen) in drawn, 60)
    times = (np.array(sorted(seen)) - epoch) * 1e-9
    np.testing.assert_array_equal(times, wanted.times)
    np.testing.assert_array_equal(np.array([seen[s] for s in sorted(seen)]), wanted.positions)
    assert drawn <= set(seen), "the robot of the log is drawn at the instants of its pictures"


def test_a_log_that_is_played_like_a_bag_feeds_the_tracker(recorded, tmp_path):
    """Its bytes on the topics that it names, as `ros2 bag play` sends them."""
    wanted, seen = track_log(read_log(recorded)), {}

    def on_marks(message):
        stamp, _, places = marks.tracks_from(message)
        seen[stamp] = places

    with Graph(tmp_path, nodes=()) as graph, recorded.open("rb") as file:
        graph.node.create_subscription(MarkerArray, "marks", on_marks, COMPLETE)
        graph.start("mass_tracker", log=recorded, design="")
        assert graph.configure("mass_tracker") and graph.activate("mass_tracker")
        publishers = {}
        for _, channel, record in make_reader(file).iter_messages([IMAGE, CAMERA_INFO]):
            if channel.topic not in publishers:
                kind = {IMAGE: CompressedImage, CAMERA_INFO: CameraInfo}[channel.topic]
                publishers[channel.topic] = graph.node.create_publisher(kind, channel.topic, COMPLETE)
                wait_until(lambda p=publishers[channel.topic]: p.get_subscription_count() > 0)
            publishers[channel.topic].publish(bytes(record.data))
            time.sleep(0.03)
        wait_until(lambda: len(seen) == len(wanted.times), 60)
    np.testing.assert_array_equal(np.array([seen[s] for s in sorted(seen)]), wanted.positions)


def test_all_nodes_in_one_process(tmp_path):
    """As separate ones: played, recorded, tracked; the design is where the rig file says."""
    assert Design.load(CONFIG / "design.json").morphology.motors == 2
    with Graph(tmp_path, nodes=()) as graph:
        graph.required = ["camera", "mass_tracker", "mcap_recorder", "range_of_motion"]
        names = ("relay_board", "actuation_sequencer", *graph.required)
        graph.start("rig_process", *names, autostart=True)
        wait_until(lambda: all(graph.state(n) == "active" for n in names), 60)
        result = graph.result(graph.send(MIDDLE))
        assert result.all_off and result.outcome in (runs.FINISHED, runs.STOPPED), result.message
        require_unless_busy(result.outcome == runs.FINISHED, result.message)
        wait_until(lambda: "wrote" in graph.said("rig_process"), 10)
        for _ in range(5):  # while pictures are rendered
            asked = time.monotonic()
            assert graph.state("camera") == "active"
            graph.require_within(time.monotonic() - asked, 5.0)
        goal = graph.heating(LONG)
        graph.processes["rig_process"].terminate()
        asked = time.monotonic()
        graph.require_within(graph.all_off() - asked, 1.0)
        assert goal.accepted and graph.processes["rig_process"].wait(PATIENCE) == 0
        assert "did not report" not in graph.said("rig_process"), "the relay board ends last"
    log = read_log(min(tmp_path.glob("run-*/log.mcap")))
    require_unless_busy(log.frame_count > CALIBRATION_FRAMES, "one process has rendered few pictures")
    assert log.tracks is not None
