"""Heating through messages: the bank behind the sequencer, a goal's course, and heartbeats of nodes.

These modules import no rclpy and are tested without ROS.
"""
