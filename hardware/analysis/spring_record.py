"""Recordings of a heated spring (CSV), and rig files with the parameters found from them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from calibration.springs.fit import SpringFit
from calibration.springs.recording import SpringRecording
from eldir.core.files import read_file, write_text
from eldir.core.records import FloatArray
from eldir.errors import InputError
from hardware.rig.sections import THERMAL, calibration_of
from hardware.rig.text import with_entries

_COLUMNS = ("t_s", "current_a", "voltage_v", "temperature_c", "fan")
_ENTRIES = {
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


def load_recording(path: Path) -> SpringRecording:
    """Read a table; raises `InputError` that names a missing column, or a value that is not a number."""
    data = read_file(path)
    if not data:
        raise InputError(f"{path} is empty", expected=f"columns {', '.join(_COLUMNS)}")
    try:
        rows = list(csv.DictReader(data.decode("utf-8-sig").splitlines()))
    except UnicodeDecodeError:
        raise InputError(f"{path} is no table", expected="CSV", found="bytes that are no text") from None
    except csv.Error as error:
        raise InputError(f"{path} is no table", expected="CSV", found=str(error)) from None
    found = tuple(rows[0]) if rows else ()
    missing = [c for c in _COLUMNS if c not in found]
    if missing:
        raise InputError(
            f"{path} is not a recording of a spring",
            expected=f"columns {', '.join(_COLUMNS)}",
            found=", ".join(str(c) for c in found) or "nothing",
        )
    time, current, voltage, temperature, fan = (_column(path, rows, name) for name in _COLUMNS)
    wrong = np.flatnonzero((fan != 0) & (fan != 1))
    if len(wrong):
        raise InputError(
            f"{path}: column fan is wrong",
            expected="0 or 1",
            found=f"{fan[wrong[0]]:g} in line {wrong[0] + 2}",
        )
    length = 1e-3 * _column(path, rows, "length_mm") if "length_mm" in found else None
    return SpringRecording(time, current, voltage, temperature, fan == 1, length)


def _column(path: Path, rows: list[dict[str, str]], name: str) -> FloatArray:
    try:
        values = np.array([float(row[name]) for row in rows])
        bad = ~np.isfinite(values)
        if bad.any():
            raise ValueError(f"none in line {int(bad.argmax()) + 2}")
        return values
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: column {name} is wrong", expected="numbers", found=str(error)) from None


def rig_with_springs(rig: Path, fit: SpringFit, out: Path) -> None:
    """Write a copy of the rig file with the parameters found in its section `springs`."""
    found = {
        entry: float(f"{scale * fit.estimates[name].value:.6g}")
        for name, (entry, scale) in _ENTRIES.items()
        if name in fit.estimates
    }
    calibration = calibration_of({name: value for name, value in found.items() if name in THERMAL})
    write_text(out, with_entries(rig.read_text(), "springs", {**found, "calibration": calibration}))
