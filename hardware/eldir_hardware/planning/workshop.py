"""The conditions for evolving robots: what can be printed with the default parts and driven on a rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from eldir import defaults
from eldir.built.gait import Gait
from eldir.errors import InputError
from eldir.evolution.printed.configuration import BuildConditions, RejectionReason
from eldir.evolution.printed.genome import Timing
from eldir.morphology import Morphology
from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances
from eldir_cad.checks.buildability import check
from eldir_cad.checks.strip_law import built_parameters, spring_parameters
from eldir_cad.kit import PRINTER
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_hardware.planning.plan import heating_limits
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.supply import require_measured
from eldir_hardware.rig.template import CURRENT_LIMIT_A


def make_workshop(rig: Path | None = None) -> BuildConditions:
    """The default parts and printer with this rig, or with the rig of the template.

    Raises `InputError` if the rig allows none of the heating times, or its springs share an output.
    """
    printer = load_printer(PRINTER)
    spec = fit_to_printer(load_specification(), printer)
    if rig is None:
        springs = replace(spring_parameters(spec), current_limit=CURRENT_LIMIT_A)
        timings = tuple(Timing(*timing) for timing in defaults.PRINTED_TIMINGS)
        motors, tolerances = defaults.PRINTED_MOTORS, RigTolerances()
    else:
        loaded = Rig.load(rig)
        require_measured(loaded)
        loaded.require_own_outputs("evolve without --rig; eldir gait predicts walks with this rig file")
        springs, tolerances = loaded.spring_parameters(), loaded.spring_tolerances()
        timings, motors = allowed_timings(loaded), loaded.motors
    return BuildConditions(
        built_parameters(spec, printer, springs),
        springs,
        motors,
        timings,
        make_build_filter(springs),
        spec.workspace.motors,
        1e-3 * spec.safety.static_margin,
        tolerances,
    )


def make_build_filter(springs: SpringParameters) -> RejectionReason:
    """The build filter of the default parts and printer, for bodies with these springs as motors."""
    printer = load_printer(PRINTER)
    spec = fit_to_printer(load_specification(), printer)

    def rejection_reason(body: Morphology) -> str:
        violations = check(body, spec, printer, springs).violations
        return next((v.kind for v in violations if v.severity != "note"), "")

    return rejection_reason


def allowed_timings(rig: Rig) -> tuple[Timing, ...]:
    """Periods and heating times that a rig allows: those of its springs, then the default ones.

    Each is checked with the motors heated one after another. Limits that depend on the phases, such as a
    shared supply, are checked for the schedule. Raises `InputError` if none is allowed.
    """
    limits, motors = heating_limits(rig), rig.motors
    period, duty = limits.timing(limits.springs, motors)
    default_timings = [Timing(*timing) for timing in defaults.PRINTED_TIMINGS]
    candidates = dict.fromkeys([Timing(period, round(period * duty, 3)), *default_timings])

    def gait(timing: Timing) -> Gait:
        return Gait(
            timing.period, np.arange(motors) / motors, np.full(motors, timing.heating / timing.period)
        )

    found = tuple(timing for timing in candidates if limits.allowed(gait(timing)))
    if not found:
        raise InputError(
            f"the rig {rig.name} allows none of the default heating times",
            expected="one of " + ", ".join(f"{t.heating:g} s in {t.period:g} s" for t in candidates),
            remedy="raise limits.max_on_s, or lower limits.min_off_s or supply.current_limit_a",
        )
    return found
