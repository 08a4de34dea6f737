"""A thermometer in the air around the springs: a DS18B20 that Linux reads from its 1-wire bus.

Maxim Integrated, data sheet of the DS18B20 (19-7487): within 0.5 K from -10 to 85 C, in steps of a sixteenth;
85 C from power-on until the first measurement. Linux, Documentation/w1/slaves/w1_therm.rst: each reading of
`temperature` starts a measurement, waits for it (0.75 s), checks its CRC and gives thousandths of a degree.
"""

from __future__ import annotations

import logging
import os
import re
import stat
import time
from pathlib import Path

from eldir.errors import EldirError

ERROR_K = 0.5
"""Largest error [K]."""
STEP_K = 1 / 16
"""Its resolution [K]."""
_POWER_ON = 85_000  # shown from power-on until the first measurement [mC]
_MIN_C, _MAX_C = -20.0, 60.0  # of the air at a bench, as in `tolerances` of a rig file
_MAX_AGE = 60.0  # of a file that another program writes [s]
_KERNEL = Path("/sys")
_logger = logging.getLogger(__name__)


class ThermometerError(EldirError):
    """The thermometer does not show the temperature of the air."""

    code = "thermometer"


def read_thermometer(path: Path | str) -> float:
    """Temperature of the air [C]. Raises `ThermometerError`.

    A file of the kernel is measured by reading it. Any other one, such as a copy from another computer, must
    be younger than a minute.
    """
    path = Path(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise _unreadable(path, "not a regular file")
        with path.open("rb") as file:
            text = file.read(64).decode("ascii", "replace").strip()
        is_measured_now = status.st_dev == os.stat(_KERNEL).st_dev
    except OSError as error:
        raise _unreadable(path, error.strerror or str(error)) from None
    if not re.fullmatch(r"-?\d{1,6}", text):
        raise _unreadable(path, f"{text[:20]!r} instead of thousandths of a degree")
    age = time.time() - status.st_mtime
    if not is_measured_now and age > _MAX_AGE:
        raise ThermometerError(
            f"the thermometer {path} was not measured now",
            code="thermometer.stale",
            expected=f"a file of the kernel, or one written within {_MAX_AGE:g} s",
            found=f"written {age:.0f} s ago",
            remedy="look at the program that writes it",
        )
    if int(text) == _POWER_ON:
        raise ThermometerError(
            f"the thermometer {path} has not measured",
            code="thermometer.not-measured",
            found="85 C, its value after power-on",
            remedy="check its supply and its wires",
        )
    celsius = int(text) / 1000
    if not _MIN_C <= celsius <= _MAX_C:
        raise ThermometerError(
            f"the thermometer {path} shows no temperature of a room",
            code="thermometer.implausible",
            expected=f"{_MIN_C:g} to {_MAX_C:g} C",
            found=f"{celsius:g} C",
            remedy="check its wires, and that it hangs in the air around the springs",
        )
    _logger.info("%s: %g C", path, celsius)
    return celsius


def _unreadable(path: Path, found: str) -> ThermometerError:
    return ThermometerError(
        f"cannot read the thermometer {path}",
        code="thermometer.unreadable",
        found=found,
        remedy="check its wires and thermometer.path: ls /sys/bus/w1/devices/28-*/temperature",
    )
