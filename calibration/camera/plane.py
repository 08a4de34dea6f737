"""The plane of motion in a picture: where its fixed tags are, and pixels to metres and back."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.camera.validity import require_size
from calibration.units import length
from eldir.core.files import load_json, write_text
from eldir.core.records import FloatArray, IntArray, Record
from eldir.errors import InputError

Image = NDArray[Any]
"""A picture as OpenCV has it: 8 bits, BGR (H, W, 3) or grey (H, W)."""

FORMAT = "eldir-plane/1"
TAGS_FORMAT = "eldir-tags/1"
_SIDE = length("m", 0.01, 0.5)
_SPREAD = length("m", 0.01, 10.0)
_IN_METRES = "give side_m, x_m and y_m of the tag file in metres"
_TILTED = 0.15  # relative change of scale over the picture, above which a camera counts as tilted


@dataclass(frozen=True)
class FieldOfView:
    """The part of the plane of motion that a camera has to see; the ground is y = 0 [m]."""

    x_from: float
    x_to: float
    height: float

    def __post_init__(self) -> None:
        if not (self.x_to > self.x_from and self.height > 0):
            raise InputError(
                "the field of view is empty",
                expected="x_from < x_to and height > 0",
                found=f"x from {self.x_from} to {self.x_to}, height {self.height}",
            )

    @classmethod
    def around(cls, positions: FloatArray, ahead: float = 1.3, behind: float = 1.3) -> FieldOfView:
        """Field of view in which a body (masses at `positions` (M, 2) [m]) can travel so many body lengths
        each way."""
        left, right = float(positions[:, 0].min()), float(positions[:, 0].max())
        length = right - left
        return cls(left - behind * length, right + ahead * length, float(positions[:, 1].max()) + 0.05)


@dataclass(frozen=True, eq=False)
class TagBoard(Record):
    """Square tags of one size, fixed upright in the plane of motion at known places."""

    ids: IntArray
    """Number of each tag in its dictionary, shape (N,)."""
    centres: FloatArray
    """Centre of each tag [m], shape (N, 2)."""
    side: float = 0.06
    """Side of the black square [m]."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the dictionary; DICT_APRILTAG_36h11 for AprilTags."""

    def __post_init__(self) -> None:
        self._set_array("ids", np.int32, (None,))
        self._set_array("centres", np.float64, (len(self.ids), 2))
        _SIDE.require_plausible("the side of the tags", float(self.side), _IN_METRES)
        if not np.isfinite(self.centres).all():
            raise InputError(
                "a tag has no position", expected="x and y in metres", found=str(self.centres.tolist())
            )
        if len(self.ids) > 1:
            spread = float(np.ptp(self.centres, axis=0).max())
            _SPREAD.require_plausible("the distance between the outermost tags", spread, _IN_METRES)
        twice = sorted({i for i in self.ids.tolist() if (self.ids == i).sum() > 1})
        if twice:
            raise InputError("a tag number occurs twice", expected="every number once", found=str(twice))

    @classmethod
    def around(cls, view: FieldOfView, spacing: float = 0.3) -> TagBoard:
        """A row of tags under the ground and one above the field of view, at most `spacing` [m] apart, and
        so large that a camera of 640 pixels which sees them all can read them."""
        width = view.x_to - view.x_from
        side = 0.06 * max(1.0, width)
        columns = max(3, int(np.ceil(width / spacing)) + 1)
        x = np.linspace(view.x_from, view.x_to, columns)
        rows = (-0.025 - 0.75 * side, view.height + 0.75 * side)
        centres = np.array([(a, b) for b in rows for a in x])
        return cls(np.arange(len(centres)), centres, side)

    @property
    def corners(self) -> FloatArray:
        """Corners of the black squares from the top left, clockwise as seen [m], shape (N, 4, 2)."""
        around = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * self.side / 2
        return self.centres[:, None] + around

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        tags = [
            {"id": int(i), "x_m": c[0], "y_m": c[1]}
            for i, c in zip(self.ids, self.centres.tolist(), strict=True)
        ]
        return {"format": TAGS_FORMAT, "dictionary": self.dictionary, "side_m": self.side, "tags": tags}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> TagBoard:
        """Build the object from the values of `to_json`."""
        tags = values["tags"]
        centres = np.array([(t["x_m"], t["y_m"]) for t in tags], float).reshape(-1, 2)
        return cls(np.array([t["id"] for t in tags]), centres, values["side_m"], values["dictionary"])

    @classmethod
    def load(cls, path: Path | str) -> TagBoard:
        """Read a tag file. Raises `InputError` that names a missing, damaged or foreign file."""
        return load_json(path, TAGS_FORMAT, cls.from_json)


@dataclass(frozen=True, eq=False)
class Plane(Record):
    """Maps between the plane of motion and one camera's picture.

    A point x [m] goes through the homography to u (in half diagonals of the picture), and from
    there to the pixel centre + half diagonal * (1 + k1 |u|^2 + k2 |u|^4) u. Pixel (0, 0) is the
    middle of the first pixel.
    """

    size: tuple[int, int]
    """Width and height of the picture [px]."""
    homography: FloatArray
    """Homography from (x, y, 1) [m] to homogeneous u, shape (3, 3)."""
    centre: FloatArray
    """Centre of distortion [px], shape (2,)."""
    radial: FloatArray
    """Radial distortion coefficients k1 and k2, shape (2,)."""
    rms_px: float
    """Reprojection error at the tags' corners, root mean square [px]."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Date, source, tags and version."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", (int(self.size[0]), int(self.size[1])))
        self._set_array("homography", np.float64, (3, 3))
        self._set_array("centre", np.float64, (2,))
        self._set_array("radial", np.float64, (2,))

    @property
    def board(self) -> TagBoard | None:
        """The fixed tags from which the plane was found; None if its file does not contain them."""
        values = self.provenance.get("board")
        return None if values is None else TagBoard.from_json(values)

    @property
    def unit(self) -> float:
        """Half the diagonal of the picture [px]."""
        return float(np.hypot(*self.size)) / 2

    def to_pixels(self, points: FloatArray) -> FloatArray:
        """Pixels of points (..., 2) [m] in the plane, shape (..., 2) [px]."""
        h = self.homography
        u = points @ h[:2, :2].T + h[:2, 2]
        u = u / (points @ h[2, :2] + h[2, 2])[..., None]
        return self.centre + self.unit * self._stretch(u) * u

    def to_metres(self, pixels: FloatArray) -> FloatArray:
        """Points in the plane at pixels (..., 2), shape (..., 2) [m]."""
        distorted = (np.asarray(pixels, np.float64) - self.centre) / self.unit
        u = distorted
        for _ in range(30):  # a contraction while the distortion is mild: a digit or more each time
            before, u = u, distorted / self._stretch(u)
            if not (np.abs(u - before) > 1e-13).any():  # nor where it is NaN
                break
        back = self._inverse
        points = u @ back[:2, :2].T + back[:2, 2]
        return points / (u @ back[2, :2] + back[2, 2])[..., None]

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.linalg.inv(self.homography)

    def _stretch(self, u: FloatArray) -> FloatArray:
        r2 = (u[..., 0] ** 2 + u[..., 1] ** 2)[..., None]
        k1, k2 = self.radial
        return 1 + r2 * (k1 + r2 * k2)

    def require_size(self, width: int, height: int) -> None:
        """Raise `InputError` if pictures have another size than those of the calibration."""
        require_size(self.size, (width, height), "plane")

    def pixels_per_metre(self, points: FloatArray) -> FloatArray:
        """Scale at points (..., 2) [m]: square root of the ratio of areas [px/m], shape (...)."""
        step = 1e-3
        ring = np.asarray(points)[..., None, :] + step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        p = self.to_pixels(ring)
        a, b = p[..., 0, :] - p[..., 1, :], p[..., 2, :] - p[..., 3, :]
        return np.sqrt(np.abs(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])) / (2 * step)

    @property
    def scale(self) -> tuple[float, float]:
        """Scale in the middle of the picture [px/m], and its relative change over the picture: it grows with
        the camera's tilt against the plane."""
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0.5)]) * (np.array(self.size) - 1.0)
        *around, middle = self.pixels_per_metre(self.to_metres(corners)).tolist()
        return middle, (max(around) - min(around)) / middle

    @property
    def tilted(self) -> bool:
        """Whether the camera is tilted so much against the plane that the user should know."""
        return self.scale[1] > _TILTED

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of `from_json`."""
        return {
            "format": FORMAT,
            "width_px": self.size[0],
            "height_px": self.size[1],
            "homography": self.homography.tolist(),
            "centre_px": self.centre.tolist(),
            "radial": self.radial.tolist(),
            "rms_px": self.rms_px,
            "provenance": self.provenance,
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Plane:
        """Build the object from the values of `to_json`."""
        return cls(
            (values["width_px"], values["height_px"]),
            values["homography"],
            values["centre_px"],
            values["radial"],
            values["rms_px"],
            values["provenance"],
        )

    def save(self, path: Path | str) -> None:
        """Write the plane as JSON."""
        write_text(Path(path), json.dumps(self.to_json(), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path | str) -> Plane:
        """Read a plane. Raises `InputError` that names a missing, damaged or foreign file."""
        return load_json(path, FORMAT, cls.from_json)
