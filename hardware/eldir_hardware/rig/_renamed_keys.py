"""Entries of rig files with another name in 0.1.0: refused in a rig file, read in a log.

The digests of schedules use the names of 0.1.0, so that schedules of that version stay valid.
"""

from __future__ import annotations

import json
from typing import Any

from eldir.errors import InputError

RENAMED = {
    ("board", "second_flash"): "retriggerable",
    ("supply", "budget_a"): "max_total_current_a",
    ("tolerances", "coldest_c"): "ambient_min_c",
    ("tolerances", "hottest_c"): "ambient_max_c",
    ("tolerances", "air_stream"): "convection_tolerance",
    ("cutoff", "longest_on_s"): "max_on_s",
    ("limits", "ceiling_c"): "max_temperature_c",
    ("limits", "longest_on_s"): "max_on_s",
    ("limits", "least_off_s"): "min_off_s",
    ("virtual", "specimen"): "parameter_spread",
    ("virtual", "deviation"): "parameter_spread",
}
"""Section and old name of an entry, and its name now."""
_VALUES: dict[str, dict[str, Any]] = {
    "retriggerable": {"restarts": True, "ignored": False},
    "parameter_spread": {"near": "small", "far": "large"},
}
"""Old values of renamed entries, by the present name."""


def require_current_names(values: dict[str, Any], where: str) -> None:
    """Raise `InputError` for an entry by its old name."""
    for (section, old), new in RENAMED.items():
        if isinstance(entries := values.get(section), dict) and old in entries:
            value = json.dumps(_current_value(new, entries[old]), default=str)[:40]
            raise InputError(
                f"{where}: the entry {section}.{old} has another name now",
                code="rig.renamed-key",
                key=f"{section}.{old}",
                expected=f"{section}.{new}",
                remedy=f"rename it: {new}: {value}",
            )


def with_current_names(values: dict[str, Any]) -> dict[str, Any]:
    """The values of a rig of any version, by their present names."""
    present = dict(values)
    for (section, old), new in RENAMED.items():
        if isinstance(entries := present.get(section), dict) and old in entries:
            others = {name: value for name, value in entries.items() if name != old}
            present[section] = {**others, new: _current_value(new, entries[old])}
    return present


def _current_value(name: str, value: Any) -> Any:
    return _VALUES.get(name, {}).get(value, value) if isinstance(value, str) else value


def with_original_names(section: str, values: Any) -> Any:
    """A section's values by the names of 0.1.0."""
    if not isinstance(values, dict):
        return values
    first = {new: old for (of, old), new in reversed(RENAMED.items()) if of == section}
    return {first.get(name, name): value for name, value in values.items()}
