"""Folders of the repository that tests read."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
SCHEMAS = ROOT / "docs" / "schemas"
DATA = ROOT / "tests" / "data"
PACKAGES = {
    "eldir": ROOT / "eldir",
    "eldir_cad": ROOT / "cad" / "eldir_cad",
    "eldir_hardware": ROOT / "hardware" / "eldir_hardware",
    "eldir_calibration": ROOT / "calibration" / "eldir_calibration",
    "eldir_app": ROOT / "app" / "eldir_app",
}
"""The packages that are installed."""
NODES = ROOT / "ros2_nodes" / "eldir_ros"
"""Where the nodes' package lies, which colcon installs."""
