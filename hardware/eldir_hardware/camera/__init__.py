"""The camera: its lens, the plane of motion, and whether either has moved since.

Markers on the robot are tracked in `eldir_hardware.vision`.
"""
