"""Logs of runs as MCAP files that ROS 2 tools read: written, read and recovered.

Logs are evaluated in `eldir_calibration.comparison`.
"""
