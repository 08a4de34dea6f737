# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Markers of the kind that the rig file names, on a table and on a printed ground."""

import json
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from geometry_msgs.msg import PoseArray  # noqa: E402
from graph import NODES, Graph, require_unless_busy, wait_until  # noqa: E402
from schedules import CONFIG, SLOW  # noqa: E402
from sensor_msgs.msg import CompressedImage  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402
from visualization_msgs.msg import MarkerArray  # noqa: E402

from eldir.design import Design  # noqa: E402
from eldir.parameters.printed import BuiltParameters  # noqa: E402
from eldir.terrain import Terrain  # noqa: E402
from eldir_hardware.log.reader import read_log  # noqa: E402
from eldir_hardware.rig.configuration import Rig  # noqa: E402
from eldir_hardware.safety.compatibility import with_digests  # noqa: E402
from eldir_hardware.schedule import ActuationSchedule  # noqa: E402
from eldir_hardware.vision.pipeline import track_log  # noqa: E402
from eldir_ros.base.qualities import COMPLETE  # noqa: E402
from eldir_ros.conversions import marks, nanoseconds, runs  # noqa: E402

SMALL_DESIGN = Path(__file__).parents[4] / "tests" / "data" / "demo-design.json"


def track_standing_robot(graph, design):
    """Distances of the tracked masses from the true ones in the first picture that shows all [m]."""
    seen, truth = {}, {}
    listen = graph.node.create_subscription
    listen(MarkerArray, "marks", lambda m: seen.update([marks.tracks_from(m)[::2]]), COMPLETE)
    listen(PoseArray, "bench/masses", lambda m: truth.update({nanoseconds(m.header.stamp): m}), COMPLETE)
    graph.ready()
    wait_until(lambda: any(t in truth and np.isfinite(p).all() for t, p in list(seen.items())), 120)
    stamp, places = next((t, p) for t, p in seen.items() if t in truth and np.isfinite(p).all())
    return np.linalg.norm(places - marks.positions_from(truth[stamp])[design.marks], axis=1)


@pytest.mark.parametrize("kind", ["aruco", "apriltag"])
def test_markers_of_the_rig_files_kind_are_tracked(tmp_path, kind):
    rig = tmp_path / "rig.yaml"
    large = "camera: {kind: virtual, rate_hz: 5, width: 1280, height: 960}"  # squares need 24 pixels
    text = (CONFIG / "rig.yaml").read_text().replace("camera: {kind: virtual, rate_hz: 10}", large)
    rig.write_text(f"{text}marker: {kind}\n")
    found = []
    with Graph(tmp_path, ("camera", "mass_tracker"), rig=rig) as graph:
        if find_spec("vision_msgs"):
            from vision_msgs.msg import Detection2DArray

            graph.node.create_subscription(Detection2DArray, "marks/detections", found.append, COMPLETE)
        off = track_standing_robot(graph, Design.load(CONFIG / "design.json"))
        assert f"markers: {kind}" in graph.said("mass_tracker")
    print(f"{kind}: at most {1e3 * off.max():.2f} mm from the true places")
    assert off.max() < 2e-3
    assert not found or {d.id for d in found[-1].detections} <= {"m1", "m2", "m3", "m4", "m5"}


def test_a_robot_that_may_leave_its_plane_is_seen_in_space(tmp_path):
    rig, values = tmp_path / "rig.yaml", yaml.safe_load((CONFIG / "rig.yaml").read_text())
    values["virtual"] |= {"physics": "mujoco", "dimensions": 3}
    values["supply"]["outputs"] = "each"
    rig.write_text(yaml.safe_dump(values))
    discs = []
    # The package's own design has 33 masses: in space that is slower than the clock.
    design = Design.load(SMALL_DESIGN)
    with Graph(tmp_path, ("camera", "mass_tracker"), rig=rig, design=SMALL_DESIGN) as graph:
        graph.node.create_subscription(PoseArray, "bench/discs", discs.append, COMPLETE)
        off = track_standing_robot(graph, design)
    print(f"in space: at most {1e3 * off.max():.2f} mm from the true places")
    assert off.max() < 3e-3, "it stands, and leans hardly"
    assert marks.discs_from(discs[0]).outsides.shape == (len(design.morphology.positions), 2, 3)


def test_a_run_on_a_printed_ground_is_tracked_recorded_and_shown_beside_its_prediction(tmp_path):
    steep = Terrain.rugged(np.random.default_rng(2)).scaled(BuiltParameters().scale)
    # On a fifth of its heights the robot does not tumble, which no prediction would follow.
    ground = replace(steep, slope=0.2 * steep.slope, intercept=0.2 * steep.intercept)
    design, rig = replace(Design.load(CONFIG / "design.json"), printed_terrain=ground), CONFIG / "rig.yaml"
    design.save(tmp_path / "design.json")
    schedule = with_digests(ActuationSchedule.from_json(SLOW), Rig.load(rig), design)
    pictures, predicted, drawn, moved = [], {}, [], {}

    def on_frames(message):
        for t in message.transforms:
            if t.child_frame_id in ("hub_00_at_x", "predicted/hub_00_at_x"):
                place = moved.setdefault(t.child_frame_id, {})
                place[nanoseconds(t.header.stamp)] = t.transform.translation.x

    with Graph(tmp_path, (*NODES, "robot_model"), design=tmp_path / "design.json") as graph:
        listen = graph.node.create_subscription
        listen(
            PoseArray,
            "predicted/masses",
            lambda m: predicted.update({nanoseconds(m.header.stamp): m}),
            COMPLETE,
        )
        listen(MarkerArray, "predicted/robot_springs", drawn.append, COMPLETE)
        listen(TFMessage, "/tf", on_frames, COMPLETE)
        listen(CompressedImage, "marks/overlay/compressed", pictures.append, COMPLETE)
        graph.ready()
        result = graph.result(graph.send(schedule.to_json()), 120)
        assert result.outcome == runs.FINISHED, result.message
        wait_until(lambda: "wrote" in graph.said("mcap_recorder"))
        wait_until(lambda: "cycle 1: tracked" in graph.said("range_of_motion"), 90)
        is_predicted = "has no predicted ranges" not in graph.said("range_of_motion")
        assert pictures and "Traceback" not in graph.said("mass_tracker")
    (log,) = map(read_log, tmp_path.glob("run-*/log.mcap"))
    assert Design.from_json(json.loads(log.attachments["design.json"])) == design
    np.testing.assert_array_equal(log.tracks.positions, track_log(log).positions)
    require_unless_busy(is_predicted, "no motion was predicted")
    assert {m.ns for m in drawn[0].markers} == {"predicted strips", "predicted coils"}
    both = sorted(set(moved["hub_00_at_x"]) & set(moved["predicted/hub_00_at_x"]) & set(predicted))
    apart = [moved["hub_00_at_x"][t] - moved["predicted/hub_00_at_x"][t] for t in both]
    print(
        f"{len(both)} instants of both robots, the first hub at most {1e3 * np.abs(apart).max():.1f} mm apart"
    )
    assert both and np.abs(apart).max() < 0.05, "over each other"
    require_unless_busy(len(both) > 20, f"{len(both)} instants of both robots")
    for t in both[:3]:
        assert marks.positions_from(predicted[t])[0, 0] == moved["predicted/hub_00_at_x"][t]
    assert np.isfinite(log.tracks.positions).all()
