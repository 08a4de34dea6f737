"""A camera's lens: focal length, centre and distortion, each with its standard deviation.

And how long a calibration is valid, and for which pictures.
"""

from __future__ import annotations

from dataclasses import field
from datetime import UTC, datetime, timedelta
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from eldir.core.records import Array, FileRecord, FloatArray, record
from eldir.errors import InputError, damaged

LENS_VALIDITY_DAYS = 180.0
"""A lens is valid for so many days: sooner or later somebody changes focus or zoom."""
PLANE_VALIDITY_DAYS = 7.0
"""A plane is valid for so many days: sooner or later somebody moves the tripod."""


ROTATED_HINT = ", rotated by 90 degrees: take the files as the camera stores them"


def validity_period(days: float) -> dict[str, str]:
    """Dates of a calibration that is made now and is valid for so many days, for its provenance."""
    now = datetime.now(UTC).replace(microsecond=0)
    return {"made": now.isoformat(), "expires": (now + timedelta(days=days)).isoformat()}


def require_not_expired(provenance: dict[str, Any], recorded: datetime, name: str) -> None:
    """Raise `InputError` where the calibration `name` had expired when a recording was made (`recorded`). A
    calibration without a date never expires."""
    expires = provenance.get("expires")
    if expires is None:
        return
    try:
        end = datetime.fromisoformat(expires)
    except (TypeError, ValueError):
        raise damaged(name, "a date in expires", repr(expires)) from None
    if recorded > end:
        raise InputError(
            f"{name} had expired when the recording was made",
            code="camera.expired",
            expected=f"a recording before {end:%Y-%m-%d %H:%M} UTC",
            found=f"{recorded:%Y-%m-%d %H:%M}",
            remedy="calibrate again",
        )


def require_size(calibrated: tuple[int, int], pictures: tuple[int, int], what: str) -> None:
    """Raise `InputError` where the `pictures` have another width and height [px] than those that `what`, such
    as a lens, was `calibrated` with."""
    if calibrated != pictures:
        rotated = calibrated == pictures[::-1]
        raise InputError(
            f"these pictures have another size than those of the {what} calibration",
            code="camera.other-size",
            expected=f"{calibrated[0]} x {calibrated[1]} pixels",
            found=f"{pictures[0]} x {pictures[1]}{ROTATED_HINT if rotated else ''}",
            remedy=f"film at the size that was calibrated, or calibrate the {what} for this one",
        )


Vector2 = Annotated[FloatArray, Array("f8", 2)]
Vector5 = Annotated[FloatArray, Array("f8", 5)]


@record
class Lens(FileRecord):
    """A pinhole camera with radial and tangential distortion: OpenCV's model."""

    FORMAT = "eldir-camera/1"

    width_px: Annotated[int, Field(ge=1)]
    """Width of the pictures [px]."""
    height_px: Annotated[int, Field(ge=1)]
    """Height of the pictures [px]."""
    focal_px: Vector2
    """Horizontal and vertical focal length [px]."""
    focal_deviation_px: Vector2
    """Standard deviations of the focal lengths [px]."""
    centre_px: Vector2
    """Principal point, horizontal and vertical [px]."""
    centre_deviation_px: Vector2
    """Standard deviations of the principal point [px]."""
    distortion: Vector5
    """Distortion coefficients k1, k2, p1, p2, k3, as in OpenCV."""
    distortion_deviation: Vector5
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
        """Two radial terms that approximate the distortion, for a radius in half diagonals, shape (2,)."""
        r = np.linspace(0, 1, 200)  # in half diagonals
        q = (r * np.hypot(*self.size) / 2 / self.focal_px.mean()) ** 2
        k1, k2, _, _, k3 = self.distortion
        shift = r * q * (k1 + q * (k2 + q * k3))
        terms, *_ = np.linalg.lstsq(np.stack([r**3, r**5], axis=1), shift, rcond=None)
        return terms
