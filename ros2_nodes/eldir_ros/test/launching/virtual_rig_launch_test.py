# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""`launch_test virtual_rig_launch_test.py`: the launch file of the virtual rig plays a schedule and ends."""

import json
import tempfile
import unittest
from pathlib import Path

import launch_testing
from ament_index_python.packages import get_package_share_directory
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_testing.actions import ReadyToTest
from launch_testing.asserts import assertExitCodes

from eldir.design import Design
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule
from launch import LaunchDescription


def generate_test_description():
    folder, share = Path(tempfile.mkdtemp()), Path(get_package_share_directory("eldir_ros"))
    example = share / "config"
    short = json.loads((example / "schedule.json").read_text())
    short |= {"cycles": 1, "conditioning_cycles": 0, "settle_s": 0.5}
    rig, design = Rig.load(example / "rig.yaml"), Design.load(example / "design.json")
    with_digests(ActuationSchedule.from_json(short), rig, design).save(folder / "schedule.json")
    launch = share / "launch" / "virtual_rig.launch.py"
    rig = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(launch)),
        launch_arguments={"schedule": str(folder / "schedule.json"), "logs": str(folder)}.items(),
    )
    return LaunchDescription([rig, ReadyToTest()]), {"folder": folder}


class WhileItRuns(unittest.TestCase):
    def test_the_schedule_is_played_recorded_and_compared(self, proc_output, folder):
        proc_output.assertWaitFor("armed", timeout=60)
        proc_output.assertWaitFor("cycle 1: tracked", timeout=60)
        proc_output.assertWaitFor("played to the end", timeout=60)
        proc_output.assertWaitFor("wrote", timeout=10)
        self.assertEqual(len(list(folder.glob("run-*/log.mcap"))), 1)


@launch_testing.post_shutdown_test()
class AfterItEnded(unittest.TestCase):
    def test_every_node_ended_by_itself(self, proc_info):
        assertExitCodes(proc_info)
