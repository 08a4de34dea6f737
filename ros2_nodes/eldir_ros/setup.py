# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The package as colcon builds it. The toolkit's wheel does not contain it."""

from glob import glob

from setuptools import find_packages, setup

NODES = (
    "relay_board",
    "actuation_sequencer",
    "camera",
    "mass_tracker",
    "mcap_recorder",
    "range_of_motion",
    "robot_model",
    "virtual_bench",
)
PROGRAMS = ("rig_process", "run_schedule", "doctor")
EXECUTABLES = [f"{name} = eldir_ros.nodes.{name}:main" for name in NODES]
EXECUTABLES += [f"{name} = eldir_ros.programs.{name}:main" for name in PROGRAMS]

setup(
    name="eldir_ros",
    version="0.1.0",
    description="Lifecycle nodes of a rig that heats a lattice robot's springs.",
    license="MIT",
    packages=find_packages(include=["eldir_ros", "eldir_ros.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/eldir_ros"]),
        ("share/eldir_ros", ["package.xml", "LICENSE", "CHANGELOG.rst"]),
        ("share/eldir_ros/launch", glob("launch/*.launch.py")),
        ("share/eldir_ros/config", glob("config/*")),
        ("share/eldir_ros/examples", glob("examples/*")),
        ("share/eldir_ros/sros2", glob("sros2/*")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    maintainer="the developers of eldir",
    maintainer_email="eldir@example.org",
    zip_safe=True,
    entry_points={"console_scripts": EXECUTABLES},
)
