"""The table under a built robot: y = 0, and dry friction without regularisation."""

from types import SimpleNamespace
from typing import Any

from eldir.engine.compiler import ti


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

    @ti.func
    def meet_slope(height, along, up, friction, dt, height_, along_, up_, friction_):
        """Change of the speeds after as those before change; names with _ are slopes."""
        below = zero - height / dt - up
        push = ti.max(below, zero)
        push_ = ti.select(below > zero, zero - height_ / dt - up_, zero)
        grip, grip_ = friction * push, friction_ * push + friction * push_
        slips = ti.select(along < zero, along_ + grip_, along_ - grip_)
        held = ti.select(ti.max(along, zero - along) > grip, slips, zero)
        return ti.select(below > zero, held, along_), up_ + push_

    return SimpleNamespace(meet=meet, meet_slope=meet_slope)
