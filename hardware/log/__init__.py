"""Logs of runs as MCAP files that ROS 2 tools read."""
