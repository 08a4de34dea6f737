"""Logs of runs as MCAP files that ROS 2 tools read: written, read and recovered.

What a log means is worked out in `hardware.analysis`.
"""
