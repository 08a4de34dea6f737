"""`eldir rig`: write a rig file, check the rig, play a schedule, emulate a board. One module for each.

They read options, call a function of a package below and print.
"""

from eldir_app.commands import create_group

ORDER = ("setup", "new", "hold", "off", "reset", "drive", "watch", "emulate", "doctor", "firmware")
rig = create_group(__name__, ORDER, "Drive the physical or the virtual rig.")
