"""ROS 2 nodes of a rig: they translate messages; every decision lives in the toolkit below.

`eldir_ros.conversions` and whatever else runs without ROS imports no rclpy.
"""
