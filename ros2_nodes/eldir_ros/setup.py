"""The package as colcon builds it; without ROS the toolkit's own pyproject.toml installs these modules."""

from glob import glob

from setuptools import find_packages, setup

NODES = (
    "relay_board",
    "actuation_sequencer",
    "camera",
    "mass_tracker",
    "mcap_recorder",
    "range_of_motion",
    "virtual_bench",
)
PROGRAMS = ("rig_process", "run_schedule")
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
        ("share/eldir_ros", ["package.xml"]),
        ("share/eldir_ros/launch", glob("launch/*.launch.py")),
        ("share/eldir_ros/config", glob("config/*")),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    entry_points={"console_scripts": EXECUTABLES},
)
