"""One camera's lens: focal length, centre and distortion, each with its standard deviation."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calibration.camera.validity import require_size
from eldir.core.files import load_json, write_text
from eldir.core.records import FloatArray, Record

FORMAT = "eldir-camera/1"


@dataclass(frozen=True, eq=False)
class Lens(Record):
    """A pinhole camera with radial and tangential distortion: OpenCV's model."""

    size: tuple[int, int]
    """Width and height of the pictures [px]."""
    focal: FloatArray
    """Horizontal and vertical focal length [px], shape (2,)."""
    centre: FloatArray
    """Principal point [px], shape (2,)."""
    distortion: FloatArray
    """Distortion coefficients k1, k2, p1, p2, k3, shape (5,)."""
    deviation: FloatArray
    """Standard deviations of focal, centre and distortion, in this order, shape (9,)."""
    rms_px: float
    """Reprojection error [px]."""
    rms_interval_px: tuple[float, float]
    """95 % interval of the error over the views [px]."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Date, number of views, date of expiry."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        for name, length in (("focal", 2), ("centre", 2), ("distortion", 5), ("deviation", 9)):
            self._set_array(name, np.float64, (length,))

    @property
    def matrix(self) -> FloatArray:
        """The camera matrix, shape (3, 3)."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    def require_size(self, width: int, height: int) -> None:
        """Raise `InputError` if pictures have another size than those of the calibration."""
        require_size(self.size, (width, height), "lens")

    @property
    def radial(self) -> FloatArray:
        """The two radial terms nearest to the distortion, with radius in half diagonals, shape (2,)."""
        r = np.linspace(0, 1, 200)  # in half diagonals
        q = (r * np.hypot(*self.size) / 2 / self.focal.mean()) ** 2
        k1, k2, _, _, k3 = self.distortion
        shift = r * q * (k1 + q * (k2 + q * k3))
        terms, *_ = np.linalg.lstsq(np.stack([r**3, r**5], axis=1), shift, rcond=None)
        return terms

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        d = self.deviation.tolist()
        return {
            "format": FORMAT,
            "width_px": self.size[0],
            "height_px": self.size[1],
            "focal_px": self.focal.tolist(),
            "focal_deviation_px": d[:2],
            "centre_px": self.centre.tolist(),
            "centre_deviation_px": d[2:4],
            "distortion": self.distortion.tolist(),
            "distortion_deviation": d[4:],
            "rms_px": self.rms_px,
            "rms_interval_px": list(self.rms_interval_px),
            "provenance": self.provenance,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Lens:
        """Build a lens from the values of `to_json`."""
        names = ("focal_deviation_px", "centre_deviation_px", "distortion_deviation")
        return cls(
            (values["width_px"], values["height_px"]),
            values["focal_px"],
            values["centre_px"],
            values["distortion"],
            np.concatenate([values[name] for name in names]),
            values["rms_px"],
            tuple(values["rms_interval_px"]),
            values["provenance"],
        )

    def save(self, path: Path | str) -> None:
        """Write the lens as JSON."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Lens:
        """Read a lens. Raises `InputError` that names a missing, damaged or foreign file."""
        return load_json(path, FORMAT, cls.from_json)
