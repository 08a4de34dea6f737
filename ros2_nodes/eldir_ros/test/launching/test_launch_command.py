# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The launch files through `ros2 launch`: they start, end with what happened, and leave nothing behind."""

import json
import os
import re
import signal
import subprocess
import time

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from graph import PATIENCE, all_open, edges_in, stalls, wait_until  # noqa: E402
from schedules import LONG, SHORT  # noqa: E402


class Launch:
    """`ros2 launch` of the virtual rig in a group of its own; its output is in a file."""

    def __init__(self, folder, schedule, *arguments, prefix=None):
        self.trace, self._output = folder / "trace.jsonl", folder / "launch.txt"
        (folder / "schedule.json").write_text(json.dumps(schedule))
        given = {"schedule": folder / "schedule.json", "logs": folder, "trace": self.trace}
        command = ["ros2", "launch", "eldir_ros", "virtual_rig.launch.py"]
        command += [f"{name}:={value}" for name, value in given.items()]
        prefixes = os.pathsep.join([*([str(prefix)] if prefix else []), os.environ["AMENT_PREFIX_PATH"]])
        with self._output.open("wb") as output:
            self.process = subprocess.Popen(
                [*command, *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"AMENT_PREFIX_PATH": prefixes},
            )

    @property
    def said(self):
        return self._output.read_text()

    @property
    def started(self):
        """Numbers of the processes that the launch started."""
        return [int(n) for n in re.findall(r"process started with pid \[(\d+)\]", self.said)]

    def heats(self):
        wait_until(lambda: self.process.poll() is not None or not all_open(self.trace), 120)
        assert self.process.poll() is None, self.said
        time.sleep(0.3)

    def close(self):
        for number in (self.process.pid, *self.started):
            if runs(number):
                os.kill(number, signal.SIGKILL)
        self.process.wait()


def runs(number):
    """Whether a process runs, and is no zombie."""
    try:
        with open(f"/proc/{number}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def arguments_of(number):
    """The program of a process and its arguments."""
    with open(f"/proc/{number}/cmdline") as file:
        return file.read().split("\0")


@pytest.fixture
def launched(tmp_path):
    begun = []

    def launch(*arguments, **options):
        begun.append(Launch(tmp_path, *arguments, **options))
        return begun[-1]

    yield launch
    for one in begun:
        one.close()


@pytest.mark.parametrize("composed", ["true", "false"])
def test_a_launch_plays_records_and_ends_with_status_0(launched, tmp_path, composed):
    launch = launched(SHORT, f"composed:={composed}")
    assert launch.process.wait(240) == 0, launch.said
    assert "played to the end" in launch.said and len(edges_in(launch.trace)) == 4
    assert "did not report" not in launch.said and "Traceback" not in launch.said
    assert "cannot open" not in launch.said, "what is not there yet is waited for"
    assert len(list(tmp_path.glob("run-*/log.mcap"))) == 1


def test_a_schedule_that_was_not_played_is_the_launchs_exit_status(launched):
    launch = launched(SHORT | {"cycles": 2})
    assert launch.process.wait(240) == 1
    assert "it was edited after eldir gait" in launch.said
    assert "the schedule was not played to its end" in launch.said and edges_in(launch.trace) == []


@pytest.mark.parametrize("composed", ["true", "false"])
def test_ctrl_c_in_mid_heating_ends_the_launch_with_everything_off(launched, composed):
    launch, held_up = launched(LONG, f"composed:={composed}"), stalls()
    launch.heats()
    asked = time.monotonic()
    os.killpg(launch.process.pid, signal.SIGINT)
    wait_until(lambda: all_open(launch.trace), 10)
    off = edges_in(launch.trace)[-1][0] - asked
    print(f"Ctrl-C at the launch, composed {composed}: off {off:.3f} s later")
    assert off < 1.0 + held_up.worst
    assert launch.process.wait(60) == 0, launch.said
    assert "did not report" not in launch.said and "Caught exception" not in launch.said
    assert not any(runs(n) for n in launch.started)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_nothing_outlives_the_launch(launched, tmp_path, number):
    """Nor does a viewer, for which a package stands in whose program only waits."""
    viewer = tmp_path / "prefix" / "lib" / "rviz2" / "rviz2"
    index = tmp_path / "prefix" / "share" / "ament_index" / "resource_index" / "packages" / "rviz2"
    for file in (viewer, index):
        file.parent.mkdir(parents=True)
        file.write_text("#!/bin/sh\nexec sleep 600\n")
    viewer.chmod(0o755)
    launch, held_up = launched(LONG, "view:=rviz", prefix=tmp_path / "prefix"), stalls()
    launch.heats()
    assert "sleep" in [arguments_of(n)[0] for n in launch.started], "the viewer has not started"
    asked = time.monotonic()
    launch.process.send_signal(number)
    wait_until(lambda: all_open(launch.trace), 10)
    off = edges_in(launch.trace)[-1][0] - asked
    print(f"{number.name} to ros2 launch: off {off:.3f} s later")
    assert off < 1.0 + held_up.worst
    launch.process.wait(PATIENCE)
    wait_until(lambda: not any(runs(n) for n in launch.started), 30)


def test_a_damaged_argument_is_one_line(launched):
    launch = launched(SHORT, "composed:=perhaps")
    assert launch.process.wait(60) == 1 and "Traceback" not in launch.said
    assert "composed" in launch.said


def test_a_rig_in_a_namespace_and_one_process_plays_its_schedule(launched):
    launch = launched(SHORT, "composed:=true", "namespace:=left", "model:=true")
    assert launch.process.wait(240) == 0, launch.said
    assert "played to the end" in launch.said and len(edges_in(launch.trace)) == 4
    assert "left.relay_board" in launch.said and "Traceback" not in launch.said


def test_a_namespace_that_is_no_name_is_one_line(launched):
    launch = launched(SHORT, "namespace:=2 left")
    assert launch.process.wait(60) == 1 and "Traceback" not in launch.said
    assert "invalid launch argument namespace; expected letters" in launch.said
