"""Reads the log of a run: relays, temperatures, currents, tracks, frames, attached files."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from eldir.core.files import parse_json
from eldir.core.records import BoolArray, FloatArray
from eldir.core.yaml_files import parse_yaml
from eldir.errors import EldirError, InputError, damaged
from eldir.trajectory import Trajectory
from eldir_hardware.images import jpeg
from eldir_hardware.log import messages as m
from eldir_hardware.log.mcap_file import find_log, iter_messages, read_contents

_AHEAD = 8  # pictures decoded before they are asked for
_File = TypeVar("_File")
_Messages = list[tuple[int, Any]]  # stamps [ns] and messages of a topic
_Rows = dict[str, _Messages]  # by topic


@dataclass(frozen=True)
class RunLog:
    """The contents of a log; times are seconds from the run's start."""

    path: Path
    tracks: Trajectory | None
    """Markers as tracked during the run; None if they were not tracked."""
    channels: tuple[str, ...]
    """Names of the relay contacts, length C."""
    relay_times: FloatArray
    """Times of the relay states [s], shape (N,)."""
    relays: BoolArray
    """Whether each contact was closed, shape (N, C)."""
    springs: tuple[str, ...]
    """Names of the springs whose temperatures were recorded, length A."""
    temperature_times: FloatArray
    """Times of the temperatures [s], shape (K,)."""
    temperatures: FloatArray
    """Modelled temperature of each spring [C], shape (K, A)."""
    statuses: tuple[tuple[float, str, str], ...]
    """Time [s], part of the rig, message."""
    attachments: dict[str, bytes]
    """Files kept with the log, by name."""
    frame_count: int
    epoch_ns: int
    """Time of day at the start [ns since 1970]."""
    recovered: str | None
    """What `eldir recover` reported as missing; None for a log that was never damaged."""
    is_dry_run: bool = False
    """Whether it is a rehearsal on an emulated board (`is_dry_run`)."""
    room_c: float | None = None
    """Temperature of the air around the springs, measured before the run [C]; None if it was not."""
    current_times: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Times of the measured currents and voltages [s], shape (L,)."""
    currents: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Measured current of each of `springs` [A], shape (L, A); NaN where it is not measured, no columns
    without a current sensor."""
    voltages: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    """Measured voltage across each spring [V], shape (L, A)."""

    @property
    def frames(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Time [s] and BGR picture of every frame, decoded a few ahead by another thread."""
        ahead: deque[tuple[float, Future[NDArray[np.uint8]]]] = deque()
        with ThreadPoolExecutor(1) as decoder:
            for stamp, data in self.pictures:
                ahead.append((self._seconds(stamp), decoder.submit(jpeg.decode, data)))
                if len(ahead) > _AHEAD:
                    t, image = ahead.popleft()
                    yield t, image.result()
            for t, image in ahead:
                yield t, image.result()

    def frame_from(self, t: float) -> NDArray[np.uint8] | None:
        """The first picture that is not older than `t` [s]."""
        data = next((data for stamp, data in self.pictures if self._seconds(stamp) >= t), None)
        return None if data is None else jpeg.decode(data)

    def _seconds(self, stamp: int) -> float:
        return (stamp - self.epoch_ns) * 1e-9

    @property
    def pictures(self) -> Iterator[tuple[int, NDArray[np.uint8]]]:
        """Time of day [ns] and JPEG bytes of every frame, as recorded."""
        for _, stamp, message in iter_messages(self.path, [m.IMAGE]):
            yield stamp, message.data


def read_log(path: Path | str) -> RunLog:
    """Read all of a log except its frames; `RunLog.frames` reads those later.

    `path` is a file, or the folder of a bag. Raises `InputError` for one that is missing, empty,
    damaged, cut off, or no log of a robot.
    """
    path = find_log(Path(path))
    contents = read_contents(path)
    epoch, topics = contents.epoch_ns, contents.topics
    rows: _Rows = {topic: [] for topic in topics}
    for topic, stamp, message in iter_messages(path, [t for t in topics if t != m.IMAGE]):
        rows[topic].append((stamp, message))
    springs = tuple(t.split("/")[2] for t in topics if t.startswith("/springs/"))
    currents = rows.get(m.CURRENTS, [])
    return RunLog(
        path=path,
        tracks=_tracks(path, [message for _, message in rows.get(m.MARKERS, [])], epoch),
        **_relays(rows.get(m.RELAYS, []), epoch),
        springs=springs,
        **_temperatures([rows[m.spring_topic(s)] for s in springs], epoch),
        statuses=_statuses(rows.get(m.STATUS, []), epoch),
        attachments=contents.attachments,
        frame_count=topics.get(m.IMAGE, 0),
        epoch_ns=epoch,
        recovered=contents.metadata.get("recovered"),
        is_dry_run=is_dry_run(contents.metadata, epoch, contents.attachments.get("rig.yaml", b"")),
        room_c=read_room(path, contents.metadata),
        current_times=_times(currents, epoch),
        currents=_values(currents, springs),
        voltages=_values(rows.get(m.VOLTAGES, []), springs),
    )


def is_dry_run(metadata: Mapping[str, str], epoch_ns: int | None, rig: bytes) -> bool:
    """Whether a log is that of a rehearsal on an emulated board: by its metadata, or, as older logs do not
    say it there, by the rig file of a real board in virtual time."""
    if m.DRY_RUN in metadata:
        return True
    with suppress(EldirError, LookupError, TypeError):
        return epoch_ns == m.VIRTUAL_EPOCH and parse_yaml(rig, "rig.yaml")["kind"] == "real"
    return False


def read_room(path: Path, facts: Mapping[str, str]) -> float | None:
    """The temperature of the room [C] among the facts of a log; None if it was not measured. Raises
    `InputError` for one that is no number."""
    text = facts.get(m.ROOM)
    try:
        room = None if text is None else float(text)
    except ValueError:
        room = math.nan
    if room is not None and not math.isfinite(room):
        raise damaged(path, "a temperature of the room", found=str(text))
    return room


def _times(messages: _Messages, epoch: int) -> FloatArray:
    return (np.array([stamp for stamp, _ in messages], np.int64) - epoch) * 1e-9


def _relays(messages: _Messages, epoch: int) -> dict[str, Any]:
    rows = [m.read_values(message) for _, message in messages]
    channels = tuple(rows[0]) if rows else ()
    values = np.array([[row[name] for name in channels] for row in rows], float)
    states = values.reshape(len(messages), len(channels)) > 0.5
    return {"channels": channels, "relay_times": _times(messages, epoch), "relays": states}


def _temperatures(springs: list[_Messages], epoch: int) -> dict[str, Any]:
    times = _times(springs[0] if springs else [], epoch)
    celsius = np.array([[message.temperature for _, message in own] for own in springs], float)
    return {"temperature_times": times, "temperatures": celsius.reshape(len(springs), len(times)).T}


def _statuses(messages: _Messages, epoch: int) -> tuple[tuple[float, str, str], ...]:
    return tuple(
        ((stamp - epoch) * 1e-9, status.name, status.message)
        for stamp, message in messages
        for status in message.status
    )


def _values(rows: _Messages, names: tuple[str, ...]) -> FloatArray:
    """One row for each message, in the order of `names`; NaN for a name that it does not have."""
    if not rows:
        return np.zeros((0, 0))
    table = [m.read_values(message) for _, message in rows]
    return np.array([[row.get(name, np.nan) for name in names] for row in table], float)


def _tracks(path: Path, arrays: list[Any], epoch: int) -> Trajectory | None:
    """The trajectory in a run's marker arrays; a deleted marker was not detected."""
    if not arrays:
        return None
    names = tuple(marker.ns for marker in arrays[0].markers)
    stamps = [a.markers[0].header.stamp for a in arrays]
    times = np.array([s.sec * 1_000_000_000 + s.nanosec - epoch for s in stamps], np.int64) * 1e-9
    if (np.diff(times) < 0).any():
        raise damaged(path, "markers in the order of time")
    places = [
        [(k.pose.position.x, k.pose.position.z) if k.action == k.ADD else (np.nan, np.nan) for k in a.markers]
        for a in arrays
    ]
    return Trajectory(names, times, np.array(places))


def read_attachment(
    attachments: Mapping[str, bytes], recording: Path | str, name: str, build: Callable[[Any], _File]
) -> _File | None:
    """Build an object from the attached JSON or YAML file of that name; None if there is none.

    Raises `InputError` for a damaged file.
    """
    if name not in attachments:
        return None
    data = attachments[name]
    try:
        return build(parse_json(data, name) if name.endswith(".json") else parse_yaml(data, name))
    except EldirError as error:
        raise InputError(
            f"{name} in {recording} is damaged", code=error.code, key=error.key, found=str(error)
        ) from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        found = f"{type(error).__name__}: {error}".splitlines()[0]
        raise damaged(f"{name} in {recording}", found=found) from None
