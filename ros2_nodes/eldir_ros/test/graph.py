# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""A rig of real node processes on a private domain, and a client to command and watch it."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import threading
import time
from collections import deque
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import EmergencyStop, Heartbeat
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from schedules import CONFIG
from std_srvs.srv import Trigger

from eldir_hardware.realtime import COMMANDS, request_realtime_priority
from eldir_ros.base.qualities import COMPLETE, LATCHED
from eldir_ros.conversions.schedules import read_schedule, schedule_of
from eldir_ros.remote.graph_check import HEATING, OBSERVERS
from eldir_ros.remote.heartbeats import PERIOD

# A killed node stays in a domain's discovery for ten seconds: the next test could mistake it for its own.
_DOMAINS = itertools.cycle(range(100 + os.getpid() % 50, 200))
NODES = (*HEATING, *OBSERVERS)
PATIENCE = 60.0
"""Programs have this long to start and to answer where time is not what is tested [s]."""


class Stalls:
    """How long this machine holds a process up that wants to run: a deadline is later by as much."""

    def __init__(self) -> None:
        self.worst = 0.0
        """Longest time by which a short sleep was overslept in the last five seconds [s]."""
        threading.Thread(target=self._measure, daemon=True).start()

    def _measure(self) -> None:
        late: deque[tuple[float, float]] = deque()
        while True:
            begun = time.monotonic()
            time.sleep(0.01)
            now = time.monotonic()
            late.append((now, now - begun - 0.01))
            while late[0][0] < now - 5.0:
                late.popleft()
            self.worst = max(seconds for _, seconds in late)


@cache
def stalls() -> Stalls:
    """The one measurement of this process."""
    return Stalls()


class Graph:
    """Use as a context; `folder` gets logs, the bench's trace and the nodes' output.

    `beside`: another rig, on whose domain this one lives in a namespace of its own. `simulated`: nodes
    whose stamps follow /clock.
    """

    def __init__(
        self,
        folder: Path,
        nodes: tuple[str, ...] = NODES,
        namespace: str = "",
        beside: Graph | None = None,
        simulated: tuple[str, ...] = (),
        rig: Path = CONFIG / "rig.yaml",
        design: Path = CONFIG / "design.json",
    ):
        self.folder, self._names, self._namespace = folder, nodes, namespace
        self._simulated, self._files = simulated, {"rig": rig, "design": design}
        self.domain: int = next(_DOMAINS) if beside is None else beside.domain
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.feedback: list[Any] = []
        self.diagnostics: list[Any] = []
        self._clients: dict[str, Any] = {}
        self.stalls = stalls()
        self.required = [n for n in OBSERVERS if n in nodes]

    def __enter__(self) -> Graph:
        domain = self.domain
        self.environment = {**os.environ, "PYTHONUNBUFFERED": "1", "ROS_DOMAIN_ID": str(domain)}
        self._context = Context()
        rclpy.init(domain_id=domain, context=self._context)
        self.node = rclpy.create_node("tester", namespace=self._namespace, context=self._context)
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda m: self.diagnostics.extend(m.status), COMPLETE
        )
        self.stops: list[Any] = []
        """Messages of the emergency stop, the latest last."""
        self.node.create_subscription(EmergencyStop, "emergency_stop", self.stops.append, LATCHED)
        self._states: dict[str, str] = {}
        hear = lambda m: self._states.update({m.name: m.state.label})  # noqa: E731
        self.node.create_subscription(Heartbeat, "alive", hear, COMPLETE)
        self._action = ActionClient(self.node, RunSchedule, "run_schedule")
        self.beating = True
        """Whether the heartbeats of the goals' client are sent."""
        self._alive = self.node.create_publisher(Heartbeat, "run_schedule/alive", COMPLETE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._left = threading.Event()
        self._spinning = threading.Thread(target=self._spin, daemon=True)
        self._spinning.start()
        self._beat = threading.Thread(target=self._send_heartbeats, daemon=True)
        self._beat.start()
        self.start("virtual_bench")
        wait_until((self.folder / "board").exists)
        for name in self._names:
            self.start(name)
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self.processes.values()):
            if process.poll() is None:
                process.terminate()
        for process in self.processes.values():
            process.wait(PATIENCE)
        self._left.set()  # Jazzy's executor must not be shut down while another thread spins it
        self._spinning.join()
        self._beat.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _spin(self) -> None:
        while not self._left.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _send_heartbeats(self) -> None:
        """In a thread of their own: what else the tester hears must not delay them, nor other programs."""
        request_realtime_priority(COMMANDS)
        while not self._left.wait(PERIOD):
            if self.beating:
                self._alive.publish(Heartbeat(name="tester"))

    def start(self, name: str, *arguments: str, **parameters: object) -> subprocess.Popen[bytes]:
        """Start a node in a process of its own."""
        own: dict[str, object] = {
            **self._files,
            "port": self.folder / "board",
            "trace": self.folder / "trace.jsonl",
            "folder": self.folder,
            "lead_s": 0.5,
            "use_sim_time": name in self._simulated,
            "reliable_pictures": True,
            "required_nodes": json.dumps([*self.required, ""]),
            **parameters,
        }
        texts = [t for key, value in own.items() if value != "" for t in ("-p", f"{key}:={value}")]
        program = Path(get_package_prefix("eldir_ros")) / "lib" / "eldir_ros" / name
        output = (self.folder / f"{name}.txt").open("ab")
        command = [str(program), *arguments, "--ros-args", "-r", f"__ns:=/{self._namespace}", *texts]
        self.processes[name] = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env=self.environment
        )
        return self.processes[name]

    def said(self, name: str) -> str:
        """What a node has written so far."""
        return (self.folder / f"{name}.txt").read_text()

    # Lifecycle and services.

    def request(self, name: str, transition: int) -> Any:
        """Ask a node to change its state; the answer to come."""
        client = self._client(ChangeState, f"{name}/change_state")
        return client.call_async(ChangeState.Request(transition=Transition(id=transition)))

    def change(self, name: str, transition: int) -> bool:
        return bool(self._wait(self.request(name, transition)).success)

    def configure(self, name: str) -> bool:
        return self.change(name, Transition.TRANSITION_CONFIGURE)

    def activate(self, name: str) -> bool:
        return self.change(name, Transition.TRANSITION_ACTIVATE)

    def deactivate(self, name: str) -> bool:
        return self.change(name, Transition.TRANSITION_DEACTIVATE)

    def state(self, name: str) -> str:
        client = self._client(GetState, f"{name}/get_state")
        label = self._wait(client.call_async(GetState.Request())).current_state.label
        return str(label)

    def ready(self) -> None:
        """All nodes active."""
        for name in self._names:
            assert self.configure(name), self.said(name)
            assert self.activate(name), self.said(name)
        # The sequencer knows it by their heartbeats, as run_schedule does before it sends a goal.
        wait_until(lambda: all(self._states.get(name) == "active" for name in self._names), 2 * PATIENCE)

    def call(self, service: str) -> Any:
        client = self._client(Trigger, service)
        return self._wait(client.call_async(Trigger.Request()))

    def _client(self, kind: Any, service: str) -> Any:
        """Kept to the end: destroying one while the executor spins can end the executor."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
        assert self._clients[service].wait_for_service(PATIENCE), service
        return self._clients[service]

    # The action.

    def send(self, schedule: dict[str, Any]) -> Any:
        """Send a schedule; its goal handle."""
        return self.order(RunSchedule.Goal(schedule=message_of(schedule), client="tester"))

    def order(self, goal: Any) -> Any:
        """Send a goal; its handle."""
        self.feedback.clear()
        assert self._action.wait_for_server(PATIENCE)
        wait_until(lambda: self._alive.get_subscription_count() > 0)
        # In the thread that spins: rclpy drops an answer that comes before the sender has noted its request.
        sent = self._executor.create_task(
            self._action.send_goal_async, goal, lambda m: self.feedback.append(m.feedback)
        )
        return self._wait(self._wait(sent, PATIENCE))

    def result(self, goal: Any, patience: float = PATIENCE) -> Any:
        return self._wait(goal.get_result_async(), patience).result

    def heating(self, schedule: dict[str, Any]) -> Any:
        """Send a schedule, and return its goal when a contact has just closed."""
        before = len(self.edges())
        goal = self.send(schedule)
        ended = goal.get_result_async()
        wait_until(lambda: ended.done() or any(closed for _, _, closed in self.edges()[before:]), 30)
        assert not ended.done(), ended.result().result.message
        time.sleep(0.3)
        return goal

    # The truth.

    def edges(self) -> list[tuple[float, int, bool]]:
        """When the emulated board's contacts switched, on the monotonic clock."""
        return edges_in(self.folder / "trace.jsonl")

    def all_off(self, patience: float = 5.0) -> float:
        """Wait until every contact is open; when the last one opened."""
        trace = self.folder / "trace.jsonl"
        wait_until(lambda: all_open(trace), patience)
        time.sleep(0.3)
        assert all_open(trace), "a contact closed again"
        return self.edges()[-1][0]

    def require_within(self, seconds: float, most: float) -> None:
        """Something took no longer than `most` [s], and than the machine withheld its processor meanwhile."""
        assert seconds < most + self.stalls.worst, f"this process was held up for {self.stalls.worst:.2f} s"

    def _wait(self, future: Any, patience: float = PATIENCE) -> Any:
        wait_until(future.done, patience)
        return future.result()


def message_of(schedule: dict[str, Any]) -> Any:
    """The message of a schedule file's content."""
    return schedule_of(read_schedule(json.dumps(schedule)))


def is_busy() -> bool:
    """Whether other programs keep this computer from what has a lower priority than heat: predictions, ten
    pictures a second, and all that runs in one process with them. A graph alone makes a load of up to 5 on
    two processors."""
    return os.getloadavg()[0] > 3 * (os.cpu_count() or 1)


def require_unless_busy(is_so: bool, what: str) -> None:
    """Fail with `what` where something is not so; on a busy computer skip the rest of the test."""
    if not is_so and is_busy():
        pytest.skip(f"not on a computer with a load of {os.getloadavg()[0]:.0f}: {what}")
    assert is_so, what


def wait_until(condition: Any, patience: float = PATIENCE) -> None:
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, "the condition was not met in time"
        time.sleep(0.01)


def edges_in(trace: Path) -> list[tuple[float, int, bool]]:
    """Edges in the trace of a virtual bench: time, channel, and whether the contact closed."""
    try:
        lines = trace.read_text().splitlines()
    except FileNotFoundError:
        return []
    return [(e["t_s"], e["channel"], e["closed"]) for e in map(json.loads, lines)]


def all_open(trace: Path) -> bool:
    """Whether no contact is closed after the edges in a trace."""
    return not any({channel: closed for _, channel, closed in edges_in(trace)}.values())
