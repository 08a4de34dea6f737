"""Conversions of messages, without ROS: every message goes over the wire as CDR and back."""

import json
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from eldir.errors import InputError
from eldir_hardware.camera.plane import CameraPose
from eldir_hardware.images import jpeg
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.player import ContactEdge
from eldir_hardware.schedule import ActuationSchedule, Event
from eldir_ros.conversions import board, frames, header_of, marks, nanoseconds, pictures, robot, runs, time_of
from tests.hardware.camera.lenses import lens_of
from tests.hardware.rigs_and_schedules import SCHEDULE
from tests.paths import NODES
from tests.raised import raises
from tests.ros2_nodes.message_types import new_message, passed, store

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
    assert subprocess.run([sys.executable, "-c", code], cwd=NODES, check=False).returncode == 0


def test_a_stamp_comes_back_to_the_nanosecond():
    for stamp in (0, 1, 999_999_999, 1_000_000_000, NOW):
        assert nanoseconds(passed(time_of(new_message, stamp), "builtin_interfaces/msg/Time")) == stamp
    assert header_of(new_message, NOW, "ground").frame_id == "ground"


def test_a_raw_picture_comes_back_in_every_encoding(picture):
    message = passed(pictures.raw_of(new_message, NOW, picture), "sensor_msgs/msg/Image")
    assert (message.encoding, message.step, message.header.frame_id) == ("bgr8", 192, "camera_optical_frame")
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
    lens = lens_of((64, 48), [70, 71], [31, 24], [-0.2, 0.05, 0.001, -0.002, 0])
    sent = pictures.info_of(new_message, NOW, 64, 48, lens)
    info = passed(sent, "sensor_msgs/msg/CameraInfo")
    assert (info.header.frame_id, info.distortion_model) == ("camera_optical_frame", "plumb_bob")
    assert info.k.tolist() == [70, 0, 31, 0, 71, 24, 0, 0, 1]
    assert info.d.tolist() == lens.distortion.tolist()
    with raises(InputError, "camera.other-size", match="64 x 48 pixels; found 640 x 480"):
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
    assert kept.header.frame_id == "camera_optical_frame"
    kept.header = sent.header
    name = "sensor_msgs/msg/CameraInfo"
    assert store().serialize_cdr(kept, name) == store().serialize_cdr(sent, name)


def test_a_report_of_the_board_comes_back(rig):
    state = board.BoardState(
        NOW,
        0.05,
        "a",
        7,
        True,
        board.channel_names(rig),
        (True, False, True, False),
        board.spring_names(rig),
        (61.25, 22.0, 45.125, 22.5),
        62.0,
        0.003,
        (3.25, 0.0, 0.0, 0.0),
        (3.0, 0.0, 0.0, 0.0),
    )
    message = passed(board.states_of(new_message, state), "eldir_msgs/msg/BoardState")
    assert board.state_from(message) == state
    message.closed = message.closed[:3]
    with pytest.raises(ValueError, match="one value for each contact"):
        board.state_from(message)
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


def test_the_frames_lead_from_the_ground_to_what_a_pixel_sees():
    """Chained as tf2 does it, the transforms give the camera's pose, with axes as in REP-103."""
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    looking = np.column_stack([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # along y of the ground
    pose = CameraPose(np.array([0.1, -0.8, 0.2]), turned @ looking)
    sent = frames.camera_frames_of(new_message, NOW, pose, "a/ground", "a/camera", "a/optical")
    body, optical = passed(sent, "tf2_msgs/msg/TFMessage").transforms
    assert (body.header.frame_id, body.child_frame_id) == ("a/ground", "a/camera")
    assert (optical.header.frame_id, optical.child_frame_id) == ("a/camera", "a/optical")

    def moved(t, point):
        q, p = t.transform.rotation, t.transform.translation
        return Rotation.from_quat([q.x, q.y, q.z, q.w]).apply(point) + np.array([p.x, p.y, p.z])

    ahead = moved(body, (1.0, 0, 0)) - pose.position
    np.testing.assert_allclose(ahead, turned @ (0, 1.0, 0), atol=1e-12)
    np.testing.assert_allclose(moved(body, (0, 0, 1.0)) - pose.position, (0, 0, 1.0), atol=1e-12)
    for point in np.eye(3):
        there = moved(body, moved(optical, point))
        np.testing.assert_allclose(there, pose.rotation @ point + pose.position, atol=1e-12)


def chained(transforms, root):
    """Pose in the root of every frame of a tf2_msgs/TFMessage: rotation and position."""
    poses = {root: (Rotation.identity(), np.zeros(3))}
    for t in transforms:
        turn, place = poses[t.header.frame_id]
        q, p = t.transform.rotation, t.transform.translation
        own = Rotation.from_quat([q.x, q.y, q.z, q.w])
        poses[t.child_frame_id] = (turn * own, place + turn.apply((p.x, p.y, p.z)))
    return poses


def by_the_description(text, values):
    """Pose in the root of every link of a URDF, as its joints' axes and values say."""
    poses, tree = {"ground": (Rotation.identity(), np.zeros(3))}, ElementTree.fromstring(text)
    for joint in tree.iter("joint"):
        turn, place = poses[joint.find("parent").get("link")]
        axis = np.array(joint.find("axis").get("xyz").split(), float)
        value = values[joint.get("name")]
        if joint.get("type") == "prismatic":
            place = place + turn.apply(value * axis)
        else:
            turn = turn * Rotation.from_rotvec(value * axis)
        poses[joint.find("child").get("link")] = (turn, place)
    assert set(poses) == {link.get("name") for link in tree.iter("link")}, "a tree"
    return poses


def test_description_joints_and_frames_of_the_robot_agree():
    rng = np.random.default_rng(3)
    places, angles = rng.normal(size=(4, 2)), rng.uniform(-3, 3, 4)
    text = robot.urdf_text("robot", {hub: f"file:///hub_{hub}.stl" for hub in range(4)}, 0.0243)
    origins = [o.get("xyz") for o in ElementTree.fromstring(text).iter("origin")]
    assert origins == ["0 0.0243 0"] * 4, "the joints move in the plane of the marks, on the robot's front"
    joints = passed(robot.joints_of(new_message, NOW, places, angles), "sensor_msgs/msg/JointState")
    told = by_the_description(text, dict(zip(joints.name, joints.position.tolist(), strict=True)))
    sent = passed(robot.frames_of(new_message, NOW, places, angles, "a/ground"), "tf2_msgs/msg/TFMessage")
    found = chained(sent.transforms, "a/ground")
    assert {f"a/{link}" for link in told} == set(found)
    for link, (turn, place) in told.items():
        np.testing.assert_allclose(found[f"a/{link}"][1], place, atol=1e-12)
        np.testing.assert_allclose(found[f"a/{link}"][0].as_matrix(), turn.as_matrix(), atol=1e-12)
    turn, place = found["a/hub_02"]
    np.testing.assert_allclose(place, (places[2, 0], 0.0, places[2, 1]))
    forward = turn.apply((1.0, 0.0, 0.0))
    np.testing.assert_allclose(forward, (np.cos(angles[2]), 0.0, np.sin(angles[2])), atol=1e-12)


def test_springs_are_lines_between_the_hubs():
    places = np.array([(0.0, 0.0), (0.1, 0.0), (0.0, 0.2)])
    springs, active = np.array([(0, 1), (1, 2)]), np.array([False, True])
    sent = robot.springs_of(new_message, NOW, places, springs, active, (0.004, 0.045), "ground")
    strips, coils = passed(sent, "visualization_msgs/msg/MarkerArray").markers
    assert (strips.ns, coils.ns, strips.type) == ("strips", "coils", strips.LINE_LIST)
    assert [(p.x, p.y, p.z) for p in coils.points] == [
        (0.1, 0.004, 0.0), (0.0, 0.004, 0.2), (0.1, 0.045, 0.0), (0.0, 0.045, 0.2)
    ]  # fmt: skip


def test_an_edge_comes_back():
    sent = runs.edge_of(new_message, ContactEdge(0.5, 1, True))
    message = passed(sent, "eldir_msgs/msg/Edge")
    assert (message.elapsed, message.channel, message.closed) == (0.5, 1, True)


def test_the_commands_are_those_of_the_message():
    message = new_message("eldir_msgs/msg/HeatCommand")
    for name in ("KEEPALIVE", "PULSES", "ABORT", "END_OF_RUN"):
        assert getattr(runs, name) == getattr(message, name)


def test_pulses_come_back_with_their_delay():
    sent = runs.pulses_of(new_message, "a", 3, 0.25, {2: 0.7, 4: 1.5})
    message = passed(sent, "eldir_msgs/msg/HeatCommand")
    assert message.command == message.PULSES and (message.run, message.sequence) == ("a", 3)
    assert runs.pulses_from(message) == (0.25, {2: 0.7, 4: 1.5})


@pytest.mark.parametrize(
    ("delay", "seconds"), [(1.1, 1.0), (-0.6, 1.0), (np.nan, 1.0), (0.3, 0.0), (0.3, -1.0), (0.3, np.inf)]
)
def test_what_is_no_duration_is_no_command(delay, seconds):
    message = runs.pulses_of(new_message, "a", 1, delay, {1: seconds})
    with pytest.raises(ValueError, match=r"its delay|invalid durations"):
        runs.pulses_from(message)


def schedule():
    return ActuationSchedule(
        20.0,
        events=(Event(0.0, 0, "front", 1, True), Event(2.0, 0, "front", 1, False)),
        cycles=3,
        settle_s=3.0,
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


def goal(**fields):
    name = "eldir_msgs/action/RunSchedule_Goal"
    return passed(new_message(name, **fields), name)


def test_a_schedule_travels_as_fields_or_as_text_and_not_as_both():
    plan, text = runs.plan_of(new_message, schedule()), json.dumps(schedule().to_json())
    assert (
        runs.schedule_from_goal(goal(plan=plan)) == runs.schedule_from_goal(goal(schedule=text)) == schedule()
    )
    for fields, found in (({}, "neither"), ({"plan": plan, "schedule": text}, "both")):
        with pytest.raises(InputError, match=f"must contain one schedule.* found {found}"):
            runs.schedule_from_goal(goal(**fields))
    plan.events[0].face = "side"
    with pytest.raises(InputError, match=r"invalid \S*face"):
        runs.schedule_from_goal(goal(plan=plan))


def test_ranges_of_motion_have_a_value_for_each_marker():
    ranges = {"predicted": np.array([0.01, 0.02]), "tracked": np.array([0.011, 0.019])}
    sent = runs.ranges_of(new_message, NOW, 2, ("m1", "m2"), ranges, 0.1)
    message = passed(sent, "eldir_msgs/msg/RangeOfMotion")
    assert (message.cycle, message.markers, message.displacement) == (2, ["m1", "m2"], 0.1)
    assert message.predicted.tolist() == [0.01, 0.02] and message.tracked.tolist() == [0.011, 0.019]
    assert message.simulated.tolist() == [], "not known"


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
            state = board.BoardState(
                stamp(t), 0.0, "a", 1, True, options[0], closed, options[1], heat, 90.0, 0.0
            )
            state = board.state_from(passed(board.states_of(new_message, state), "eldir_msgs/msg/BoardState"))
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


def test_the_boards_values_on_the_graph_are_the_logs_messages(rig, tmp_path):
    """Same topic, type and bytes: a log that is played on a graph feeds who listens there."""
    names = board.channel_names(rig), board.spring_names(rig)
    with Recorder(tmp_path / "a.mcap", *names, NOW) as log:
        log.on_relays(0.0, (True, False, False, True))
        log.on_temperatures(0.0, (22.5, 61.0, 22.0, 23.0))
        log.on_currents(0.0, (3.25, 0.0, 0.0, 3.0), (3.0, 0.0, 0.0, 2.9))
    sent = {
        "/relays": board.values_of(new_message, NOW, names[0], (True, False, False, True)),
        "/currents": board.values_of(new_message, NOW, names[1], (3.25, 0.0, 0.0, 3.0)),
        "/voltages": board.values_of(new_message, NOW, names[1], (3.0, 0.0, 0.0, 2.9)),
        "/springs/spring0_back/temperature": board.temperature_of(new_message, NOW, 61.0),
    }
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        kept = {c.topic: (c.msgtype, bytes(raw)) for c, _, raw in reader.messages()}
    for topic, message in sent.items():
        kind, raw = kept[topic]
        assert bytes(store().serialize_cdr(message, kind)) == raw, topic


def test_what_was_measured_of_the_air_goes_with_the_run():
    for room in (None, 21.4375):
        sent = runs.run_of(new_message, runs.RUNNING, "a", NOW, SCHEDULE, "", room)
        assert runs.room_of(passed(sent, "eldir_msgs/msg/Run")) == room
    assert runs.room_from(None) is None and runs.room_from(21) == 21.0
