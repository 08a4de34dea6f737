"""Recorded contact edges of five designs through the independent thermal model, in all corners."""

import numpy as np
import pytest

from eldir_hardware.schedule import ActuationSchedule
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.safety.replayed_heat import (
    CORNERS,
    HOTTEST,
    NOMINAL,
    distinct,
    peak,
    recorded_pulses,
    stopped_fan,
    welded,
    wire,
)
from tests.paths import DATA

pytestmark = pytest.mark.stress
BOARDS = ({"kind": "lcus"}, {"kind": "modbus", "retriggerable": True})


@pytest.mark.parametrize("board", BOARDS, ids=lambda b: b["kind"])
def test_no_corner_of_the_tolerances_passes_the_ceiling(board):
    """16 corners, a contact that welds, and the interlocked fan stopped at 20 instants; prints a table."""
    rng = np.random.default_rng(7)
    print("\n| gait | nominal | corners | contact welded | fan stops, interlock cuts |")
    rig = rig_with(board=board)
    for file in sorted((DATA / "gaits").glob("*.json")):
        schedule = ActuationSchedule.load(file)
        pulses = recorded_pulses(schedule, rig)
        nominal = peak(pulses, wire(rig, NOMINAL))
        corners = {corner: peak(pulses, wire(rig, corner)) for corner in CORNERS}
        stuck = max(peak(welded(pulses, rig), wire(rig, corner)) for corner in CORNERS)
        own = next(distinct(pulses))
        heated = [a + part * (b - a) for a, b in own[-2:] for part in rng.uniform(0.2, 1.0, 10)]
        calm = max(stopped_fan(own, rig, HOTTEST, at) for at in heated)
        print(
            f"| {schedule.period_s:g} s / {own[0][1] - own[0][0]:.2f} s on | {nominal:.1f} | "
            f"{min(corners.values()):.1f} to {max(corners.values()):.1f} | {stuck:.1f} | {calm:.1f} |"
        )
        assert max(corners, key=corners.get) == HOTTEST
        assert max(*corners.values(), stuck, calm) <= 90.0
