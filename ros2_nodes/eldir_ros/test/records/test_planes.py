# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""A log holds the plane in which its run was tracked, whatever came first: plane or run."""

import json
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from eldir_msgs.msg import MotionPlane, Run  # noqa: E402
from graph import Graph, wait_until  # noqa: E402
from schedules import SHORT  # noqa: E402

from eldir_hardware.camera.plane import Plane  # noqa: E402
from eldir_hardware.log.reader import read_log  # noqa: E402
from eldir_hardware.schedule import ActuationSchedule  # noqa: E402
from eldir_hardware.vision.pipeline import FIRST_PICTURE_KEY  # noqa: E402
from eldir_ros.base.qualities import LATCHED  # noqa: E402
from eldir_ros.conversions import reference, runs  # noqa: E402
from eldir_ros.conversions.schedules import schedule_of  # noqa: E402

START = 1_800_000_000_000_000_000
EARLIER, OWN, LATER = START - 5, START + 7, START + 9


@pytest.mark.parametrize(
    "order",
    [(EARLIER, "run", OWN, LATER), (EARLIER, OWN, "run"), ("run", EARLIER, OWN), (OWN, "run", EARLIER)],
)
def test_the_plane_is_that_of_the_run(tmp_path, order):
    schedule = ActuationSchedule.from_json(SHORT)
    with Graph(tmp_path, ("mcap_recorder",)) as graph:
        graph.ready()
        planes = graph.node.create_publisher(MotionPlane, "camera/plane", LATCHED)
        states = graph.node.create_publisher(Run, "run", LATCHED)
        wait_until(lambda: planes.get_subscription_count() and states.get_subscription_count())
        for sent in order:
            if sent == "run":
                states.publish(runs.run_of(Run.RUNNING, "a", START, schedule_of(schedule), ""))
                wait_until(lambda: "recording" in graph.said("mcap_recorder"))
            else:
                provenance = {FIRST_PICTURE_KEY: sent}
                plane = Plane(640, 480, np.eye(3), np.array([320.0, 240.0]), np.zeros(2), 0.1, provenance)
                planes.publish(reference.plane_of(plane))
                # No node tells that it has heard a plane. One that is heard later makes another order, in
                # which the same must hold.
                time.sleep(0.5)
        states.publish(runs.run_of(Run.ENDED, "a", START, schedule_of(schedule), "over"))
        wait_until(lambda: "wrote" in graph.said("mcap_recorder"))
    (log,) = tmp_path.glob("run-*/log.mcap")
    kept = json.loads(read_log(log).attachments["plane.json"])
    assert kept["provenance"][FIRST_PICTURE_KEY] == OWN
