"""What the page shows of one run: curves, contacts, events and the plan, as rows that are only appended."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from eldir.errors import InputError
from eldir_hardware.log import messages as m
from eldir_hardware.log.following import LogFollower, LogMessage, MessagePlace
from eldir_hardware.log.reader import is_dry_run, read_attachment
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.schedule import ActuationSchedule

MAX_ROWS = 20_000
"""Rows of a curve; beyond it every second row of the older half is dropped."""
_RATE_WINDOW_S = 3.0  # over which the frame rate of the camera is measured
# Status of eldir_hardware.run.player.
_RESUMED = re.compile(r"resumed: cycle (\d+) begins again at ([\d.]+) s")
_LEVEL_OK = 0  # of diagnostic_msgs


@dataclass
class Curve:
    """Rows [t, value, ...] in the order of time."""

    rows: list[list[Any]] = field(default_factory=list)
    thinned: int = 0
    """How often rows were dropped: a page must then read the curve again from the start."""

    def add(self, row: list[Any]) -> None:
        self.rows.append(row)
        if len(self.rows) > MAX_ROWS:
            half = MAX_ROWS // 2
            self.rows[:half] = self.rows[:half:2]
            self.thinned += 1


class PagePosition(NamedTuple):
    """How much of a view a page has received."""

    thinned: int = -1
    counts: Mapping[str, int] = {}


class RunView:
    """Collects the messages of a log, and gives each page what is new to it."""

    def __init__(self, path: Path):
        self.path = path
        self.curves = {
            name: Curve() for name in ("temperatures", "currents", "contacts", "events", "begins", "marks")
        }
        self.plan: dict[str, Any] = {}
        self.latest = 0.0
        """Time of the newest message [s since the start]."""
        self.pictures: list[tuple[float, MessagePlace]] = []
        self.picture: tuple[float, bytes] | None = None
        """The newest picture: time [s] and JPEG."""
        self.ground: dict[str, Any] | None = None
        """The line of the printed ground in the pictures: corners [px] and colour."""
        self.prediction: str | list[list[float]] | None = None
        """Predicted walk: rows of time [s], mean, lower and upper end of the 95 % interval [body lengths];
        `computing`, or why there is none; None without a design."""
        self.tracked_share: float | None = None
        """Share of the pictures in which markers have been searched; None when all have."""
        self.paused = False
        self._row: dict[str, float] = {}
        self._row_t = 0.0
        self._springs: list[str] = []
        self._files_read = 0

    def read_files(self, log: LogFollower) -> bool:
        """Read the plan from the attachments of the log; return whether it has changed.

        A damaged file becomes an event, and the curves go on.
        """
        files = log.attachments
        if len(files) == self._files_read:
            return False
        self._files_read = len(files)
        try:
            rig = read_attachment(files, self.path, "rig.yaml", Rig.from_json)
            schedule = read_attachment(files, self.path, "schedule.json", ActuationSchedule.from_json)
        except InputError as error:
            self.curves["events"].add([self.latest, 0, "files", str(error)])
            return True
        if rig is not None:
            self._springs = list(rig.spring_names)
        self.plan = {
            "rehearsal": is_dry_run(log.facts, log.epoch_ns, files.get("rig.yaml", b"")),
            "rig": None if rig is None else _rig_values(rig),
            "schedule": None if schedule is None else _schedule_values(schedule),
        }
        return True

    def update(self, logged: LogMessage, log: LogFollower) -> None:
        """Take one message of the log; messages before the start of the run are ignored."""
        self.read_files(log)
        if log.epoch_ns is None:
            return
        t = round((logged.stamp_ns - log.epoch_ns) * 1e-9, 3)
        self.latest = max(self.latest, t)
        message, topic = logged.message, logged.topic
        if topic == m.IMAGE:
            self.pictures.append((t, logged.place))
            self.picture = (t, message.data.tobytes())
        elif topic == m.RELAYS:
            closed = [int(value > 0.5) for value in m.read_values(message).values()]
            contacts = self.curves["contacts"]
            if not contacts.rows or contacts.rows[-1][1:] != closed:
                contacts.add([t, *closed])
        elif topic == m.CURRENTS:
            self.curves["currents"].add(
                [t, *(_number(value, 3) for value in m.read_values(message).values())]
            )
        elif topic == m.STATUS:
            for status in message.status:
                self._add_event(t, status)
        elif topic.startswith("/springs/"):
            self._add_temperature(t, topic.split("/")[2], message.temperature)

    def news(self, position: PagePosition) -> tuple[dict[str, Any], PagePosition]:
        """The rows that a page has not received, and its new position. A new page gets everything."""
        thinned = sum(c.thinned for c in self.curves.values())
        counts = position.counts if position.thinned == thinned else {}
        rows = {n: c.rows[counts.get(n, 0) :] for n, c in self.curves.items()}
        news: dict[str, Any] = {n: r for n, r in rows.items() if r}
        if not counts:
            news["anew"] = True
        return news, PagePosition(thinned, {n: len(c.rows) for n, c in self.curves.items()})

    @property
    def camera_rate(self) -> float | None:
        """Pictures a second over the last seconds; None without a camera."""
        if not self.pictures:
            return None
        recent = [t for t, _ in self.pictures[-200:] if t > self.latest - _RATE_WINDOW_S]
        return round(len(recent) / min(_RATE_WINDOW_S, max(self.latest, 0.1)), 1)

    def _add_temperature(self, t: float, spring: str, celsius: float) -> None:
        """One row has the temperatures of all springs at one time."""
        if t != self._row_t:
            self._add_row()
            self._row_t = t
        self._row[spring] = celsius
        if len(self._row) == len(self._springs):
            self._add_row()

    def _add_row(self) -> None:
        row, self._row = self._row, {}
        if row:
            self._springs = self._springs or list(row)
            values = (_number(row.get(s, math.nan), 1) for s in self._springs)
            self.curves["temperatures"].add([self._row_t, *values])

    def _add_event(self, t: float, status: Any) -> None:
        ok, text = status.level == _LEVEL_OK, status.message
        if ok and status.name == "files":  # digests
            return
        if status.name == "player":
            self.paused = text.startswith("paused")
            if match := _RESUMED.match(text):
                self.curves["begins"].add([t, int(match[1]) - 1, float(match[2])])
        self.curves["events"].add([t, int(ok), status.name, text])


def _number(value: float, digits: int) -> float | None:
    """A rounded number; None for NaN and infinity, which JSON does not have."""
    return round(float(value), digits) if math.isfinite(value) else None


def _rig_values(rig: Rig) -> dict[str, Any]:
    return {
        "name": rig.name,
        "virtual": rig.kind == "virtual",
        "max_temperature_c": rig.limits.max_temperature_c,
        "ambient_c": rig.springs.ambient_c,
        "sensor": rig.sensor is not None,
        "channels": [{"channel": c.channel, "spring": c.spring, "face": c.face} for c in rig.channels],
    }


def _schedule_values(schedule: ActuationSchedule) -> dict[str, Any]:
    return {
        "period_s": schedule.period_s,
        "cycles": schedule.cycles,
        "conditioning_cycles": schedule.conditioning_cycles,
        "settle_s": schedule.settle_s,
        "pulses": [[p.channel, p.start, p.length] for p in schedule.pulses()],
        "peak_c": schedule.predicted.peak_c,
    }
