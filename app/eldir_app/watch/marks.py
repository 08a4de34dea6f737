"""A process of its own that finds the marks in the pictures of a log, and how far the robot has walked.

python -m eldir_app.watch.marks LOG

It follows the log, and prints one JSON list a line: time [s], walk [body lengths] or null, and where each
mark is in the picture [px] or null; or a text that says why it cannot.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import EldirError
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.images import jpeg
from eldir_hardware.log import messages as m
from eldir_hardware.log.attachments import read_attachment
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.live_tracking import LiveTracker
from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES, layout_of, marker_of

_POLL = 0.05
_BEHIND = 2.0  # pictures that are older are of the past [s]
_STEP = 0.5  # between those of the past that are looked at [s]


class Walk:
    """How far the marks have moved since the cycles that count began."""

    def __init__(self, start: float, body_length: float):
        self._start, self._body_length = start, body_length
        self._from: FloatArray | None = None

    def at(self, t: float, positions: FloatArray) -> float | None:
        """Mean motion of the marks [body lengths], each from where it was first seen; None before."""
        x = positions[:, 0]
        if t < self._start:
            return None
        if self._from is None:
            self._from = x.copy()
        fresh = np.isnan(self._from)
        self._from[fresh] = x[fresh]
        moved = x - self._from
        return None if np.isnan(moved).all() else round(float(np.nanmean(moved)) / self._body_length, 3)


class _Marks:
    """Marks of one log; what is needed for it comes with the log's first files."""

    def __init__(self, log: LogFollower):
        self._log = log
        self._tracker: LiveTracker | None = None
        self._walk: Walk | None = None
        self._noted = 0

    def find(self, picture: LogMessage) -> list[list[Any]]:
        """Rows to print. Raises `EldirError` where the pictures do not show the plane."""
        if self._tracker is None:
            self._set_up()
        assert self._tracker is not None and self._log.epoch_ns is not None
        rows: list[list[Any]] = []
        found = self._tracker.update(picture.stamp_ns, jpeg.decode(picture.message.data))
        for stamp, positions, _ in found:
            plane = self._tracker.plane
            assert plane is not None
            t = (stamp - self._log.epoch_ns) * 1e-9
            pixels = plane.to_pixels(positions)
            places = [p if np.isfinite(p).all() else None for p in pixels]
            walk = None if self._walk is None else self._walk.at(t, positions)
            rows.append([round(t, 3), walk, *(None if p is None else p.round(1).tolist() for p in places)])
        return rows

    def _set_up(self) -> None:
        files, path = self._log.attachments, self._log.path
        tags = read_attachment(files, path, "tags.json", TagBoard.from_json)
        plane = read_attachment(files, path, "plane.json", Plane.from_json)
        design = read_attachment(files, path, "design.json", Design.from_json)
        schedule = read_attachment(files, path, "schedule.json", ActuationSchedule.from_json)
        if tags is None and plane is None:
            raise EldirError("the log does not say where the plane of motion is: no marks are looked for")
        layout = None if design is None else layout_of(design)
        self._tracker = LiveTracker(tags, plane, layout, marker_of(files, path))
        self._tracker.reset(self._log.epoch_ns)
        if design is not None and schedule is not None:
            from eldir.built.robot import build

            self._walk = Walk(schedule.start_of_cycles, build(design.morphology).body_length)

    def notes(self) -> list[str]:
        """Notes of the tracker that were not printed yet."""
        notes = [] if self._tracker is None else self._tracker.notes
        new, self._noted = notes[self._noted :], len(notes)
        return new


def main() -> None:
    """Follow the log until it ends, or until the program that started this one has gone."""
    os.nice(10)  # whatever else this computer does comes first
    parent, said = os.getppid(), ""
    with LogFollower(sys.argv[1], {m.IMAGE}) as log:
        marks, replay = _Marks(log), log.is_whole
        for picture in _chosen(log, replay):
            try:
                rows: list[Any] = [*marks.find(picture), *marks.notes()]
            except EldirError as error:
                rows = [] if str(error) == said else [str(error)]
                said = str(error)
            for row in rows:
                print(json.dumps(row), flush=True)
            if os.getppid() != parent:
                return


def _chosen(log: LogFollower, replay: bool) -> Iterator[LogMessage]:
    """Pictures as they come. While it is behind, only some, so that it comes to the present."""
    parent, number, latest = os.getppid(), 0, 0.0
    while os.getppid() == parent and not log.ended:
        for picture in log.poll():
            t = picture.stamp_ns * 1e-9
            behind = not replay and time.time() - t > _BEHIND
            if log.epoch_ns and (number < CALIBRATION_FRAMES or not behind or t - latest >= _STEP):
                number, latest = number + 1, t
                yield picture
        time.sleep(_POLL)


if __name__ == "__main__":
    main()
