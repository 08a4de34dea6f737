"""What the catalogue reads from a log, and from a report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TypeVar

from eldir.core.files import read_json
from eldir.errors import EldirError, InputError

_REAL_CLOCK = 946_684_800
"""A log that says it is from before the year 2000 was recorded in virtual time [s since 1970]."""
_File = TypeVar("_File")


@dataclass(frozen=True)
class LogFacts:
    """What a log says of itself; empty or None where it does not say."""

    fingerprint: str = ""
    """SHA-256 of the log's size and of its last 64 KiB; it tells logs apart."""
    recorded: str = ""
    """When the run began (ISO 8601, UTC); for a run in virtual time, the date of the file."""
    seconds: float = 0.0
    """Time from the start to the last message [s]."""
    frames: int = 0
    """Number of camera frames in the log."""
    rig: str = ""
    """Name of the rig."""
    physics: str = ""
    """What moved a virtual robot; `real` on a real rig."""
    design: str = ""
    """SHA-256 of the design file, hexadecimal."""
    robot: str = ""
    """`intact`, or how the robot differs from its design."""
    period_s: float | None = None
    """Period of the schedule [s]."""
    cycles: int | None = None
    """Cycles of the schedule that count."""
    predicted: float | None = None
    """Walk that the schedule predicts [body lengths per five cycles]."""
    ended: str = ""
    """What the player said last."""
    faults: tuple[str, ...] = ()
    """Errors and warnings in the log, as sentences."""
    recovered: str = ""
    """What `eldir recover` reported as missing."""
    damage: str = ""
    """Why the log, or a file in it, cannot be read."""


@dataclass(frozen=True)
class ReportedRun:
    """What a report says of one log."""

    predicted: float | None
    """Predicted walk [body lengths per five cycles]."""
    filmed: float | None
    """Filmed walk [body lengths per five cycles]."""
    low: float | None
    """Lower end of the filmed walk's 95 % interval over cycles [body lengths per five cycles]."""
    high: float | None
    """Upper end of that interval [body lengths per five cycles]."""
    verdict: Literal["agrees", "undecided", "disagrees", ""]
    """Whether film and prediction agree; empty for a control robot."""
    sentence: str
    """The verdict in words; empty for a control robot."""


def read_facts(log: Path) -> LogFacts:
    """What a log says of itself. A log that cannot be read has `damage` and nothing else; where only an
    attached file is damaged, the rest is there."""
    # A listing that finds everything in the index needs none of these.
    from eldir.design import Design
    from eldir_hardware.log import messages as m
    from eldir_hardware.log.attachments import read_attachment
    from eldir_hardware.log.fingerprint import fingerprint
    from eldir_hardware.log.reader import contents, messages
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.schedule import ActuationSchedule

    try:
        found = contents(log)
        statuses = [
            status
            for _, _, message in messages(log, [m.STATUS] if m.STATUS in found.topics else [])
            for status in message.status
        ]
        print_ = fingerprint(log)
        epoch = found.epoch_ns * 1e-9
        recorded = epoch if epoch > _REAL_CLOCK else log.stat().st_mtime
        date = datetime.fromtimestamp(recorded, UTC).isoformat(timespec="seconds")
    except InputError as error:
        return LogFacts(damage=str(error).splitlines()[0])
    except (OSError, ArithmeticError, LookupError, ValueError) as error:
        return LogFacts(damage=f"{log} is no sound log ({type(error).__name__}: {error})".splitlines()[0])

    damage: list[str] = []

    def attached(name: str, build: Callable[[Any], _File]) -> _File | None:
        try:
            return read_attachment(found.attachments, log.name, name, build)
        except InputError as error:
            damage.append(str(error).splitlines()[0])
            return None

    design = attached("design.json", Design.from_json)
    schedule = attached("schedule.json", ActuationSchedule.from_json)
    rig = attached("rig.yaml", Rig.from_json)
    walk = None if schedule is None else schedule.predicted.walk
    said = [s.message for s in statuses if s.name == "player"]
    moved = [s.message.removeprefix("moved by ") for s in statuses if s.name == "virtual rig"]
    return LogFacts(
        fingerprint=print_,
        recorded=date.replace("+00:00", "Z"),
        seconds=round(max(0.0, found.end_ns * 1e-9 - epoch), 3),
        frames=found.topics.get(m.IMAGE, 0),
        rig="" if rig is None else rig.name,
        physics="" if rig is None else "real" if rig.kind == "real" else moved[0] if moved else "virtual",
        design=found.note.get("design_sha256", ""),
        robot="" if design is None else _robot(design.variant.to_json()),
        period_s=None if schedule is None else schedule.period_s,
        cycles=None if schedule is None else schedule.cycles,
        predicted=None if walk is None else walk.mean,
        ended=said[-1] if said else "",
        faults=tuple(f"{s.name}: {s.message}" for s in statuses if s.level),
        recovered=found.note.get("recovered", ""),
        damage="; ".join(damage),
    )


def _robot(variant: dict[str, Any]) -> str:
    """The robot in words, by what its design file says under `variant`."""
    parts = []
    if "without_motor" in variant:
        parts.append(f"without motor {variant['without_motor']}")
    if "ballast" in variant:
        parts.append(f"{variant['ballast']['grams']:g} g on mass {variant['ballast']['mass']}")
    return ", ".join(parts) or "intact"


def read_report(path: Path) -> dict[str, dict[str, Any]]:
    """What a `report.json` says of its logs, by their fingerprints; nothing for any other file."""
    try:
        return _reported(read_json(path, "eldir-report/1", ("eldir-report/1",)))
    except (EldirError, AttributeError, LookupError, TypeError, ValueError):
        return {}  # another program's report.json


def _reported(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    found = {}
    for number, run in enumerate(values["runs"]):
        low, high = run["tracked_interval"] or (None, None)
        main = number == 0
        walk = values["verdict"]["body_lengths_per_5_cycles"]
        found[str(run.get("fingerprint", ""))] = asdict(
            ReportedRun(
                predicted=walk["predicted"] if main else run["predicted"],
                filmed=run["tracked"],
                low=low,
                high=high,
                verdict=(walk["agreement"] or "") if main else "",
                sentence=values["verdict"]["text"] if main else "",
            )
        )
    return found
