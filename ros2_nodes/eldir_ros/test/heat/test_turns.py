# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""A node that has more to do than it can still hears every topic and answers every service."""

import threading
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import PATIENCE, wait_until  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import MultiThreadedExecutor  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from eldir_ros.base.qualities import COMPLETE  # noqa: E402
from eldir_ros.base.rig_node import RigNode  # noqa: E402


class Busy(RigNode):
    """Gets a picture every 10 ms, and works on each for 30 ms; its timer is always due."""

    def __init__(self, **options):
        super().__init__("robot_model", **options)  # with its parameters
        self.pictures, self.heard = 0, []
        self.every(0.01, lambda: time.sleep(0.03))
        self.listen(String, "pictures", self._on_picture, COMPLETE)
        self.listen(String, "run", lambda m: self.heard.append(m.data), COMPLETE)
        self.serve(Trigger, "stop", self._on_stop_service)

    def _on_picture(self, message):
        self.pictures += 1
        time.sleep(0.03)

    def _on_stop_service(self, request, response):
        response.success = True
        return response


@pytest.fixture
def nodes():
    """The busy node, and another one beside it."""
    context = Context()
    rclpy.init(context=context)
    executor = MultiThreadedExecutor(32, context=context)
    busy, other = Busy(context=context), rclpy.create_node("other", context=context)
    for node in (busy, other):
        executor.add_node(node)
    left = threading.Event()

    def spin():
        while not left.is_set():
            executor.spin_once(timeout_sec=0.1)

    spinning = threading.Thread(target=spin)
    spinning.start()
    yield busy, other
    left.set()
    spinning.join()
    executor.shutdown(timeout_sec=1.0)
    for node in (busy, other):
        node.destroy_node()
    context.try_shutdown()


def test_a_topic_that_always_has_a_message_keeps_no_other_from_being_heard(nodes):
    busy, other = nodes
    pictures, run = (other.create_publisher(String, name, COMPLETE) for name in ("pictures", "run"))
    stop = other.create_client(Trigger, "stop")
    wait_until(lambda: pictures.get_subscription_count() and run.get_subscription_count())
    assert stop.wait_for_service(PATIENCE)
    other.create_timer(0.01, lambda: pictures.publish(String(data="picture")))
    wait_until(lambda: busy.pictures > 5)
    for number in range(5):
        asked = time.monotonic()
        run.publish(String(data=str(number)))
        stopped = stop.call_async(Trigger.Request())
        wait_until(lambda n=number: len(busy.heard) > n, 5)
        wait_until(stopped.done, 5)
        print(f"heard and answered after {time.monotonic() - asked:.2f} s, {busy.pictures} pictures")
    assert busy.heard == list("01234") and stopped.result().success
