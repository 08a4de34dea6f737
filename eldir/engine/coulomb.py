"""The table under a built robot: y = 0, and dry friction without regularisation."""

from types import SimpleNamespace
from typing import Any

import taichi as ti


def functions(lane: Any) -> SimpleNamespace:
    """Contact for one type of vector."""
    zero = lane(0.0)

    @ti.func
    def meet(height, along, up, friction, dt):
        """Speeds of a mass after the ground's impulse: it ends the fall within the step, and changes the
        speed along the table by at most `friction` times that."""
        push = ti.max(zero - height / dt - up, zero)
        grip = friction * push
        return along - ti.max(ti.min(along, grip), zero - grip), up + push

    return SimpleNamespace(meet=meet)
