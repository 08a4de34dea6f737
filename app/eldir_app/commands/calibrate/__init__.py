"""`eldir calibrate`: camera, plane, springs, dynamics. A module a sub-command.

They read options, call one function of a package below and print.
"""

from eldir_app.terminal.groups import group

ORDER = ("camera", "plane", "springs", "dynamics")
calibrate = group(
    __name__, ORDER, "Find the parameters of the camera, the plane of motion, the springs and the robot."
)
