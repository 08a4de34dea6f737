"""The plane of motion in a picture: where its fixed tags are, and pixels to metres and back."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from eldir.core.records import Array, FileRecord, FloatArray, Record, record
from eldir.errors import InputError
from eldir_hardware.camera.validity import require_size
from eldir_hardware.units import length

Image = NDArray[Any]
"""A picture as OpenCV has it: 8 bits, BGR (H, W, 3) or grey (H, W)."""

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


@record
class Tag(Record):
    """One tag of a board."""

    id: Annotated[int, Field(ge=0)]
    """Number of the tag in the dictionary."""
    x_m: float
    """Forward position of the tag's centre [m]."""
    y_m: float
    """Height of the tag's centre above the ground [m]."""


@record
class TagBoard(FileRecord):
    """Square tags of one size, fixed upright in the plane of motion at known places."""

    FORMAT = "eldir-tags/1"

    dictionary: Annotated[str, Field(pattern="^DICT_")]
    """OpenCV's name of the dictionary of tags, such as DICT_4X4_50; DICT_APRILTAG_36h11 for AprilTags."""
    side_m: Annotated[float, Field(json_schema_extra={"minimum": _SIDE.low, "maximum": _SIDE.high})]
    """Side of a tag's black square [m]."""
    tags: Annotated[tuple[Tag, ...], Field(min_length=4)]
    """The fixed tags; at least four."""

    def __post_init__(self) -> None:
        _SIDE.require_plausible("the side of the tags", self.side_m, _IN_METRES)
        spread = float(np.ptp(self.centres, axis=0).max())
        _SPREAD.require_plausible("the distance between the outermost tags", spread, _IN_METRES)
        twice = sorted({i for i in self.ids if self.ids.count(i) > 1})
        if twice:
            raise InputError("a tag number occurs twice", expected="every number once", found=str(twice))

    @classmethod
    def at(cls, centres: FloatArray, side_m: float = 0.06, dictionary: str = "DICT_4X4_50") -> TagBoard:
        """Tags 0, 1, ... with their centres at these places [m], shape (N, 2)."""
        return cls(dictionary, side_m, tuple(Tag(i, *place) for i, place in enumerate(centres.tolist())))

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
        return cls.at(centres, side)

    @cached_property
    def ids(self) -> list[int]:
        """Number of each tag in its dictionary."""
        return [tag.id for tag in self.tags]

    @cached_property
    def centres(self) -> FloatArray:
        """Centre of each tag [m], shape (N, 2)."""
        return np.array([(tag.x_m, tag.y_m) for tag in self.tags])

    @property
    def corners(self) -> FloatArray:
        """Corners of the black squares from the top left, clockwise as seen [m], shape (N, 4, 2)."""
        around = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * self.side_m / 2
        return self.centres[:, None] + around


@record
class Plane(FileRecord):
    """Maps between the plane of motion and one camera's picture.

    A point x [m] goes through the homography to u (in half diagonals of the picture), and from
    there to the pixel centre + half diagonal * (1 + k1 |u|^2 + k2 |u|^4) u. Pixel (0, 0) is the
    middle of the first pixel.
    """

    FORMAT = "eldir-plane/1"

    width_px: Annotated[int, Field(ge=1)]
    """Width of the pictures [px]."""
    height_px: Annotated[int, Field(ge=1)]
    """Height of the pictures [px]."""
    homography: Annotated[FloatArray, Array("f8", 3, 3)]
    """Homography from (x, y, 1) [m] to homogeneous u: the undistorted picture, in half diagonals from the
    centre."""
    centre_px: Annotated[FloatArray, Array("f8", 2)]
    """Centre of distortion, horizontal and vertical [px]."""
    radial: Annotated[FloatArray, Array("f8", 2)]
    """Radial distortion coefficients k1 and k2, for a radius in half diagonals."""
    rms_px: Annotated[float, Field(ge=0)]
    """Reprojection error at the tags' corners, root mean square [px]."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Origin of the plane, for the reader: date, expiry, tags, number of pictures, version. Calibrated from
    live pictures: also the stamp of the first one (first_picture_ns)."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures [px]."""
        return self.width_px, self.height_px

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
        return self.centre_px + self.unit * self._stretch(u[..., 0], u[..., 1])[..., None] * u

    def to_metres(self, pixels: FloatArray) -> FloatArray:
        """Points in the plane at pixels (..., 2), shape (..., 2) [m]."""
        distorted = (np.asarray(pixels, np.float64) - self.centre_px) / self.unit
        # Each coordinate by itself: numpy takes several times as long over an axis of two.
        start = u, v = distorted[..., 0].copy(), distorted[..., 1].copy()
        for _ in range(30):  # a contraction while the distortion is mild: a digit or more each time
            stretch = self._stretch(u, v)
            before, (u, v) = (u, v), (start[0] / stretch, start[1] / stretch)
            if not any((np.abs(a - b) > 1e-13).any() for a, b in zip((u, v), before, strict=True)):  # nor NaN
                break
        u = np.stack([u, v], axis=-1)
        back = self._inverse
        points = u @ back[:2, :2].T + back[:2, 2]
        return points / (u @ back[2, :2] + back[2, 2])[..., None]

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.linalg.inv(self.homography)

    def _stretch(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """By how much points (...) at these undistorted coordinates lie farther out."""
        r2 = u**2 + v**2
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
