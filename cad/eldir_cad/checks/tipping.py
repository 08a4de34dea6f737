"""Tipping sideways in closed form: how far a robot may lean, and how far its faces can twist it."""

from __future__ import annotations

import math

from eldir.built.robot import PrintedRobot
from eldir.parameters.printed import BuiltParameters
from eldir_cad.checks.lean import BiplaneSection
from eldir_cad.checks.strip_law import StripLaw
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

CURRENT_SPREAD = 0.02
"""Relative deviation of each face's current from the nominal one: what a meter in series leaves."""
FACE_DIFFERENCE_MM = 5.7
"""Largest difference of the free lengths of a motor's two springs whose currents are `CURRENT_SPREAD` above
and below that of a rig file, heated for 6 s in 23 s [mm]: pulses end on the steep part of the
transformation."""
REQUIRED_MARGIN_DEG = 3.0
"""Margin below which the build filter and a shortlist warn [degrees]."""
_WIDEST_GAP = 200  # connector that is looked for [mm]


def lateral_section(spec: Specification, printer: Printer, robot: BuiltParameters) -> BiplaneSection:
    """Widths and stiffnesses out of the plane of a robot of these parts; friction and weight of `robot`."""
    law = StripLaw.of(spec, printer)
    on_edge = (spec.strip.height / spec.strip.thickness) ** 2
    return BiplaneSection(
        springs_at=1e-3 * spec.springs_at,
        outside=1e-3 * spec.outside,
        corner=1e-3 * spec.mass.across_corners / 2,
        socket=1e-3 * spec.bulb_radius_at,
        play=lateral_rotation(spec),
        edge_stiffness=3 * on_edge * 1e-3 * law.flexural_rigidity / law.length,
        foot_friction=robot.friction,
        gravity=-robot.gravity,
    )


def lateral_rotation(spec: Specification) -> float:
    """Angle by which a strip turns out of its plane in a socket until it is held [rad].

    Between the socket's floor and the connector's flange it has the clearance on both sides and that of the
    connector. It is held over the length from the tip of its bulb to the rim: the mean of mass and flange.
    """
    room = spec.mass.socket_depth + spec.clearance - spec.strip.height
    tip = spec.bulb_radius_at - spec.strip.bulb_diameter / 2
    rim = (spec.mass.across_flats + spec.connector.flange_diameter) / 4
    return math.atan(room / (rim - tip))


def centre_height(robot: PrintedRobot, spec: Specification) -> float:
    """Height of the centre of mass over the table, as assembled [mm]."""
    above_lowest = robot.masses @ robot.positions[:, 1] / robot.masses.sum()
    return 1e3 * float(above_lowest) + spec.mass.across_corners / 2


def tipping_angle(spec: Specification, height: float) -> float:
    """Lean at which a centre of mass at this height [mm] is above the outer edge of the feet [degrees]."""
    return math.degrees(math.atan2(spec.outside, height))


def twist_angle(spec: Specification) -> float:
    """Angle between the hubs at the ends of a motor whose springs differ by `FACE_DIFFERENCE_MM`
    [degrees]."""
    return math.degrees(FACE_DIFFERENCE_MM / (2 * spec.springs_at))


def with_gap(spec: Specification, gap: float) -> Specification:
    """The same parts with connectors for another distance of the planes [mm]."""
    return spec.model_copy(update={"connector": spec.connector.model_copy(update={"gap": float(gap)})})


def smallest_gap(spec: Specification, height: float) -> int | None:
    """Smallest `connector.gap` in whole millimetres, not less than the present one, with which a robot whose
    centre of mass is at this height [mm] keeps `REQUIRED_MARGIN_DEG`; None if 200 mm are too little."""
    for gap in range(math.ceil(spec.connector.gap), _WIDEST_GAP + 1):
        wider = with_gap(spec, gap)
        if tipping_angle(wider, height) - twist_angle(wider) >= REQUIRED_MARGIN_DEG:
            return gap
    return None
