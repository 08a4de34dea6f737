# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The public interface of the nodes is what the reference lists; an inactive node publishes nothing."""

import ast
import inspect
import os
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import NODES, Graph, wait_until  # noqa: E402
from rosidl_runtime_py.utilities import get_message  # noqa: E402

from eldir_ros.base.qualities import COMPLETE  # noqa: E402

ROOT = Path(__file__).parents[3]
MANAGEMENT = {"alive", "emergency_stop", "diagnostics", "rosout", "parameter_events"}
"""Topics on which a node tells of itself, in every state; those of all ROS programs."""


def test_the_reference_lists_what_the_running_nodes_have(tmp_path):
    """`python docs/site/ros_interface.py` writes the page again, on a machine with ROS."""
    page = tmp_path / "ros-interface.md"
    command = [sys.executable, str(ROOT / "docs" / "site" / "ros_interface.py"), str(page)]
    subprocess.run(command, check=True, timeout=300, env=os.environ)
    assert page.read_text() == (ROOT / "docs" / "reference" / "ros-interface.md").read_text()


def test_an_inactive_node_publishes_nothing(tmp_path):
    """But that it is alive, whether a stop is latched, and its diagnostics."""
    nodes = (*NODES, "robot_model")
    heard: set[str] = set()
    with Graph(tmp_path, nodes) as graph:
        for name in nodes:
            assert graph.configure(name), graph.said(name)
        own = {
            topic: types[0]
            for name in nodes
            for topic, types in graph.node.get_publisher_names_and_types_by_node(name, "/")
            if topic.rpartition("/")[2] not in MANAGEMENT | {"transition_event"} and "/_action/" not in topic
        }
        assert len(own) > 20, own
        for topic, kind in own.items():
            graph.node.create_subscription(
                get_message(kind), topic, lambda _, t=topic: heard.add(t), COMPLETE
            )
        time.sleep(3.0)
        assert heard == set(), "configured"
        for name in nodes:
            assert graph.activate(name), graph.said(name)
        wait_until(lambda: {"/relay_board/states", "/marks", "/camera/image_raw/compressed"} <= heard, 60)
        for name in reversed(nodes):
            assert graph.deactivate(name), graph.said(name)
        time.sleep(1.0)  # what was on its way
        heard.clear()
        time.sleep(3.0)
        assert heard == set(), "deactivated"


def test_the_stubs_are_those_of_the_installed_rclpy():
    """What the stubs name exists, so that checking against them means something."""
    folder, lacking = ROOT / "ros2_nodes" / "stubs", []
    for stub in sorted([*(folder / "rclpy").rglob("*.pyi"), *(folder / "diagnostic_updater").rglob("*.pyi")]):
        name = ".".join(stub.relative_to(folder).with_suffix("").parts)
        module = import_module(name.removesuffix(".__init__"))
        for node in ast.parse(stub.read_text()).body:
            if isinstance(node, ast.FunctionDef):
                lacking += missing(module, node, module.__name__)
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                kind = getattr(module, node.name, None)
                if kind is None:
                    lacking.append(f"{module.__name__}.{node.name}")
                    continue
                for part in node.body:
                    if isinstance(part, ast.FunctionDef):
                        lacking += missing(kind, part, f"{module.__name__}.{node.name}")
                    elif isinstance(part, ast.Assign) and not hasattr(kind, part.targets[0].id):
                        lacking.append(f"{module.__name__}.{node.name}.{part.targets[0].id}")
    assert lacking == []


def missing(owner, function, place):
    """What of a stub's function the real one does not have."""
    real = getattr(owner, function.name, None)
    if real is None:
        return [f"{place}.{function.name}"]
    try:
        known = inspect.signature(real).parameters
    except (TypeError, ValueError):  # a property, or of C
        return []
    if any(p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL) for p in known.values()):
        return []
    named = [a.arg for a in (*function.args.args, *function.args.kwonlyargs)]
    return [f"{place}.{function.name}({n})" for n in named if n not in known and n != "self"]
