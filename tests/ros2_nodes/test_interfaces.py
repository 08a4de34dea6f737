"""What of the nodes' interfaces can be held without ROS: imports, private names, stubs, parameters."""

import ast
import json
import math
import re
import runpy
import subprocess
import sys
import tomllib

import pytest
import yaml

from eldir_ros.base.parameter_table import PARAMETERS
from tests.paths import NODES, ROOT
from tests.ros2_nodes.message_types import STUBS

MODULES = sorted((NODES / "eldir_ros").rglob("*.py"))
INTERFACE = ROOT / "docs" / "reference" / "ros-interface.md"
UNITS = {"s", "hz", "c"}
READERS = (
    "get_text",
    "get_texts",
    "get_number",
    "get_flag",
    "get_file",
    "find_file",
    "find_log",
    "get_record",
)
"""Functions that read the parameter which their second argument names."""


def test_what_runs_without_ros_imports_no_rclpy():
    names = "conversions.board conversions.marks conversions.pictures conversions.runs remote.heartbeats"
    names += " remote.remote_bank remote.schedule_run base.parameter_table"
    imports = ", ".join(f"eldir_ros.{m}" for m in names.split())
    code = (
        "from tests.ros2_nodes.message_types import provide_modules; provide_modules()\n"
        f"import sys, {imports}; sys.exit(any(m.split('.')[0] == 'rclpy' for m in sys.modules))"
    )
    path = {"PYTHONPATH": f"{NODES}:{NODES.parents[1]}"}
    assert subprocess.run([sys.executable, "-c", code], env=path, check=False).returncode == 0


def test_the_stubs_are_those_of_the_messages(monkeypatch):
    """`python ros2_nodes/stubs/write_message_stubs.py` writes them again."""
    monkeypatch.syspath_prepend(str(STUBS))
    from write_message_stubs import stubs

    written = stubs()
    assert {p: (STUBS / p).read_text() for p in written} == written


def test_nodes_use_no_private_name_of_ros():
    """Neither a module of rclpy with an underscore, nor a private attribute of its objects."""
    found = []
    for path in MODULES:
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and "._" in (node.module or "").replace("__", ""):
                found.append(f"{path.name}: {node.module}")
        chained = {
            f"{ast.unparse(node.value)}.{node.attr}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and node.attr.startswith("_") and node.attr[1] != "_"
        }
        found += [f"{path.name}: {name}" for name in chained if not name.startswith("self._")]
        made = {
            n.attr for n in ast.walk(tree) if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store)
        } | {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
        made |= {
            n.target.attr
            for n in ast.walk(tree)
            if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Attribute)
        }
        found += [f"{path.name}: {name}" for name in chained if name.split(".")[1] not in made]
    assert found == []


@pytest.mark.parametrize("node", PARAMETERS)
def test_a_parameter_has_a_description_a_default_in_its_range_and_its_unit(node):
    for spec in PARAMETERS[node]:
        assert spec.description.endswith((".", "]")), spec.name
        if spec.kind == "double":
            assert spec.low < spec.high and (spec.default is None or spec.low <= spec.default <= spec.high)
            has_unit = any(f"[{unit}]" in spec.description for unit in ("s", "1/s", "C"))
            assert has_unit == (spec.name.rpartition("_")[2] in UNITS), spec.name
        else:
            assert (spec.low, spec.high) == (0.0, 0.0) and spec.read_only, spec.name
    assert len({spec.name for spec in PARAMETERS[node]}) == len(PARAMETERS[node])


def test_every_parameter_is_read_and_every_one_that_is_read_is_declared():
    for node, specs in PARAMETERS.items():
        source = (NODES / "eldir_ros" / "nodes" / f"{node}.py").read_text()
        quoted = {n.value for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Constant)}
        shared = {"autostart", "reliable_pictures"}  # read by the base of the nodes
        assert {spec.name for spec in specs} - quoted <= shared, node
        calls = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
        read = {
            c.args[1].value
            for c in calls
            if isinstance(c.func, ast.Name) and c.func.id in READERS and isinstance(c.args[1], ast.Constant)
        }
        assert read <= {spec.name for spec in specs}, node


def test_the_page_of_the_interface_lists_the_parameters_of_the_table():
    """`python docs/site/ros_interface.py`, where ROS is, writes topics and services too."""
    section = runpy.run_path(str(ROOT / "docs" / "site" / "ros_interface.py"))["parameters_section"]()
    assert INTERFACE.read_text().endswith(section)


def test_the_page_of_the_interface_has_the_topics_of_the_nodes():
    """As far as their names are texts in the source; types of our own have a definition."""
    page = INTERFACE.read_text()
    for node in PARAMETERS:
        tree = ast.parse((NODES / "eldir_ros" / "nodes" / f"{node}.py").read_text())
        section = page.partition(f"## {node}\n")[2].partition("\n## ")[0]
        for call in (n for n in ast.walk(tree) if isinstance(n, ast.Call)):
            name = call.func.attr if isinstance(call.func, ast.Attribute) else ""
            if name in ("advertise", "listen", "serve") and isinstance(call.args[1], ast.Constant):
                topic = "/" + call.args[1].value.replace("~", node).lstrip("/")
                assert f"`{topic}`" in section, f"{node}: {topic}"
    own = set(re.findall(r"eldir_msgs/(\w+)", page))
    defined = {p.stem for p in (NODES.parent / "eldir_msgs").glob("*/*.*")}
    assert own and own <= defined


def test_viewers_show_topics_of_the_nodes():
    """The configuration of RViz, whose names are within the rig's namespace, and the layout of Foxglove."""
    page, config = INTERFACE.read_text(), NODES / "config"
    displays = yaml.safe_load((config / "rig.rviz").read_text())["Visualization Manager"]["Displays"]
    shown = [d.get("Topic", d.get("Description Topic", {})).get("Value") for d in displays]
    panels = json.loads((config / "foxglove.json").read_text())["configById"].values()
    in_layout = {name for panel in panels for name in panel.get("topics", {})}
    in_layout |= {name for panel in panels for name in panel.get("imageMode", {}).values()}
    in_layout |= {path["value"].split(".")[0] for panel in panels for path in panel.get("paths", [])}
    assert {"robot_springs", "predicted/robot_springs", "marks"} <= {name for name in shown if name}
    assert "/predicted/robot_springs" in in_layout
    for name in {f"/{name}" for name in shown if name} | in_layout:
        assert f"`{name}`" in page or name == "/diagnostics", name


def test_viewers_look_at_the_front_of_the_robot():
    """From negative y, with x to the right. Without `perspective` Foxglove looks from above, at a line."""
    rviz = yaml.safe_load((NODES / "config" / "rig.rviz").read_text())
    view = rviz["Visualization Manager"]["Views"]["Current"]
    assert view["Class"] == "rviz_default_plugins/Orbit"
    assert view["Target Frame"] == "<Fixed Frame>", "that of a namespace too"
    assert rviz["Window Geometry"]["QMainWindow State"], "without it the panels leave a strip for the robot"
    assert math.sin(view["Yaw"]) * math.cos(view["Pitch"]) < -0.98
    for layout in (NODES / "config" / "foxglove.json", ROOT / "docs" / "foxglove-layout.json"):
        panels = json.loads(layout.read_text())["configById"]
        camera = panels["3D!marks"]["cameraState"]
        assert camera["perspective"]
        phi, theta = math.radians(camera["phi"]), math.radians(camera["thetaOffset"])
        assert math.sin(phi) * math.cos(theta) > 0.98, layout.name
        for name, panel in panels.items():  # each program has a key of its own
            assert panel["foxglovePanelTitle"] == panel["lichtblickPanelTitle"], name


def test_what_comes_from_pypi_has_a_key_of_rosdep():
    keys = yaml.safe_load((NODES.parent / "rosdep.yaml").read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert keys["eldir-requirements-pip"]["ubuntu"]["pip"]["packages"] == project["dependencies"]
    package = (NODES / "package.xml").read_text()
    assert "<exec_depend>eldir-requirements-pip</exec_depend>" in package


def test_the_foreign_client_has_thirty_lines_and_imports_nothing_of_ours():
    text = (NODES / "examples" / "foreign_client.py").read_text()
    imported = {n.module for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom)}
    assert imported == {
        "pathlib",
        "builtin_interfaces.msg",
        "eldir_msgs.action",
        "eldir_msgs.msg",
        "rclpy.action",
    }
    body = text[text.index("FACES =") :]
    assert len([line for line in body.splitlines() if line.strip()]) <= 30
