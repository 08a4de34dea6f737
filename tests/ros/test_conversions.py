"""Conversions of messages, without ROS: every message goes over the wire as CDR and back."""

import json
import subprocess
import sys

import numpy as np
import pytest
from eldir_ros.conversions import board, header_of, marks, nanoseconds, pictures, runs, time_of
from rosbags.highlevel import AnyReader

from calibration.camera.lens import Lens
from eldir.errors import InputError
from hardware.images import jpeg
from hardware.log.reader import read_log
from hardware.log.recorder import Recorder
from hardware.rig.configuration import Rig
from hardware.rig.template import virtual_rig
from hardware.run.contact_edges import ContactEdge
from hardware.schedule import ActuationSchedule, Event
from tests.ros.types import new_message, passed, store

NOW = 1_753_000_000_123_456_789


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text(virtual_rig())
    return Rig.load(path)


@pytest.fixture
def picture():
    rng = np.random.default_rng(5)
    return rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_what_runs_without_ros_imports_no_ros():
    modules = "conversions.board conversions.marks conversions.pictures conversions.runs remote.heartbeats"
    modules += " remote.remote_bank remote.schedule_run"
    names = ", ".join(f"eldir_ros.{m}" for m in modules.split())
    code = f"import sys, {names}; sys.exit(any(m.split('.')[0] == 'rclpy' for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_stamp_comes_back_to_the_nanosecond():
    for stamp in (0, 1, 999_999_999, 1_000_000_000, NOW):
        assert nanoseconds(passed(time_of(new_message, stamp), "builtin_interfaces/msg/Time")) == stamp
    assert header_of(new_message, NOW, "ground").frame_id == "ground"


def test_a_raw_picture_comes_back_in_every_encoding(picture):
    message = passed(pictures.raw_of(new_message, NOW, picture), "sensor_msgs/msg/Image")
    assert (message.encoding, message.step, message.header.frame_id) == ("bgr8", 192, "camera")
    np.testing.assert_array_equal(pictures.picture_from(message), picture)
    message.encoding = "rgb8"
    np.testing.assert_array_equal(pictures.picture_from(message), picture[:, :, ::-1])
    padded = np.concatenate([picture[:, :, 0], np.zeros((48, 8), np.uint8)], axis=1)
    message.encoding, message.step, message.data = "mono8", 72, padded.ravel()
    np.testing.assert_array_equal(pictures.picture_from(message)[:, :, 2], picture[:, :, 0])
    message.encoding = "yuv422"
    with pytest.raises(InputError, match="expected bgr8, rgb8 or mono8; found yuv422"):
        pictures.picture_from(message)


def test_a_compressed_picture_keeps_its_bytes(picture):
    data = jpeg.encode(picture).tobytes()
    message = passed(pictures.compressed_of(new_message, NOW, data), "sensor_msgs/msg/CompressedImage")
    assert message.data.tobytes() == data and "jpeg" in message.format
    np.testing.assert_array_equal(pictures.picture_from(message), jpeg.decode(np.frombuffer(data, np.uint8)))
    info = passed(pictures.info_of(new_message, NOW, 64, 48), "sensor_msgs/msg/CameraInfo")
    assert (info.width, info.height, info.k[0]) == (64, 48, 0)


def test_camera_info_tells_the_lens():
    lens = Lens((64, 48), [70, 71], [31, 24], [-0.2, 0.05, 0.001, -0.002, 0], np.zeros(9), 0.2, (0.1, 0.3))
    sent = pictures.info_of(new_message, NOW, 64, 48, lens)
    info = passed(sent, "sensor_msgs/msg/CameraInfo")
    assert (info.header.frame_id, info.distortion_model) == ("camera", "plumb_bob")
    assert info.k.tolist() == [70, 0, 31, 0, 71, 24, 0, 0, 1]
    assert info.d.tolist() == lens.distortion.tolist()
    with pytest.raises(InputError, match="64 x 48 pixels; found 640 x 480"):
        pictures.info_of(new_message, NOW, 640, 480, lens)


def test_a_drivers_camera_info_is_recorded_as_it_came(tmp_path, picture):
    """Of a model that we do not have, binned, and of a part of the sensor."""
    told = {"height": 48, "width": 64, "distortion_model": "rational_polynomial", "binning_x": 2}
    told |= {"d": np.arange(8.0), "k": np.arange(1.0, 10.0), "r": np.eye(3).ravel(), "p": np.arange(12.0)}
    told |= {
        "binning_y": 2,
        "roi": new_message("sensor_msgs/msg/RegionOfInterest", x_offset=4, do_rectify=True),
    }
    sent = passed(new_message("sensor_msgs/msg/CameraInfo", **told), "sensor_msgs/msg/CameraInfo")
    with Recorder(tmp_path / "a.mcap") as log:
        log.on_camera_info(0.0, pictures.info_from(sent))
        log.on_frame(0.1, picture)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        topics = [c for c in reader.connections if c.topic == "/camera/camera_info"]
        ((_, _, raw),) = reader.messages(connections=topics)
    kept = store().deserialize_cdr(raw, "sensor_msgs/msg/CameraInfo")
    assert kept.header.frame_id == "camera"
    kept.header = sent.header
    name = "sensor_msgs/msg/CameraInfo"
    assert store().serialize_cdr(kept, name) == store().serialize_cdr(sent, name)


def test_a_report_of_the_board_comes_back(rig):
    state = board.BoardState(
        NOW,
        board.channel_names(rig),
        (True, False, True, False),
        board.spring_names(rig),
        (61.25, 22.0, 45.125, 22.5),
        True,
        62.0,
        0.003,
    )
    name = "control_msgs/msg/DynamicJointState"
    assert board.state_from(passed(board.states_of(new_message, state), name)) == state
    stop = passed(board.stop_of(new_message, NOW, "pressed"), "eldir_msgs/msg/EmergencyStop")
    assert stop.stopped and stop.reason == "pressed"
    assert not board.stop_of(new_message, NOW, None).stopped


def test_marks_are_metres_in_the_ground_frame_with_z_up():
    places = np.array([[0.125, 0.03], [np.nan, np.nan]])
    message = passed(
        marks.markers_of(new_message, NOW, ("m1", "m2"), places), "visualization_msgs/msg/MarkerArray"
    )
    first = message.markers[0]
    assert (first.header.frame_id, first.pose.position.y) == ("ground", 0.0)
    assert (first.pose.position.x, first.pose.position.z) == (0.125, 0.03)
    stamp, names, back = marks.tracks_from(message)
    assert (stamp, names) == (NOW, ("m1", "m2"))
    np.testing.assert_array_equal(back, places)
    point = marks.point_of(new_message, NOW, places[0]).point
    assert (point.x, point.y, point.z) == (0.125, 0.0, 0.03)
    masses = np.random.default_rng(1).normal(size=(20, 2))
    poses = passed(marks.poses_of(new_message, NOW, masses), "geometry_msgs/msg/PoseArray")
    np.testing.assert_array_equal(marks.positions_from(poses), masses)


def test_an_edge_comes_back():
    sent = runs.edge_of(new_message, ContactEdge(0.5, 1, True))
    message = passed(sent, "eldir_msgs/msg/Edge")
    assert (message.elapsed, message.channel, message.closed) == (0.5, 1, True)


def test_pulses_come_back_with_their_instant():
    message = passed(runs.pulses_of(new_message, "a", NOW, {2: 0.7, 4: 1.5}), "eldir_msgs/msg/HeatCommand")
    assert message.command == message.PULSES and message.run == "a"
    assert runs.pulses_from(message) == (NOW, {2: 0.7, 4: 1.5})


def schedule():
    return ActuationSchedule(
        20.0, (Event(0.0, 0, "front", 1, True), Event(2.0, 0, "front", 1, False)), cycles=3, settle_s=3.0
    )


def test_a_schedule_travels_as_the_text_of_its_file():
    text = json.dumps(schedule().to_json())
    goal = passed(
        new_message("eldir_msgs/action/RunSchedule_Goal", schedule=text), "eldir_msgs/action/RunSchedule_Goal"
    )
    assert runs.schedule_from(goal.schedule) == schedule()
    for wrong in ("", "[]", '{"format": "eldir-rig/1"}', text.replace("period_s", "period")):
        with pytest.raises(InputError):
            runs.schedule_from(wrong)


def test_ranges_of_motion_have_a_joint_for_each_mark():
    ranges = {"predicted": np.array([0.01, 0.02]), "tracked": np.array([0.011, 0.019])}
    sent = runs.ranges_of(new_message, NOW, ("m1", "m2"), ranges, {"tracked": 0.1})
    message = passed(sent, "control_msgs/msg/DynamicJointState")
    assert message.joint_names == ["m1", "m2", "body"]
    assert message.interface_values[1].interface_names == ["predicted", "tracked"]
    assert message.interface_values[1].values.tolist() == [0.02, 0.019]


def test_a_log_recorded_from_messages_has_the_bytes_of_one_recorded_directly(rig, picture, tmp_path):
    """What passes through the graph loses nothing: the recorder node writes the library's log."""
    reports = [
        (k * 0.1, (k % 3 == 1, False, k % 2 == 0, False), (22.0 + k, 23.5, 61.0, 22.0)) for k in range(20)
    ]
    places = np.array([[0.1, 0.2], [np.nan, np.nan]])
    names = ("m1", "m2")
    options = (board.channel_names(rig), board.spring_names(rig), NOW)

    def stamp(t):
        return NOW + round(t * 1e9)

    with Recorder(tmp_path / "direct.mcap", *options) as log:
        for t, closed, heat in reports:
            log.on_relays(t, closed)
            log.on_temperatures(t, heat)
            log.on_frame(t, picture)
            log.on_tracks(t, names, places)
    with Recorder(tmp_path / "graph.mcap", *options) as log:
        for t, closed, heat in reports:
            state = board.BoardState(stamp(t), options[0], closed, options[1], heat, True, 90.0, 0.0)
            state = board.state_from(
                passed(board.states_of(new_message, state), "control_msgs/msg/DynamicJointState")
            )
            at = (state.stamp - NOW) * 1e-9
            log.on_relays(at, state.closed)
            log.on_temperatures(at, state.temperatures)
            sent = pictures.compressed_of(new_message, stamp(t), jpeg.encode(picture).tobytes())
            seen = passed(sent, "sensor_msgs/msg/CompressedImage")
            log.on_picture((nanoseconds(seen.header.stamp) - NOW) * 1e-9, seen.data, 64, 48)
            array = passed(
                marks.markers_of(new_message, stamp(t), names, places), "visualization_msgs/msg/MarkerArray"
            )
            at_ns, found, where = marks.tracks_from(array)
            log.on_tracks((at_ns - NOW) * 1e-9, found, where)
    assert (tmp_path / "direct.mcap").read_bytes() == (tmp_path / "graph.mcap").read_bytes()
    recorded = read_log(tmp_path / "graph.mcap")
    assert [data.tobytes() for _, data in recorded.pictures] == [jpeg.encode(picture).tobytes()] * 20
