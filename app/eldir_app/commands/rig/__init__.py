"""`eldir rig`: write a rig file, check the rig, play a schedule, emulate a board. A module a sub-command.

They read options, call one function of a package below and print.
"""

from eldir_app.terminal.groups import group

ORDER = ("new", "hold", "off", "reset", "drive", "watch", "emulate", "doctor", "firmware")
rig = group(__name__, ORDER, "Drive the physical or the virtual rig.")
