"""Guardian, latch and disk, as the page shows them."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hardware.safety.latch import DIED, stop_of
from hardware.safety.state_folder import StateError
from hardware.watch.running import Driven, is_suspended


def rig_state(driven: Sequence[Driven], ports: Sequence[str], folder: Path | None) -> dict[str, Any]:
    """Plain values; `ports` are those whose latch counts, `folder` is where the log is."""
    return {
        "guardian": _guardian(driven),
        "player": _player(driven),
        "latch": _latch([*ports, *(d.port for d in driven)], bool(driven)),
        "free_mb": _free(folder),
    }


def _guardian(driven: Sequence[Driven]) -> list[Any]:
    """Whether all is well, and a text."""
    if not driven:
        return [None, "no port is driven"]
    hung = [d.port for d in driven if is_suspended(d.guardian)]
    if hung:
        return [False, f"suspended at {', '.join(hung)}"]
    return [True, f"holds {', '.join(d.port for d in driven)}"]


def _player(driven: Sequence[Driven]) -> list[Any]:
    if not driven:
        return [None, "does not run"]
    if any(is_suspended(d.player) for d in driven):
        return [False, "suspended"]
    return [True, "runs"]


def _latch(ports: Sequence[str], driven: bool) -> list[Any]:
    for port in dict.fromkeys(ports):  # a link too: it counts for stops of runs through it
        try:
            why = stop_of(port)
        except StateError as error:
            return [False, f"counts as stopped: {error}"]
        if why is not None and not (driven and why == DIED):
            return [False, f"stopped: {why}"]
    return [True if ports else None, "not latched" if ports else "no board"]


def _free(folder: Path | None) -> int | None:
    with suppress(OSError):
        return None if folder is None else shutil.disk_usage(folder).free // 1_000_000
    return None
