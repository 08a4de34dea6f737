"""What the nodes share: lifecycle, parameters, message classes and qualities of service, the spinning.

The only modules besides the nodes and the programs that import rclpy.
"""
