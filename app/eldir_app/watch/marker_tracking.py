"""A process that tracks the mass markers in the pictures of a log, and measures how far the robot has walked.

python -m eldir_app.watch.marker_tracking LOG

It follows the log and prints JSON lines: a list of time [s], walk [body lengths] or null, and the position of
each marker in the picture [px] or null; a string that says why the markers cannot be tracked; or, once, an
object with the line of the printed ground: its corners [px] and its colour.
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
from eldir_hardware.camera.lens import Lens, require_not_expired
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.images import jpeg
from eldir_hardware.images.video import GROUND_COLOUR
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower, LogMessage
from eldir_hardware.log.reader import read_attachment
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule
from eldir_hardware.vision.pipeline import LiveTracker
from eldir_hardware.vision.printed_ground import predict_ground
from eldir_hardware.vision.recording_setup import CALIBRATION_FRAMES, marker_layout, read_marker_kind
from eldir_hardware.vision.sources import log_time

_POLL_INTERVAL_S = 0.05
_MAX_DELAY_S = 2.0  # of older pictures only some are tracked
_CATCH_UP_INTERVAL_S = 0.5  # between those


class WalkMeter:
    """Measures how far the markers have moved since the first cycle that counts."""

    def __init__(self, start: float, body_length: float):
        self._start, self._body_length = start, body_length
        self._origin: FloatArray | None = None

    def update(self, t: float, positions: FloatArray) -> float | None:
        """Mean displacement of the markers [body lengths], each from where it was first tracked; None
        before."""
        x = positions[:, 0]
        if t < self._start:
            return None
        if self._origin is None:
            self._origin = x.copy()
        unknown = np.isnan(self._origin)
        self._origin[unknown] = x[unknown]
        displacement = x - self._origin
        if np.isnan(displacement).all():
            return None
        return round(float(np.nanmean(displacement)) / self._body_length, 3)


class _LogTracker:
    """Tracks the markers of one log, once its first attachments have been read."""

    def __init__(self, log: LogFollower):
        self._log = log
        self._tracker: LiveTracker | None = None
        self._walk: WalkMeter | None = None
        self._notes_printed = 0
        self._has_printed_ground = False

    def update(self, picture: LogMessage) -> list[list[Any]]:
        """Rows to print. Raises `EldirError` if the plane of motion is unknown."""
        if self._tracker is None:
            self._set_up()
        assert self._tracker is not None and self._log.epoch_ns is not None
        rows: list[list[Any]] = []
        tracks = self._tracker.update(picture.stamp_ns, jpeg.decode(picture.message.data))
        for stamp, positions, _ in tracks:
            plane = self._tracker.plane
            assert plane is not None
            t = (stamp - self._log.epoch_ns) * 1e-9
            pixels = plane.to_pixels(positions)
            places = [p.round(1).tolist() if np.isfinite(p).all() else None for p in pixels]
            walk = None if self._walk is None else self._walk.update(t, positions)
            rows.append([round(t, 3), walk, *places])
        return rows

    def _set_up(self) -> None:
        files, path = self._log.attachments, self._log.path
        tags = read_attachment(files, path, "tags.json", TagBoard.from_json)
        plane = read_attachment(files, path, "plane.json", Plane.from_json)
        design = read_attachment(files, path, "design.json", Design.from_json)
        schedule = read_attachment(files, path, "schedule.json", ActuationSchedule.from_json)
        if tags is None and plane is None:
            raise EldirError(
                "the log has no plane of motion and no reference tags: its markers are not tracked"
            )
        layout = None if design is None else marker_layout(design)
        rig = read_attachment(files, path, "rig.yaml", Rig.from_json)
        ground = None if design is None else predict_ground(design, rig)
        kind = read_marker_kind(files, path)
        self._tracker = LiveTracker(tags, plane, layout, kind, ground, self._read_lens())
        self._tracker.reset(self._log.epoch_ns)
        if design is not None and schedule is not None:
            from eldir.built.robot import build

            self._walk = WalkMeter(schedule.start_of_cycles, build(design.morphology).body_length)

    def _read_lens(self) -> Lens | None:
        """The lens file that the log keeps; None without. Raises `InputError` if it has expired."""
        lens = read_attachment(self._log.attachments, self._log.path, "camera.json", Lens.from_json)
        if lens is not None and self._log.epoch_ns is not None:
            name = f"camera.json in {self._log.path}"
            require_not_expired(lens.provenance, log_time(self._log.epoch_ns), name)
        return lens

    def new_notes(self) -> list[str]:
        """Notes of the tracker since the last call."""
        notes = [] if self._tracker is None else self._tracker.notes
        new, self._notes_printed = notes[self._notes_printed :], len(notes)
        return new

    def new_ground(self) -> list[dict[str, Any]]:
        """The line of the ground in the picture, once it is known."""
        tracker = self._tracker
        if self._has_printed_ground or tracker is None or tracker.ground is None or tracker.plane is None:
            return []
        self._has_printed_ground = True
        pixels = tracker.plane.to_pixels(tracker.ground).round(1).tolist()
        blue, green, red = GROUND_COLOUR
        return [{"corners": pixels, "colour": f"rgb({red} {green} {blue})"}]


def main() -> None:
    """Follow the log until it ends, or until the parent process has ended."""
    os.nice(10)  # the driving program comes first
    parent, last_error = os.getppid(), ""
    with LogFollower(sys.argv[1], {m.IMAGE}) as log:
        tracker = _LogTracker(log)
        for picture in _select_pictures(log, is_replay=log.is_complete):
            try:
                rows: list[Any] = [*tracker.update(picture), *tracker.new_notes(), *tracker.new_ground()]
            except EldirError as error:
                rows = [] if str(error) == last_error else [str(error)]
                last_error = str(error)
            for row in rows:
                print(json.dumps(row), flush=True)
            if os.getppid() != parent:
                return


def _select_pictures(log: LogFollower, is_replay: bool) -> Iterator[LogMessage]:
    """Pictures as they are recorded; only some of old ones, to catch up with the present."""
    parent, number, latest = os.getppid(), 0, 0.0
    while os.getppid() == parent and not log.is_finished:
        for picture in log.poll():
            t = picture.stamp_ns * 1e-9
            is_late = not is_replay and time.time() - t > _MAX_DELAY_S
            if log.epoch_ns and (
                number < CALIBRATION_FRAMES or not is_late or t - latest >= _CATCH_UP_INTERVAL_S
            ):
                number, latest = number + 1, t
                yield picture
        time.sleep(_POLL_INTERVAL_S)


if __name__ == "__main__":
    main()
