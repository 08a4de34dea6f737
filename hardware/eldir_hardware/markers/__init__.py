"""Markers on masses m1 to m5: each kind as it is printed, and as it is tracked in pictures.

The plane that they move in is in `eldir_hardware.camera`; where pictures come from, in `vision`.
"""
