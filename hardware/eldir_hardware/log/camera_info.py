"""The fields of sensor_msgs/CameraInfo for a lens."""

from __future__ import annotations

from typing import Any

import numpy as np

from eldir_hardware.camera.lens import Lens


def calibration(lens: Lens | None) -> dict[str, Any]:
    """Distortion model, D, K, R and P by their names in the message.

    Pictures are not rectified, so R is one and P is K. Without a lens all are zero: K[0] = 0 is how
    the message says that a camera is not calibrated.
    """
    if lens is None:
        return {
            "distortion_model": "",
            "d": np.zeros(0),
            "k": np.zeros(9),
            "r": np.zeros(9),
            "p": np.zeros(12),
        }
    return {
        "distortion_model": "plumb_bob",  # k1, k2, p1, p2, k3, in OpenCV's order as ours
        "d": lens.distortion.copy(),
        "k": lens.matrix.ravel(),
        "r": np.eye(3).ravel(),
        "p": np.column_stack([lens.matrix, np.zeros(3)]).ravel(),
    }


def of(lens: Lens | None, width: int, height: int) -> dict[str, Any]:
    """All fields but the header, of whole pictures of this size [px]."""
    region = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    size = {"height": height, "width": width, "binning_x": 0, "binning_y": 0, "roi": region}
    return size | calibration(lens)
