"""One camera's lens: focal length, centre and distortion, each with its standard deviation."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from eldir.core.records import Array, FileRecord, FloatArray, record
from eldir_hardware.camera.validity import require_size

Pair = Annotated[FloatArray, Array("f8", 2)]
Five = Annotated[FloatArray, Array("f8", 5)]


@record
class Lens(FileRecord):
    """A pinhole camera with radial and tangential distortion: OpenCV's model."""

    FORMAT = "eldir-camera/1"

    width_px: Annotated[int, Field(ge=1)]
    """Width of the pictures [px]."""
    height_px: Annotated[int, Field(ge=1)]
    """Height of the pictures [px]."""
    focal_px: Pair
    """Horizontal and vertical focal length [px]."""
    focal_deviation_px: Pair
    """Standard deviations of the focal lengths [px]."""
    centre_px: Pair
    """Principal point, horizontal and vertical [px]."""
    centre_deviation_px: Pair
    """Standard deviations of the principal point [px]."""
    distortion: Five
    """Distortion coefficients k1, k2, p1, p2, k3, as in OpenCV."""
    distortion_deviation: Five
    """Standard deviations of the distortion coefficients, in the same order."""
    rms_px: Annotated[float, Field(ge=0)]
    """Reprojection error, root mean square over all corners [px]."""
    rms_interval_px: tuple[float, float]
    """95 % interval of the reprojection error over the views [px]."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the calibration: date, number of views, date of expiry."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures [px]."""
        return self.width_px, self.height_px

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations of focal lengths, principal point and distortion, in this order, shape (9,)."""
        parts = (self.focal_deviation_px, self.centre_deviation_px, self.distortion_deviation)
        return np.concatenate(parts)

    @property
    def matrix(self) -> FloatArray:
        """The camera matrix, shape (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def require_size(self, width: int, height: int) -> None:
        """Raise `InputError` if pictures have another size than those of the calibration."""
        require_size(self.size, (width, height), "lens")

    @property
    def radial(self) -> FloatArray:
        """The two radial terms nearest to the distortion, with radius in half diagonals, shape (2,)."""
        r = np.linspace(0, 1, 200)  # in half diagonals
        q = (r * np.hypot(*self.size) / 2 / self.focal_px.mean()) ** 2
        k1, k2, _, _, k3 = self.distortion
        shift = r * q * (k1 + q * (k2 + q * k3))
        terms, *_ = np.linalg.lstsq(np.stack([r**3, r**5], axis=1), shift, rcond=None)
        return terms
