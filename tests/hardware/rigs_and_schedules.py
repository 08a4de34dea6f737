"""The template's rig with changes, gaits of two motors, and a schedule of both."""

from copy import deepcopy
from functools import cache
from types import SimpleNamespace

import numpy as np

from eldir.core.yaml_files import parse_yaml
from eldir_hardware.planning.compiler import compile_schedule
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.sections import calibration_entry
from eldir_hardware.rig.template import virtual_rig


@cache
def _template() -> dict[str, object]:
    return parse_yaml(rig_text().encode(), "the template")


def rig_text(*values: object, **changes: object) -> str:
    """The template's virtual rig with less current: a pulse is allowed every 20 s, and not every 30 s."""
    return virtual_rig(*values, **changes).replace("current_limit_a: 3.6", "current_limit_a: 3.45")


def rig_with(**changes: object) -> Rig:
    """The virtual rig of the template at 3.45 A, with entries such as supply={"current_limit_a": 2}."""
    values = deepcopy(_template())
    for entry, change in changes.items():
        values[entry] = values.get(entry, {}) | change if isinstance(change, dict) else change
    return Rig.from_json(values)


def measured(**springs: object) -> dict[str, object]:
    """Values of `springs` as `eldir calibrate springs` writes them."""
    return springs | {"calibration": calibration_entry(springs)}


def gait(phase=(0.0, 0.5), duty=(0.275, 0.275), period=20.0) -> SimpleNamespace:
    return SimpleNamespace(period=period, phase=np.array(phase), duty=np.array(duty))


RIG = rig_with()
SCHEDULE = compile_schedule(gait(), RIG, springs=(7, 12))
