"""A process that predicts the walk of a run over time: from the samples of the report, with its interval.

python -m eldir_app.watch.walk_prediction LOG

It prints one JSON line: rows of time since the start [s], mean, lower and upper end of the 95 % interval
[body lengths since the first cycle that counts]; or a string that says why nothing is predicted.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir_calibration.comparison.predictions import predict_walk
from eldir_calibration.comparison.recorded_run import MeasuredConditions, RecordedRun, read_run
from eldir_hardware.log.following import LogFollower
from eldir_hardware.log.reader import read_attachment, read_room
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule


def main() -> None:
    """Predict, and print the rows or the reason why there are none."""
    os.nice(15)  # the driving program comes first, then the markers
    try:
        rows = predict_walk(_read_run(Path(sys.argv[1])))
        print(json.dumps(rows.round(4).tolist()), flush=True)
    except EldirError as error:
        print(json.dumps(str(error).splitlines()[0]), flush=True)


def _read_run(path: Path) -> RecordedRun:
    """The run of a finished log with all that it measured, as the report reads it; of a log that is being
    written, with the air that was measured before the start."""
    with LogFollower(path) as log:
        if log.is_complete:
            return read_run(path).without_log()
        for _ in log.poll():
            if len(log.attachments) >= 3 and log.epoch_ns is not None:
                break
        design = read_attachment(log.attachments, path, "design.json", Design.from_json)
        schedule = read_attachment(log.attachments, path, "schedule.json", ActuationSchedule.from_json)
        rig = read_attachment(log.attachments, path, "rig.yaml", Rig.from_json)
        if design is None or schedule is None or rig is None:
            raise InputError(f"{path} has no design, schedule or rig file", code="log.not-attached")
        measured = MeasuredConditions(room_c=read_room(path, log.facts))
        return RecordedRun(design, schedule, rig, measured)


if __name__ == "__main__":
    main()
