"""Logs and reports for the tests of the catalogue: real files, small."""

from __future__ import annotations

import json
import os
from pathlib import Path

from eldir_app.catalogue.runs import Catalogue, Index, find_runs
from eldir_hardware.log.mcap_file import fingerprint
from eldir_hardware.log.recorder import Recorder
from tests.hardware.log.log_contents import EPOCH, NAMES, POSITIONS, picture


def record(path: Path, said: str = "played to the end", good: bool = True, hours: int = 0) -> Path:
    """A log of a second, `hours` after the first one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with Recorder(path, channels=("a",), springs=("s4",), epoch_ns=EPOCH + hours * 3_600_000_000_000) as log:
        log.attach("note.txt", b"no file that the catalogue knows")
        for i in range(4):
            log.on_frame(0.1 * i, picture(i))
            log.on_tracks(0.1 * i, NAMES, POSITIONS)
        log.on_status(1.0, "player", said, good=good)
    return path


def report(log: Path, folder: Path, filmed: float, verdict: str = "agrees") -> Path:
    """The parts of a report about a log that the catalogue reads."""
    folder.mkdir(parents=True)
    run = {"log": log.name, "tracked": filmed, "tracked_interval": [filmed - 0.1, filmed + 0.1]}
    values = {
        "format": "eldir-report/1",
        "verdict": {
            "text": "in words",
            "body_lengths_per_5_cycles": {"predicted": 1.5, "agreement": verdict},
        },
        "runs": [run | {"predicted": 1.4, "fingerprint": fingerprint(log)}],
    }
    (folder / "report.json").write_text(json.dumps(values))
    return folder / "report.json"


def found(place: Path, index: Path) -> tuple[Catalogue, int]:
    """The catalogue of a folder or log, and how many files had to be read for it."""
    read = [0]

    def count(done: int, every: int) -> None:
        read[0] = every

    with Index(index) as kept:
        return find_runs([place], kept, count), read[0]


def later(path: Path, seconds: float) -> None:
    """Give a file another time of its last change."""
    when = path.stat().st_mtime + seconds
    os.utime(path, (when, when))
