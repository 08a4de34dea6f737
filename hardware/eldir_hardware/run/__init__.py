"""A schedule played, filmed and recorded.

Switching itself is behind `eldir_hardware.guardian`; results are computed in `eldir_calibration.comparison`.
"""
