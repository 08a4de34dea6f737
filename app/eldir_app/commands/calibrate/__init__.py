"""`eldir calibrate`: camera, plane, springs, dynamics. One module for each.

They read options, call a function of a package below and print.
"""

from eldir_app.commands import create_group

ORDER = ("camera", "plane", "springs", "dynamics")
calibrate = create_group(
    __name__, ORDER, "Find the parameters of the camera, the plane of motion, the springs and the robot."
)
