"""Cameras, and the marks that they see, in metres.

Lens and plane are calibrated in `calibration.camera`; pictures as files are in `hardware.images`.
"""
