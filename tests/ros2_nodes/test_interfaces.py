"""What of the nodes' interfaces can be held without ROS: imports, private names, stubs, parameters."""

import ast
import subprocess
import sys

import pytest

from eldir_ros.base.parameter_table import PARAMETERS
from tests.paths import NODES
from tests.ros2_nodes.message_types import STUBS

MODULES = sorted((NODES / "eldir_ros").rglob("*.py"))
UNITS = {"s", "hz", "c"}


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
            if isinstance(c.func, ast.Name)
            and c.func.id in ("get_text", "get_texts", "get_number", "get_flag", "get_file", "find_file")
            and isinstance(c.args[1], ast.Constant)
        }
        assert read <= {spec.name for spec in specs}, node
