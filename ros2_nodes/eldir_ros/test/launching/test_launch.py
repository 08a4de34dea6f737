# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The launch files, by launch_testing: in a process of its own, whatever the version of pytest."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytest.importorskip("launch_testing", reason="needs ROS 2 Jazzy with launch_testing")


def test_the_virtual_rig_plays_its_schedule():
    file = Path(__file__).parent / "virtual_rig_launch_test.py"
    command = [sys.executable, "-m", "launch_testing.launch_test", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]


def test_rviz_has_the_names_of_a_namespace():
    """All topics are relative to it, but that of the camera: RViz looks for its camera_info from the root."""
    from eldir_ros.programs.launching import in_namespace

    text = (Path(__file__).parents[2] / "config" / "rig.rviz").read_text()
    displays = yaml.safe_load(in_namespace(text, "left"))["Visualization Manager"]["Displays"]
    named = {display["Name"]: display for display in displays}
    assert named["Tracked robot"]["TF Prefix"] == "left"
    absolute = [d["Name"] for d in displays if d.get("Topic", {}).get("Value", "").startswith("/")]
    assert absolute == ["Picture"] and named["Picture"]["Topic"]["Value"] == "/left/camera/image_raw"
