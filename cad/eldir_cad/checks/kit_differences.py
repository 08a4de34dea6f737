"""Parts that differ from the kit's: the commands after the packet do not know them."""

from __future__ import annotations

from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir_cad.checks.strip_law import hub_parameters, spring_parameters
from eldir_cad.checks.violations import Violation
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification

_PREDICTED = "pitch", "tension", "buckling", "bending", "socket", "socket_turn", "corner", "hexagon", "strip"
"""Parameters of the printed parts that decide how a robot moves."""
_OF_COIL = "coil_diameter", "cold_length", "hot_length"
"""Parameters of the coils that the parts file gives."""
_AS_THE_KIT = 0.05  # relative difference that the kit's own robots have too


def note_differences(spec: Specification, printer: Printer) -> list[Violation]:
    """Printed parts that move otherwise than the kit's, which is all that the commands after the packet know;
    and coils, of which they know what the rig file says."""
    return [*_note_parts(spec, printer), *_note_coils(spec)]


def different_parameters(spec: Specification, printer: Printer) -> tuple[str, ...]:
    """Names of the parameters of the printed parts that decide how a robot moves, and are not the kit's."""
    kit, own = BuiltParameters().with_hubs(), hub_parameters(spec, printer)
    values = [(name, getattr(own, name), getattr(kit, name)) for name in _PREDICTED]
    return tuple(name for name, value, usual in values if abs(value - usual) > _AS_THE_KIT * usual)


def _note_parts(spec: Specification, printer: Printer) -> list[Violation]:
    other = different_parameters(spec, printer)
    if not other:
        return []
    message = (
        f"the parts are not the kit's ({', '.join(other)}): eldir gait, track, report, transfer, adapt and "
        "virtual rigs compute with the kit's"
    )
    remedy = "do not take their predictions for this robot's; eldir shortlist and eldir export take --parts"
    return [Violation("parts", "note", ("body",), len(other), "parameters", message, remedy)]


def _note_coils(spec: Specification) -> list[Violation]:
    own, kit = spring_parameters(spec), SpringParameters()
    other = [name for name in _OF_COIL if getattr(own, name) != getattr(kit, name)]
    if not other:
        return []
    message = (
        f"the coils are not the kit's ({', '.join(other)}): the commands after the packet take them from the "
        "rig file"
    )
    values = ", ".join(f"{name}_mm: {1e3 * getattr(own, name):.6g}" for name in _OF_COIL)
    remedy = f"write into the springs of the rig file {values}"
    return [Violation("parts", "note", ("coils",), len(other), "parameters", message, remedy)]
