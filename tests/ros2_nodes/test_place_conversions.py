"""Conversions of places: marks, frames of reference, the robot, tags and the plane of motion.

Every message goes over the wire as CDR and back, as in test_conversions.py.
"""

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from eldir_hardware.camera.plane import CameraPose, Plane, TagBoard
from eldir_hardware.camera.projection import DiscPoses
from eldir_hardware.markers.registration import DISC_DIAMETER
from eldir_ros.conversions import detections, frames, marks, nanoseconds, reference, robot
from tests.ros2_nodes.message_types import NOW, passed


def test_marks_are_metres_in_the_ground_frame_with_z_up():
    places = np.array([[0.125, 0.03], [np.nan, np.nan]])
    message = passed(marks.markers_of(NOW, ("m1", "m2"), places))
    first = message.markers[0]
    assert (first.header.frame_id, first.pose.position.y) == ("ground", 0.0)
    assert (first.pose.position.x, first.pose.position.z) == (0.125, 0.03)
    stamp, names, back = marks.tracks_from(message)
    assert (stamp, names) == (NOW, ("m1", "m2"))
    np.testing.assert_array_equal(back, places)
    point = marks.point_of(NOW, places[0]).point
    assert (point.x, point.y, point.z) == (0.125, 0.0, 0.03)
    masses = np.random.default_rng(1).normal(size=(20, 2))
    poses = passed(marks.poses_of(NOW, masses))
    np.testing.assert_array_equal(marks.positions_from(poses), masses)


def test_discs_pass_with_their_rotations():
    rng = np.random.default_rng(1)
    outsides = rng.normal(size=(3, 2, 3))
    rotations = Rotation.from_rotvec(rng.normal(size=(6, 3))).as_matrix().reshape(3, 2, 3, 3)
    message = passed(marks.discs_of(NOW, DiscPoses(outsides, rotations)))
    discs = marks.discs_from(message)
    assert nanoseconds(message.header.stamp) == NOW
    np.testing.assert_array_equal(discs.outsides, outsides)
    np.testing.assert_allclose(discs.rotations, rotations, atol=1e-12)


def test_the_frames_lead_from_the_ground_to_what_a_pixel_sees():
    """Chained as tf2 does it, the transforms give the camera's pose, with axes as in REP-103."""
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    looking = np.column_stack([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # along y of the ground
    pose = CameraPose(np.array([0.1, -0.8, 0.2]), turned @ looking)
    sent = frames.camera_frames_of(NOW, pose, "a/ground", "a/camera", "a/optical")
    body, optical = passed(sent).transforms
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
    joints = passed(robot.joints_of(NOW, places, angles))
    told = by_the_description(text, dict(zip(joints.name, joints.position.tolist(), strict=True)))
    sent = passed(robot.frames_of(NOW, places, angles, "a/ground"))
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
    sent = robot.springs_of(NOW, places, springs, active, (0.004, 0.045), "ground")
    strips, coils = passed(sent).markers
    assert (strips.ns, coils.ns, strips.type) == ("strips", "coils", strips.LINE_LIST)
    assert [(p.x, p.y, p.z) for p in coils.points] == [
        (0.1, 0.004, 0.0), (0.0, 0.004, 0.2), (0.1, 0.045, 0.0), (0.0, 0.045, 0.2)
    ]  # fmt: skip


def test_tags_and_plane_of_motion_come_back():
    board_ = TagBoard.at(
        np.array([[0.0, -0.07], [0.4, -0.07], [0.0, 0.4], [0.4, 0.4]]), dictionary="DICT_4X4_100"
    )
    assert reference.tags_from(passed(reference.tags_of(board_, "left/ground"))) == board_
    rng = np.random.default_rng(2)
    made = {"tags": [0, 1, 3], "pictures": 10, "board": board_.to_json(), "source": "live pictures"}
    made |= {"eldir": "0.2.0", "first_picture_ns": NOW, "remark": "a tag is small"}
    for provenance in ({}, made, {"source": "film", "made": "2026-05-01", "expires": "2026-06-01"}):
        plane = Plane(
            640,
            480,
            rng.normal(size=(3, 3)),
            np.array([320.5, 240.0]),
            np.array([0.01, -0.02]),
            0.2,
            provenance,
        )
        found = reference.plane_from(passed(reference.plane_of(plane, "left/ground")))
        assert found.to_json() == plane.to_json()
    assert nanoseconds(reference.plane_of(replace(plane, provenance=made)).header.stamp) == NOW


def test_detections_are_where_the_markers_are_in_the_picture():
    h = np.array([[2.0, 0.1, -0.3], [0.0, -2.0, 0.4], [0.05, 0.0, 1.0]])
    plane = Plane(640, 480, h, np.array([319.5, 239.5]), np.zeros(2), 0.1)
    places = np.array([[0.1, 0.2], [np.nan, np.nan], [0.3, 0.05]])
    found = passed(detections.detections_of(NOW, ("m1", "m2", "m3"), places, plane, "camera_optical_frame"))
    assert [d.id for d in found.detections] == ["m1", "m3"], "m2 was not tracked"
    for one, place in zip(found.detections, places[[0, 2]], strict=True):
        (result,), centre = one.results, one.bbox.center.position
        assert result.hypothesis.class_id == one.id
        np.testing.assert_allclose(plane.to_metres(np.array([centre.x, centre.y])), place, atol=1e-9)
        edge = plane.to_metres(np.array([centre.x + one.bbox.size_x / 2, centre.y]))
        assert np.linalg.norm(edge - place) == pytest.approx(DISC_DIAMETER / 2, rel=0.1)
