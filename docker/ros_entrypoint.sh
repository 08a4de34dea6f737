#!/bin/bash
# The environments of ROS, of the toolkit and of the built packages, then the command.
set -e
source /opt/ros/jazzy/setup.bash
source /opt/eldir/bin/activate
source /workspace/install/setup.bash
exec "$@"
