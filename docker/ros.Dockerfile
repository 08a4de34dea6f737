# The nodes on ROS 2 Jazzy (Ubuntu 24.04), as ros2_nodes/README.md installs them: rosdep for what has a key in
# package.xml, pip for the toolkit, in a virtual environment that sees ROS's packages.
#
#   docker build -f docker/ros.Dockerfile -t eldir-ros .
#   docker run --rm -it eldir-ros ros2 launch eldir_ros virtual_rig.launch.py
#   docker run --rm -it --device /dev/ttyUSB0 -v "$PWD:/work" eldir-ros \
#       ros2 launch eldir_ros real_rig.launch.py rig:=rig.yaml design:=design.json tags:=tags.json

FROM ros:jazzy-ros-base
SHELL ["/bin/bash", "-o", "pipefail", "-c"]
# Ubuntu's and ROS's packages follow the base image: their versions are not pinned.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/*

# Keys of both package.xml; ros-jazzy-ros-base has most of them. The lists of the apt repositories are needed meanwhile.
# What the toolkit needs of PyPI comes with it, into the virtual environment below.
COPY ros2_nodes /workspace/src
WORKDIR /workspace
RUN apt-get update \
    && rosdep update --rosdistro jazzy \
    && rosdep install --from-paths src --ignore-src --rosdistro jazzy -y --skip-keys eldir-requirements-pip \
        --dependency-types=buildtool --dependency-types=build --dependency-types=exec \
    && rm -rf /var/lib/apt/lists/*

# numpy 2 of the environment goes before Ubuntu's 1.26; colcon runs with the environment's Python, and so do the nodes.
COPY . /source
RUN python3 -m venv --system-site-packages /opt/eldir \
    && /opt/eldir/bin/pip install --no-cache-dir -c /source/.ci/constraints.txt \
        '/source[mujoco]' 'colcon-common-extensions==0.3.0' 'setuptools<80'
# hadolint ignore=SC1091
RUN . /opt/eldir/bin/activate && . /opt/ros/jazzy/setup.bash \
    && colcon build --base-paths src --cmake-args -DBUILD_TESTING=OFF \
    && . install/setup.bash \
    && ros2 pkg executables eldir_ros \
    && python -c 'from sensor_msgs.msg import CameraInfo; CameraInfo(); import eldir_ros.base'

COPY docker/ros_entrypoint.sh /eldir_entrypoint.sh
WORKDIR /work
ENV HOME=/tmp
USER 1000:1000
ENTRYPOINT ["/eldir_entrypoint.sh"]
CMD ["ros2", "launch", "eldir_ros", "virtual_rig.launch.py", "logs:=/tmp"]
