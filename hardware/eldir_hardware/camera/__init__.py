"""The camera: its lens, the plane of motion, and whether either has moved since.

Marks on the robot are tracked in `eldir_hardware.vision`.
"""
