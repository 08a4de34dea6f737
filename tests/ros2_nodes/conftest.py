"""Message packages for the modules of the nodes that need no rclpy."""

from tests.ros2_nodes.message_types import provide_modules

provide_modules()
