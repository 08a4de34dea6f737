# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""`ros2 bag record` beside our recorder, and our log played by `ros2 bag play`."""

import shutil
import signal
import subprocess

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")
pytest.importorskip("rosbag2_py", reason="needs rosbag2")

from eldir_msgs.msg import RangeOfMotion  # noqa: E402
from graph import Graph, require_unless_busy, wait_until  # noqa: E402
from mcap.reader import make_reader  # noqa: E402
from schedules import SLOW  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from eldir_hardware.log.reader import read_log  # noqa: E402
from eldir_hardware.vision.pipeline import track_log  # noqa: E402
from eldir_ros.base.qualities import COMPLETE, LATCHED  # noqa: E402
from eldir_ros.conversions import marks, runs  # noqa: E402

OWN = {"/camera/camera_info", "/diagnostics"}
"""Topics that differ: our log has the lens once, and the events of the run as statuses."""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Our log of a run, the bag of `ros2 bag record` beside it, and the ranges of motion on the graph."""
    folder, ranges = tmp_path_factory.mktemp("bag"), []
    with Graph(folder) as graph:
        graph.node.create_subscription(RangeOfMotion, "range_of_motion", ranges.append, LATCHED)
        command = ["ros2", "bag", "record", "--storage", "mcap", "--output", str(folder / "bag"), "--all"]
        with subprocess.Popen(command, env=graph.environment) as bag:
            try:
                graph.ready()
                wait_until(lambda: list((folder / "bag").glob("*.mcap")), 30)
                assert graph.result(graph.send(SLOW), 120).outcome == runs.FINISHED
                wait_until(lambda: "wrote" in graph.said("mcap_recorder") and ranges, 90)
            finally:  # it outlives no test, also none that failed
                bag.send_signal(signal.SIGINT)
            assert bag.wait(30) == 0
    (log,), (other,) = folder.glob("run-*/log.mcap"), (folder / "bag").glob("*.mcap")
    return log, other, ranges


def stamps(path):
    """Of each topic with headers: its type, and the header stamps of its messages [ns], in order."""
    found = {}
    from rosbags.highlevel import AnyReader

    with AnyReader([path.parent]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            first = message.markers[0] if connection.msgtype.endswith("MarkerArray") else message
            if hasattr(first, "header"):
                time = first.header.stamp.sec * 10**9 + first.header.stamp.nanosec
                found.setdefault(connection.topic, (connection.msgtype, []))[1].append(time)
    return found


def test_rosbag2_records_what_our_recorder_does(recorded):
    """Same topics, types and counts, in the time of our log."""
    log, bag, _ = recorded
    ours, theirs = stamps(log), stamps(bag)
    assert set(ours) >= {"/camera/image_raw/compressed", "/marks", "/marks/m1", "/relays"}
    for topic in sorted(set(ours) - OWN):
        kind, times = ours[topic]
        assert theirs[topic][0] == kind, topic
        kept, shown = np.array(times), np.array(theirs[topic][1])
        shown = shown[(shown > kept[0] - 1000) & (shown < kept[-1] + 1000)]
        print(f"{topic}: {len(kept)} messages, in the bag {len(shown)}")
        assert kept.shape == shown.shape, topic
        assert np.abs(kept - shown).max() < 1000, "a log's times are rounded, by less than a microsecond"


def test_our_log_played_by_rosbag2_gives_the_same_numbers(recorded, tmp_path):
    log, _, ranges = recorded
    wanted, seen, again = track_log(read_log(log)), {}, []

    def on_marks(message):
        stamp, _, places = marks.tracks_from(message)
        seen[stamp] = places

    shutil.copytree(log.parent, tmp_path / "played")
    with Graph(tmp_path, nodes=()) as graph:
        graph.node.create_subscription(MarkerArray, "marks", on_marks, COMPLETE)
        graph.node.create_subscription(RangeOfMotion, "range_of_motion", again.append, LATCHED)
        for name in ("mass_tracker", "range_of_motion"):
            graph.start(name, log=log, design="", rig="")
            assert graph.configure(name) and graph.activate(name), graph.said(name)
        topics = ["/camera/image_raw/compressed", "/camera/camera_info"]
        command = ["ros2", "bag", "play", str(tmp_path / "played"), "--topics", *topics]
        subprocess.run(command, env=graph.environment, check=True, timeout=120)
        wait_until(lambda: again and len(seen) == len(wanted.times), 90)
    np.testing.assert_array_equal(np.array([seen[s] for s in sorted(seen)]), wanted.positions)
    (live,), (replayed,) = ranges, again
    assert len(live.tracked) == 5
    for field in ("cycle", "displacement", "markers", "tracked"):
        assert getattr(live, field) == getattr(replayed, field), field
    with log.open("rb") as file:
        assert make_reader(file).get_header().profile == "ros2"
    are_predicted = len(live.predicted) == len(replayed.predicted) == 5
    require_unless_busy(are_predicted, "no motion was predicted")
    for field in ("simulated", "predicted"):
        assert getattr(live, field) == getattr(replayed, field), field
