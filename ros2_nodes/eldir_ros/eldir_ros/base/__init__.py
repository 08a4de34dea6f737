"""The common base of the nodes: lifecycle, parameters, message classes, qualities of service, spinning.

The only modules besides the nodes and the programs that import rclpy.
"""
