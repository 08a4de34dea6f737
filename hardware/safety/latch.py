"""The latched emergency stop of a port: a file that outlives every program until it is reset."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from eldir.errors import EldirError
from hardware.rig.port_lock import port_file

_DIED = "the guardian that drove it died"


class LatchedError(EldirError):
    """Heating is refused until the stop is reset."""


def latch_file(port: str) -> Path:
    """Path of the latch file. It exists while the port is stopped or driven."""
    return port_file(port, "stop")


def require_unlatched(port: str) -> None:
    """Raise `LatchedError` if a stop has not been reset."""
    try:
        why = latch_file(port).read_text().strip()
    except FileNotFoundError:
        return
    except OSError as error:
        why = f"the latch cannot be read ({error.strerror})"
    raise LatchedError(
        f"{port} is stopped: {why or _DIED}", remedy="look at the rig, then: eldir rig reset --rig RIG"
    )


def latch_for_driving(port: str) -> None:
    """Latch before driving, so that a guardian that dies leaves a stop behind."""
    try:
        latch_file(port).write_text(_DIED + "\n")
    except OSError as error:
        raise EldirError(
            f"cannot write {latch_file(port)}: {error.strerror}",
            remedy="free disk space: the emergency stop needs it",
        ) from None


def latch(port: str, why: str) -> None:
    """Latch a stop. Never fails: on a full disk the text of `latch_for_driving` stays."""
    with suppress(OSError):
        latch_file(port).write_text(" ".join(why.split()) + "\n")


def unlatch(port: str) -> None:
    """Allow heating again."""
    latch_file(port).unlink(missing_ok=True)
