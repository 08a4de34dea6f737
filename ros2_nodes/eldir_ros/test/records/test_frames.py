# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The tree of frames on a real graph."""

from pathlib import Path
from urllib.parse import urlparse
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from geometry_msgs.msg import PoseArray  # noqa: E402
from graph import Graph, wait_until  # noqa: E402
from schedules import CONFIG  # noqa: E402
from sensor_msgs.msg import CompressedImage, JointState  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from eldir.design import Design  # noqa: E402
from eldir_hardware.camera.plane import estimate_camera_pose, to_quaternion  # noqa: E402
from eldir_hardware.run.filming import RobotCamera  # noqa: E402
from eldir_ros.base.qualities import COMPLETE, LATCHED, STATIC  # noqa: E402
from eldir_ros.conversions import marks  # noqa: E402


def test_the_camera_stands_where_it_truly_is(tmp_path):
    told, pictures = [], []
    with Graph(tmp_path, ("camera", "mass_tracker"), "left") as graph:
        graph.ready()
        wait_until(lambda: any(n == "/tf_static" for n, _ in graph.node.get_topic_names_and_types()))
        graph.node.create_subscription(TFMessage, "/tf_static", told.append, STATIC)
        graph.node.create_subscription(
            CompressedImage, "camera/image_raw/compressed", pictures.append, COMPLETE
        )
        wait_until(lambda: told and pictures, 60)
        late: list[TFMessage] = []
        graph.node.create_subscription(TFMessage, "/tf_static", late.append, STATIC)
        wait_until(lambda: late)
    body, optical = late[0].transforms
    assert (body.header.frame_id, body.child_frame_id) == ("left/ground", "left/camera")
    assert (optical.header.frame_id, optical.child_frame_id) == ("left/camera", "left/camera_optical_frame")
    assert pictures[0].header.frame_id == "left/camera_optical_frame"
    camera = RobotCamera.load(CONFIG / "rig.yaml", CONFIG / "design.json")
    truth = estimate_camera_pose(camera._camera.plane, float(camera.lens.focal_px.mean()))
    place = body.transform.translation
    off = np.linalg.norm(np.array([place.x, place.y, place.z]) - truth.position)
    print(
        f"the camera is {1e3 * np.linalg.norm(truth.position):.0f} mm away, its frame {1e3 * off:.1f} mm off"
    )
    assert off < 0.02
    turn = optical.transform.rotation
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((-0.5, 0.5, -0.5, 0.5))
    assert to_quaternion(np.eye(3)) == pytest.approx((0, 0, 0, 1))


def test_the_robots_model_moves_with_the_robot(tmp_path):
    """Every link has a frame, every mesh a file; the hubs are where the virtual robot's masses are."""
    texts, joints, moved, truth = [], [], [], {}
    with Graph(tmp_path, ("camera", "mass_tracker", "robot_model")) as graph:
        graph.ready()
        listen = graph.node.create_subscription
        listen(String, "robot_description", texts.append, LATCHED)
        listen(JointState, "joint_states", joints.append, COMPLETE)
        listen(TFMessage, "/tf", moved.append, COMPLETE)
        listen(PoseArray, "bench/masses", lambda m: truth.update({stamp(m): m}), COMPLETE)
        wait_until(lambda: texts and moved and any(stamp(j) in truth for j in joints), 60)
        tree = ElementTree.fromstring(texts[0].data)
        files = [Path(urlparse(mesh.get("filename")).path) for mesh in tree.iter("mesh")]
        shapes = [trimesh.load_mesh(file) for file in files]
        behind = float(next(tree.iter("origin")).get("xyz").split()[1])
    assert len(shapes) == 33
    depths = [[round(1e3 * (y + behind), 2) for y in shape.vertices[:, 1]] for shape in shapes]
    assert {min(ys) for ys in depths} == {-0.4}, "the front of all hubs"
    design = Design.load(CONFIG / "design.json")
    in_seats = {hub for hub, ys in enumerate(depths) if 0.4 in ys}  # numbers are engraved into their floor
    assert in_seats == set(design.marks.tolist()), "the discs are in the plane of motion"
    frames = {t.child_frame_id for t in moved[0].transforms} | {"ground"}
    assert frames == {link.get("name") for link in tree.iter("link")}
    seen = next(j for j in joints if stamp(j) in truth)
    places = np.array(seen.position).reshape(-1, 3)[:, :2]
    off = np.linalg.norm(places - marks.positions_from(truth[stamp(seen)]), axis=1)
    print(f"hubs are at most {1e3 * off.max():.1f} mm off, {1e3 * np.median(off):.1f} mm half of them")
    assert off.max() < 0.02 and np.median(off) < 0.002
    assert not any(f.exists() for f in files), "the shapes go with the node"


def stamp(message):
    return (message.header.stamp.sec, message.header.stamp.nanosec)
