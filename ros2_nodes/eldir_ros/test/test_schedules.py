# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The graph's tests play schedules that the example's rig allows; checked also where there is no ROS."""

import json

import pytest
from schedules import CONFIG, LONG, MIDDLE, SHORT, SLOW

from eldir.design import Design
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety import limits
from eldir_hardware.safety.compatibility import require_compatible
from eldir_hardware.schedule import ActuationSchedule

EXAMPLE = json.loads((CONFIG / "schedule.json").read_text())


@pytest.mark.parametrize(
    "values", [LONG, MIDDLE, SLOW, SHORT, EXAMPLE], ids=["long", "middle", "slow", "short", "example"]
)
def test_the_examples_rig_allows_the_schedule(values):
    plan, rig = ActuationSchedule.from_json(values), Rig.load(CONFIG / "rig.yaml")
    limits.check_schedule(plan, rig)
    assert require_compatible(plan, rig, Design.load(CONFIG / "design.json")) is None
