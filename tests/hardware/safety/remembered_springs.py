"""Heat of springs that a run has left, on the channels of the template's rig file."""

from eldir_hardware.safety.spring_memory import SpringHeat

COLD = SpringHeat((22.0, 30.0), (1.0, 1.0), ())
PLACES = {1: (0, "front"), 2: (0, "back"), 3: (1, "front"), 4: (1, "back")}  # of the template's rig file
WARM = {
    1: SpringHeat((61.5, 70.25), (0.25, 0.0), ((12.0, 7.0),), place=PLACES[1]),
    3: SpringHeat((22.0, 30.0), (1.0, 1.0), (), place=PLACES[3]),
}
