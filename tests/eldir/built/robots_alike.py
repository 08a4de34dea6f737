"""Tolerances of rigs that are all alike, for tests of what does not depend on them."""

from eldir.parameters.springs import SpringParameters
from eldir.parameters.tolerances import RigTolerances

_ROOM = SpringParameters().ambient
NO_ERRORS = RigTolerances(
    current=0, convection=0, ambient_min=_ROOM, ambient_max=_ROOM, transition=0, stroke=0
)
