"""Parameters of the printed robot: strips, masses, friction, and the mechanics of its active springs.

The constants are assumptions from data sheets and geometry until they are measured; docs/reference/built.md
gives the source of each. Those of the printed parts are computed from the specification by
`eldir_cad.checks.strip_law`.
"""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat

from eldir.core.arguments import require_value
from eldir.core.records import Record, record
from eldir.lattice import HALF_SIDE
from eldir.parameters.annotations import (
    ActsWith,
    LargeSpread,
    Prior,
    Tolerance,
    VariesWith,
    field_annotations,
    vary,
)

STRIP_SPREAD = 0.3e-3
"""Standard deviation of a printed strip's length from the drawing [m]."""
_RESIN = "modulus and thickness of cured resin"
_Stiffness = Annotated[
    PositiveFloat,
    Prior(0.35, "shear modulus of published alloys, third power of the coil diameter"),
    VariesWith("weight"),
    Tolerance(0.05, shared="stiffness"),
    LargeSpread(0.1, 0.5),
]
"""Stiffness of a shape-memory spring, cold or hot."""
_SAMPLED_FIRST = (
    "tension", "buckling", "socket_friction", "strip_damping", "active_damping", "drag", "hexagon",
    "half_connector", "strip", "active_spring", "cold_stiffness", "friction", "bending",
)  # fmt: skip
"""Fields in the order in which former versions sampled them; new fields come after them, by themselves."""
Joints = Literal["pins", "clamped", "hubs"]
"""Pins at the masses; hexagons that clamp the strips; or hubs with sockets and corners."""


@record
class BuiltParameters(Record):
    """Parameters of a printed robot that do not depend on its design."""

    OPTIONAL = frozenset({"backward_friction", "tilt", "socket", "corner", "socket_turn", "socket_friction"})
    """Keys that files of version 0.1.0 do not have."""

    pitch: PositiveFloat = 0.057
    """Distance between neighbouring masses [m]."""
    gravity: Annotated[float, Field(lt=0)] = -9.81
    """Gravity, positive upwards [m/s2]."""
    tilt: Annotated[float, Field(gt=-pi / 2, lt=pi / 2)] = 0.0
    """Tilt of the table: it falls forward by this angle [rad]."""
    friction: Annotated[
        NonNegativeFloat,
        Prior(0.35, "resin on an unknown table"),
        Tolerance(0.3, "uniform"),
        LargeSpread(0.1, 0.5),
    ] = 0.5
    """Coulomb coefficient between a mass and the table."""
    backward_friction: Annotated[NonNegativeFloat, Field(exclude_if=lambda value: value == 1.0)] = 1.0
    """Friction of a mass that slides backward, as a multiple of `friction`: more than 1 with feet of slanted
    bristles or teeth."""
    drag: Annotated[NonNegativeFloat, Prior(0.5, "assumption"), Tolerance(0.1)] = 1.0
    """Rate at which velocities decay [1/s]."""
    tension: Annotated[PositiveFloat, Prior(0.15, _RESIN), VariesWith("weight"), Tolerance(0.1)] = 161e3
    """Stiffness of a strip in tension, E A / l [N/m]."""
    buckling: Annotated[PositiveFloat, Prior(0.3, _RESIN), VariesWith("weight"), Tolerance(0.1)] = 3.51
    """Euler load of a strip whose ends rotate in their sockets [N]."""
    bending: Annotated[
        NonNegativeFloat,
        ActsWith("clamped", "hubs"),
        VariesWith("buckling"),
        VariesWith("weight"),
        Tolerance(0.1),
    ] = 0.0
    """E I / l of a strip that its hexagons bend [N m]; 0: its ends are pins, hexagons do not rotate."""
    socket: Annotated[NonNegativeFloat, ActsWith("hubs")] = 0.0
    """Distance from a hexagon's centre to the hinges in its sockets [m]; 0: no sockets. With sockets a
    hexagon is a hub that stands on its corners, and the next three values count."""
    corner: Annotated[NonNegativeFloat, ActsWith("hubs")] = 0.0
    """Distance from a hub's centre to its corners [m]."""
    socket_turn: Annotated[NonNegativeFloat, ActsWith("hubs")] = 0.0
    """Angle to either side by which a strip turns freely in its sockets before it is bent [rad]."""
    socket_friction: Annotated[
        NonNegativeFloat,
        ActsWith("hubs"),
        Prior(0.5, "not measured"),
        VariesWith("weight"),
        Tolerance(0.5, joints="hubs"),
    ] = 0.0
    """Moment at which a strip begins to turn in a socket [N m]."""
    strip_damping: Annotated[
        NonNegativeFloat, Prior(0.5, _RESIN), Tolerance(0.2), Tolerance(0.5, joints="hubs")
    ] = 0.05
    """Damping ratio of a strip between its two masses, along it and, clamped, across."""
    cold_stiffness: _Stiffness = 49.0
    """Stiffness of a shape-memory spring, all martensite [N/m]."""
    hot_stiffness: _Stiffness = 124.0
    """Stiffness of a shape-memory spring, all austenite [N/m]."""
    active_damping: Annotated[
        NonNegativeFloat, Prior(0.5, "assumption"), VariesWith("weight"), Tolerance(0.2)
    ] = 0.5
    """Dashpot of a shape-memory spring [N s/m]."""
    hexagon: Annotated[
        PositiveFloat,
        Prior(
            0.05,
            "density, support marks; 0.5 % with `--weight`",
            name="weight",
            quantity="printed_mass",
            unobservable=True,
        ),
        Tolerance(0.05),
    ] = 0.905e-3
    """Mass of a hexagon with its cap [kg]."""
    half_connector: Annotated[PositiveFloat, VariesWith("weight"), Tolerance(0.05)] = 0.61e-3
    """What half a connector and fewer sockets add to each mass with fewer than six springs [kg]."""
    strip: Annotated[PositiveFloat, VariesWith("weight"), Tolerance(0.05)] = 0.324e-3
    """Mass of a strip [kg], half to each end."""
    active_spring: Annotated[
        PositiveFloat,
        Prior(0.04, "wire length, relative to the print", name="spring_mass"),
        VariesWith("weight"),
        Tolerance(0.02),
    ] = 1.95e-3
    """Mass of a shape-memory spring with its two ends [kg], half to each end."""
    gyration: PositiveFloat = 4.47e-3
    """Radius of gyration of a hexagon 12 mm across its flats [m]."""
    geometry: NonNegativeFloat = 0.0
    """Standard deviation of every strip's rest length from the drawing [m]."""

    def __post_init__(self) -> None:
        valid, remedy = self.socket == 0 or self.bending > 0, "start from BuiltParameters().with_hubs()"
        require_value(
            "BuiltParameters.bending", valid, "more than 0 N m where sockets have a size", 0, remedy
        )

    @property
    def joints(self) -> Joints:
        """What joins the strips."""
        if self.socket > 0:
            return "hubs"
        return "clamped" if self.bending > 0 else "pins"

    def acts(self, name: str) -> bool:
        """Whether a field acts with these joints."""
        where = dict(field_annotations(BuiltParameters, ActsWith)).get(name)
        return where is None or self.joints in where.joints

    @property
    def scale(self) -> float:
        """Lengths of the built robot divided by those of the simulated one."""
        return self.pitch / (2 * HALF_SIDE)

    def perturb(self, rng: np.random.Generator) -> BuiltParameters:
        """A random robot from the same printer, within the tolerances of its fields, and with strips that are
        longer and shorter than in the drawing."""
        return replace(self, **vary(self, rng, _SAMPLED_FIRST), geometry=STRIP_SPREAD)

    def with_hubs(self) -> BuiltParameters:
        """The same robot with hubs instead of pins: strips of 1 mm turn by 15 degrees in their sockets, with
        friction, and bend beyond that; the hubs stand on their corners. Clamped strips stay clamped."""
        if self.bending > 0:
            return self
        bending = 0.0176 * self.buckling / 3.51  # both grow with the strips' flexural rigidity
        return replace(
            self, bending=bending, socket=3.7e-3, corner=6.93e-3, socket_turn=float(np.radians(15)),
            socket_friction=1e-4, gyration=3.8e-3, strip_damping=0.2,
        )  # fmt: skip

    def with_pins(self) -> BuiltParameters:
        """The same robot with pins instead of hubs: its motion is nearly the same, in a seventh of the time.
        Clamped strips stay clamped."""
        if self.joints != "hubs":
            return self
        pins = BuiltParameters()
        changed = (
            "bending",
            "socket",
            "corner",
            "socket_turn",
            "socket_friction",
            "gyration",
            "strip_damping",
        )
        return replace(self, **{name: getattr(pins, name) for name in changed})

    @classmethod
    def clamped(cls) -> BuiltParameters:
        """Parameters for strips of 1 mm that are clamped in their hexagons: they bend, and carry four times
        the load."""
        return cls(tension=178e3, buckling=17.1, bending=0.0194, hexagon=0.947e-3, half_connector=0.596e-3)
