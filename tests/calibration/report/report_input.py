"""What a report is made of, with changes, and the schema of its numbers."""

import json

import numpy as np

from eldir_calibration.report.page import HeatingRecord, ReportInput
from tests.calibration.report.striding_walkers import walker
from tests.paths import SCHEMAS

SCHEMA = json.loads((SCHEMAS / "report.schema.json").read_text())
t = np.arange(0, 120, 0.5)
HEATING = HeatingRecord(
    t,
    np.stack([(t % 20) < 5, (t % 20) > 15], axis=1),
    ("channel1", "channel2"),
    t,
    np.stack([40 + 20 * np.sin(t), 40 + 20 * np.cos(t)], axis=1),
    ("spring0_front", "spring1_front"),
    90.0,
)


def content(**changes) -> ReportInput:
    values = {
        "title": "A <walker>",
        "simulated": walker(speed=0.02, scale=0.1),
        "predicted": walker(lift=0.0033),
        "tracked": walker(noise=1e-5),
        "heating": HEATING,
        "remarks": ("The ground was wet.",),
        "provenance": {"log": "log.mcap"},
    }
    return ReportInput(**(values | changes))
