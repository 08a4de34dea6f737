"""Cameras, and the markers that they see, in metres.

Lens and plane are calibrated in `eldir_hardware.camera`; pictures as files are in `eldir_hardware.images`.
"""
