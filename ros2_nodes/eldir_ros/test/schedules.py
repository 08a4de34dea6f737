# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Schedules for the example's robot. Nothing here needs ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from eldir.design import Design
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.compatibility import with_digests
from eldir_hardware.schedule import ActuationSchedule

CONFIG = Path(__file__).parents[1] / "config"


def schedule(pulse: float, period: float) -> dict[str, Any]:
    """One cycle with two channels of the first spring, at once, for the example's rig and design."""
    events = [
        {"t_s": t, "spring": 0, "face": face, "channel": channel, "on": on}
        for t, on in ((0.0, True), (pulse, False))
        for face, channel in (("back", 2), ("front", 1))
    ]
    values = {
        "format": "eldir-schedule/1",
        "period_s": period,
        "cycles": 1,
        "conditioning_cycles": 0,
        "settle_s": 0.2,
        "springs": [8, 30],
        "events": events,
        "predicted": {},
        "provenance": {},
    }
    rig, design = Rig.load(CONFIG / "rig.yaml"), Design.load(CONFIG / "design.json")
    return with_digests(ActuationSchedule.from_json(values), rig, design).to_json()


LONG = schedule(pulse=5.0, period=20.0)
"""Heats long enough to be interrupted."""
MIDDLE = schedule(pulse=3.0, period=14.0)
SLOW = schedule(pulse=3.0, period=50.0)
"""Lasts longer than its prediction takes to compute."""
SHORT = schedule(pulse=1.0, period=9.5)
"""Over soon."""
