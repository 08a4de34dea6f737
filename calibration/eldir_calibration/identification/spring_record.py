"""Recordings of a heated spring (CSV), and rig files with the parameters found from them."""

from __future__ import annotations

import codecs
import csv
from pathlib import Path

import numpy as np

from eldir.core.arguments import PlausibleRange, Unit, length_quantity
from eldir.core.files import read_file, write_text
from eldir.core.records import BoolArray, FloatArray
from eldir.core.validation import validate
from eldir.core.yaml_files import parse_yaml, with_entries
from eldir.errors import InputError, damaged, empty
from eldir_calibration.springs.fit import SpringFit
from eldir_calibration.springs.recording import SpringRecording
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import THERMAL, calibration_entry

_COLUMNS = ("t_s", "current_a", "voltage_v", "temperature_c", "fan")
_OPTIONAL = ("length_mm", "ambient_c")
_TIMES = (Unit("milliseconds", 1e-3), Unit("minutes", 60.0), Unit("microseconds", 1e-6))
_DURATION = PlausibleRange("s", 20.0, 14_400.0, _TIMES)
_CURRENT = PlausibleRange("A", 0.05, 40.0, (Unit("milliamperes", 1e-3),))
_VOLTAGE = PlausibleRange("V", 0.05, 48.0, (Unit("millivolts", 1e-3),))
_LOW_TEMPERATURE = PlausibleRange(
    "C", -10.0, 45.0, (Unit("Fahrenheit", 1 / 1.8, -32 / 1.8), Unit("kelvin", 1.0, -273.15))
)
_LENGTH = length_quantity("mm", 5.0, 500.0)
_REMEDY = "the values found are not those of a spring that this program drives; check the table, record again"
_RIG_ENTRIES = {
    "resistance": ("resistance_ohm", 1.0),
    "ambient": ("ambient_c", 1.0),
    "convection_still": ("convection_still", 1.0),
    "convection_fan": ("convection_fan", 1.0),
    "heat_capacity": ("heat_capacity", 1.0),
    "latent_heat": ("latent_heat", 1.0),
    "austenite_start": ("austenite_start_c", 1.0),
    "austenite_finish": ("austenite_finish_c", 1.0),
    "martensite_start": ("martensite_start_c", 1.0),
    "martensite_finish": ("martensite_finish_c", 1.0),
    "cold_length": ("cold_length_mm", 1e3),
    "hot_length": ("hot_length_mm", 1e3),
}


def load_spring_recording(path: Path) -> SpringRecording:
    """Read a table as spreadsheets and loggers write it: commas, semicolons with decimal commas, or tabs;
    UTF-8 or UTF-16. Raises `InputError` that names a missing column, what is no number, or another unit."""
    data = read_file(path)
    if not data:
        raise empty(path, f"columns {', '.join(_COLUMNS)}")
    rows = _read_rows(path, data)
    found = tuple(rows[0]) if rows else ()
    missing = [c for c in _COLUMNS if c not in found]
    if missing:
        raise InputError(
            f"{path} is not a recording of a spring",
            code="spring.other-table",
            expected=f"columns {', '.join(_COLUMNS)}",
            found=", ".join(str(c) for c in found) or "nothing",
        )
    table = {name: _column(path, rows, name) for name in (*_COLUMNS, *_OPTIONAL) if name in found}
    fan, length = table["fan"], table.get("length_mm")
    wrong = np.flatnonzero((fan != 0) & (fan != 1))
    if len(wrong):
        raise _wrong_column(path, "fan", "0 or 1", f"{fan[wrong[0]]:g} in line {wrong[0] + 2}")
    recording = SpringRecording(
        table["t_s"],
        table["current_a"],
        table["voltage_v"],
        table["temperature_c"],
        fan == 1,
        None if length is None else 1e-3 * length,
        table.get("ambient_c"),
    )
    _require_units(path, table, recording.heated)
    return recording


def _read_rows(path: Path, data: bytes) -> list[dict[str, str]]:
    try:
        wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        lines = data.decode("utf-16" if wide else "utf-8-sig").splitlines()
        separator = max(",;\t", key=lines[0].count) if lines else ","
        if separator != ",":  # then the comma is the decimal one
            lines = [line.replace(",", ".") for line in lines]
        return list(csv.DictReader(lines, delimiter=separator))
    except UnicodeDecodeError:
        raise damaged(path, "a table (CSV)", "bytes that are no text") from None
    except csv.Error as error:
        raise damaged(path, "a table (CSV)", str(error)) from None


def _require_units(path: Path, table: dict[str, FloatArray], heated: BoolArray) -> None:
    """Raise `InputError` that names the column and the unit that it looks like. Medians and the lowest
    twentieth count, so that a few faults of a sensor do not."""
    numbers = {
        "t_s": (_DURATION, "the whole time", float(np.ptp(table["t_s"]))),
        "current_a": (_CURRENT, "the current while it heats", float(np.median(table["current_a"][heated]))),
        "voltage_v": (_VOLTAGE, "the voltage while it heats", float(np.median(table["voltage_v"][heated]))),
        "temperature_c": (_LOW_TEMPERATURE, "its lowest value", _low_percentile(table["temperature_c"])),
    }
    if "length_mm" in table:
        numbers["length_mm"] = (_LENGTH, "its lowest value", _low_percentile(table["length_mm"]))
    if "ambient_c" in table:
        numbers["ambient_c"] = (_LOW_TEMPERATURE, "its lowest value", _low_percentile(table["ambient_c"]))
    for column, (quantity, what, value) in numbers.items():
        quantity.require_plausible(f"{path}: column {column}: {what}", value, "convert the column")


def _low_percentile(values: FloatArray) -> float:
    return float(np.percentile(values, 5))


def _column(path: Path, rows: list[dict[str, str]], name: str) -> FloatArray:
    try:
        values = np.array([float(row[name]) for row in rows])
        bad = ~np.isfinite(values)
        if bad.any():
            raise ValueError(f"none in line {int(bad.argmax()) + 2}")
        return values
    except (TypeError, ValueError) as error:
        raise _wrong_column(path, name, "numbers", str(error)) from None


def _wrong_column(path: Path, name: str, expected: str, found: str) -> InputError:
    problem = f"{path}: invalid column {name}"
    return InputError(problem, code="spring.wrong-column", key=name, expected=expected, found=found)


def write_rig_with_springs(rig: Path, fit: SpringFit, out: Path) -> None:
    """Write a copy of the rig file with the parameters found in its section `springs`, once it is valid:
    raises `InputError` that names the value no rig can have, and writes nothing."""
    found = {
        entry: float(f"{scale * fit.estimates[name].value:.6g}")
        for name, (entry, scale) in _RIG_ENTRIES.items()
        if name in fit.estimates
    }
    calibration = calibration_entry({name: value for name, value in found.items() if name in THERMAL})
    text = with_entries(rig.read_text(), "springs", {**found, "calibration": calibration})
    validate(Rig, parse_yaml(text.encode(), str(out)), str(out), _REMEDY)
    write_text(out, text)
