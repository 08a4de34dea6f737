"""The group `eldir calibrate`, which finds its sub-commands by entry points.

Those that read logs or cameras are in `hardware.commands`.
"""
