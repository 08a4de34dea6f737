"""What can be printed with the default parts, and driven on a rig: the conditions for evolving robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir.built.gait import Gait
from eldir.errors import InputError
from eldir.evolution.printed import defaults
from eldir.evolution.printed.genome import Timing
from eldir.evolution.printed.workshop import Workshop
from eldir.morphology import Morphology
from eldir_cad.checks.buildability import check
from eldir_cad.checks.strip_law import built_parameters, spring_parameters
from eldir_cad.kit.defaults import PRINTER
from eldir_cad.kit.fit import fitted_to_printer
from eldir_cad.kit.printer import load_printer
from eldir_cad.kit.specification import load_specification
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import CURRENT_LIMIT_A


def workshop(rig: Path | None = None) -> Workshop:
    """The default parts and printer with this rig, or with the rig of the template.

    Raises `InputError` where the rig allows none of the times of heating.
    """
    printer = load_printer(PRINTER)
    spec = fitted_to_printer(load_specification(), printer)

    def refused(body: Morphology) -> str:
        violations = check(body, spec, printer).violations
        return next((v.kind for v in violations if v.severity != "note"), "")

    printed, springs = built_parameters(spec, printer), spring_parameters(spec)
    if rig is None:
        usual = tuple(Timing(*timing) for timing in defaults.TIMINGS)
        springs = replace(springs, current_limit=CURRENT_LIMIT_A)
        return Workshop(printed, springs, defaults.MOTORS, usual, refused)
    known = Rig.load(rig)
    return Workshop(printed, known.spring_parameters(), known.motors, allowed_timings(known), refused)


def allowed_timings(rig: Rig) -> tuple[Timing, ...]:
    """Periods and times of heating that a rig allows: the springs' own, then the usual ones.

    Each is tried with all motors heated one after another. Limits that depend on the phases, such as a
    shared supply, are kept when the schedule is made. Raises `InputError` where none is allowed.
    """
    limits, motors = heating_limits(rig), rig.motors
    period, duty = limits.timing(limits.springs, motors)
    tried = dict.fromkeys([Timing(period, round(period * duty, 3)), *(Timing(*t) for t in defaults.TIMINGS)])

    def gait(timing: Timing) -> Gait:
        return Gait(
            timing.period, np.arange(motors) / motors, np.full(motors, timing.heating / timing.period)
        )

    found = tuple(timing for timing in tried if limits.allowed(gait(timing)))
    if not found:
        raise InputError(
            f"the rig {rig.name} allows none of the usual times of heating",
            expected="one of " + ", ".join(f"{t.heating:g} s in {t.period:g} s" for t in tried),
            remedy="see eldir rig doctor",
        )
    return found
