"""Writes reference/ros-interface.md: topics, services and actions of the running nodes, and their parameters.

`python docs/site/ros_interface.py [PAGE]` on a machine with ROS 2, in the environment of the nodes. It starts
the virtual rig's nodes on a private domain, activates them, and asks the graph.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "ros2_nodes" / "eldir_ros"))

from eldir_ros.base.parameter_table import PARAMETERS, ParameterSpec  # noqa: E402

PAGE = ROOT / "docs" / "reference" / "ros-interface.md"
_HEAD = """# Public interface of the nodes

Written by `docs/site/ros_interface.py` from the nodes of `virtual_rig.launch.py` on a graph; a test
holds it. What the names mean: [the rig on a ROS 2 graph](ros2.md). Left out is what every ROS node has:
`/rosout`, `/parameter_events`, `/clock`, services for parameters, and those of the lifecycle.

"""
_OF_EVERY_NODE = ("/rosout", "/parameter_events", "/clock")
_SERVICES_OF_EVERY_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
    "get_type_description",
    "change_state",
    "get_state",
    "get_available_states",
    "get_available_transitions",
    "get_transition_graph",
)
_DOMAIN, _PATIENCE, _QUIET = "107", 90.0, 3.0


def parameters_section() -> str:
    """The parameters of all nodes, from their table."""
    lines = ["## Parameters\n"]
    for node, specs in PARAMETERS.items():
        lines += [
            f"### Parameters of {node}\n",
            *_table("parameter | type | default | range | set | meaning", map(_row, specs)),
        ]
    return "\n".join(lines)


def _row(spec: ParameterSpec) -> tuple[str, ...]:
    span = f"{spec.low:g} to {spec.high:g}" if spec.kind == "double" else ""
    default = "not set" if spec.default in ("", (), None) else f"`{str(spec.default).lower()}`"
    when = "at the start" if spec.read_only else "at any time"
    return f"`{spec.name}`", spec.kind, default, span, when, spec.description


def _table(head: str, rows: Iterable[tuple[str, ...]]) -> list[str]:
    columns = head.count("|") + 1
    body = [f"| {' | '.join(row)} |" for row in rows]
    return [f"| {head} |", "|" + " --- |" * columns, *body, ""]


def _described(node: Any) -> str:
    """Topics, services and actions of the nodes, and differences of their parameters from the table."""
    lines = []
    for name in PARAMETERS:
        lines += [f"## {name}\n", *_topics(node, name), *_services(node, name)]
        _require_parameters(node, name)
    return "\n".join(lines)


def _topics(node: Any, name: str) -> list[str]:
    rows = []
    for verb, listed, informed in (
        ("publishes", node.get_publisher_names_and_types_by_node, node.get_publishers_info_by_topic),
        ("subscribes", node.get_subscriber_names_and_types_by_node, node.get_subscriptions_info_by_topic),
    ):
        for topic, (kind, *_) in sorted(listed(name, "/")):
            if topic in _OF_EVERY_NODE or "/_action/" in topic:
                continue
            (quality,) = {
                (e.qos_profile.reliability.name.lower(), e.qos_profile.durability.name.lower())
                for e in informed(topic)
                if e.node_name == name
            }
            rows.append(
                (verb, f"`{topic}`", kind.replace("/msg/", "/"), ", ".join(quality).replace("_", " "))
            )
    return _table("topic | name | type | quality of service", rows)


def _services(node: Any, name: str) -> list[str]:
    from rclpy.action import get_action_server_names_and_types_by_node

    rows = [
        ("service", f"`{service}`", kind.replace("/srv/", "/"))
        for service, (kind, *_) in sorted(node.get_service_names_and_types_by_node(name, "/"))
        if service.rpartition("/")[2] not in _SERVICES_OF_EVERY_NODE and "/_action/" not in service
    ]
    rows += [
        ("action", f"`{action}`", kind.replace("/action/", "/"))
        for action, (kind, *_) in sorted(get_action_server_names_and_types_by_node(node, name, "/"))
    ]
    return _table("offers | name | type", rows) if rows else []


def _require_parameters(node: Any, name: str) -> None:
    """The running node has the parameters of the table, with their descriptions, ranges and flags."""
    import rclpy
    from rcl_interfaces.srv import DescribeParameters

    client = node.create_client(DescribeParameters, f"/{name}/describe_parameters")
    client.wait_for_service(20.0)
    asked = client.call_async(DescribeParameters.Request(names=[s.name for s in PARAMETERS[name]]))
    rclpy.spin_until_future_complete(node, asked, timeout_sec=20.0)
    for spec, found in zip(PARAMETERS[name], asked.result().descriptors, strict=True):
        spans = [(r.from_value, r.to_value) for r in found.floating_point_range]
        wanted = [(spec.low, spec.high)] if spec.kind == "double" else []
        assert (found.description, found.read_only, spans) == (spec.description, spec.read_only, wanted), (
            spec.name
        )


def main() -> None:
    """Write the page."""
    import rclpy

    os.environ |= {"ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with tempfile.TemporaryDirectory() as folder:
        command = [
            "ros2",
            "launch",
            "eldir_ros",
            "virtual_rig.launch.py",
            "run:=false",
            "model:=true",
            f"logs:={folder}",
        ]
        launched = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        rclpy.init()
        node = rclpy.create_node("reader")
        try:
            deadline, before, text = time.monotonic() + _PATIENCE, "", " "
            while not _is_complete(node) or text != before:
                assert time.monotonic() < deadline, "the nodes are not complete"
                time.sleep(_QUIET)
                before, text = text, _described(node) if _is_complete(node) else ""
        finally:
            launched.send_signal(signal.SIGINT)
            launched.wait(30)
            rclpy.try_shutdown()
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else PAGE
    place.write_text(_HEAD + text + "\n" + parameters_section())


def _is_complete(node: Any) -> bool:
    """Whether all nodes are there, and the relay board has been configured."""
    topics = {name for name, _ in node.get_topic_names_and_types()}
    names = node.get_node_names()
    return (
        set(PARAMETERS) <= set(names)
        and any(t.startswith("/springs/") for t in topics)
        and "/marks/m5" in topics
    )


if __name__ == "__main__":
    main()
