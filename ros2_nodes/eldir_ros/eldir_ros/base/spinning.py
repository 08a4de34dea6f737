# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Nodes in a process: joined to the graph, spun until SIGINT or SIGTERM, then shut down with all off."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from eldir.errors import EldirError
from eldir_ros.base.node_log import forward_records
from eldir_ros.base.waiting_executor import WaitingExecutor

_SPIN_TIMEOUT = 0.2  # until a node checks whether it has shut down [s]
_SIGNAL_INTERVAL = 0.05  # between two checks for signals: another thread may receive them [s]
_MAX_THREADS = 32  # of each node: more than it has callback groups, so that no group waits for a thread
LAUNCHER = "ELDIR_LAUNCHER"
"""Environment variable with the number of the process without which the nodes end: that of `ros2 launch`."""


def spin(classes: Sequence[Callable[[], Node]]) -> None:
    """Run nodes in this process until SIGINT or SIGTERM; the first one in the list is shut down first.

    ROS's own signal handlers would end the graph at once. Here each node can still publish how it ended.
    """
    ended, is_shut_down, failures = threading.Event(), threading.Event(), list[str]()
    received: list[int] = []
    launcher = os.environ.get(LAUNCHER, "")
    for number in (signal.SIGINT, signal.SIGTERM):
        # Not an event: it has a lock that this thread may hold when the signal arrives.
        signal.signal(number, lambda number, _: received.append(number))
    nodes: list[Any] = []
    executors: list[tuple[WaitingExecutor, threading.Thread]] = []
    try:
        with ros_errors_as_eldir_errors():
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        for node_class in classes:
            with ros_errors_as_eldir_errors():
                nodes.append(node_class())
            if len(nodes) == 1:
                forward_records(nodes[0].get_name(), nodes[0].get_logger())
            on_error = _ErrorCallback(nodes[-1], failures, ended)
            executor = WaitingExecutor(nodes[-1], _MAX_THREADS, on_error)
            spinning = threading.Thread(target=_spin, args=(executor, is_shut_down, ended, failures))
            spinning.start()
            executors.append((executor, spinning))
        while not received and not ended.wait(_SIGNAL_INTERVAL):
            if launcher and launcher != str(os.getppid()):
                nodes[0].get_logger().error("the launcher of this node has ended: the node ends")
                break
    except (EldirError, ParameterException) as error:
        failures.append(str(error))
    finally:
        for node in nodes:
            node.shut_down()
        is_shut_down.set()
        for executor, spinning in executors:
            spinning.join()
            executor.finish()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    for number in (signal.SIGINT, signal.SIGTERM):  # a second signal has no effect
        signal.signal(number, signal.SIG_IGN)
    if failures:
        sys.exit("; ".join(failures))


def _spin(
    executor: WaitingExecutor,
    is_shut_down: threading.Event,
    ended: threading.Event,
    failures: list[str],
) -> None:
    """Run one node's callbacks until it has shut down."""
    try:
        while not is_shut_down.is_set():
            executor.spin_once(timeout_sec=_SPIN_TIMEOUT)
    except ExternalShutdownException:
        pass
    except Exception as error:
        failures.append(f"{type(error).__name__}: {error}")
    ended.set()


class _ErrorCallback:
    """A callback of a node that fails ends the process in order.

    Not so an error of rclpy itself: in Jazzy, a transition that the lifecycle state does not have raises one
    in the service change_state. It then sends no answer, and there is no public way to one (rclpy #1209).
    """

    def __init__(self, node: Node, failures: list[str], ended: threading.Event):
        self._node, self._failures, self._ended = node, failures, ended

    def __call__(self, error: Exception) -> None:
        text = f"{type(error).__name__}: {error}".splitlines()[0]
        if is_ros_error(error):
            self._node.get_logger().error(text)
            return
        self._failures.append(text)
        self._ended.set()


def is_ros_error(error: Exception) -> bool:
    """Whether an exception is an error of the middleware; rclpy exports only `RuntimeError` for it."""
    return isinstance(error, RuntimeError) and type(error).__module__.startswith("rclpy.")


@contextmanager
def ros_errors_as_eldir_errors() -> Iterator[None]:
    """Raise errors of the middleware in this context as `EldirError`, with the reason in one line.

    With SROS 2 a program may use only the names that its enclave allows.
    """
    try:
        yield
    except RuntimeError as error:
        if not is_ros_error(error):
            raise
        reason = str(error).splitlines()[0].split(", at ")[0]
        if os.environ.get("ROS_SECURITY_ENABLE") != "true":
            raise EldirError(f"the graph cannot be joined: {reason}") from error
        enclave = os.environ.get("ROS_SECURITY_ENCLAVE_OVERRIDE", "/")
        raise EldirError(
            f"the graph cannot be joined: {reason}",
            expected="keys and permissions for what this program does (SROS 2)",
            found=f"enclave {enclave}",
            remedy="name an enclave that may do it in ROS_SECURITY_ENCLAVE_OVERRIDE",
        ) from error
