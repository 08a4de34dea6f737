"""The plane of motion in a picture: its reference tags, pixels to metres and back, and the camera's pose."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from eldir.core.arguments import length_quantity
from eldir.core.records import Array, FileRecord, FloatArray, Record, record
from eldir.errors import InputError
from eldir_hardware.camera.lens import require_size

Image = NDArray[Any]
"""A picture as OpenCV has it: 8 bits, BGR (H, W, 3) or grey (H, W)."""

_TAG_SIDE = length_quantity("m", 0.01, 0.5)
_TAG_SPREAD = length_quantity("m", 0.01, 10.0)
_METRES_REMEDY = "give side_m, x_m and y_m of the tag file in metres"
_MAX_SCALE_VARIATION = (
    0.15  # relative change of scale over the picture, above which a camera counts as tilted
)


@dataclass(frozen=True)
class FieldOfView:
    """The part of the plane of motion that a camera films, from the ground (y = 0) up to a height [m]."""

    min_x: float
    max_x: float
    height: float

    def __post_init__(self) -> None:
        if not (self.max_x > self.min_x and self.height > 0):
            raise InputError(
                "the field of view is empty",
                expected="min_x < max_x and height > 0",
                found=f"x from {self.min_x} to {self.max_x}, height {self.height}",
            )

    @classmethod
    def around(cls, positions: FloatArray, ahead: float = 1.3, behind: float = 1.3) -> FieldOfView:
        """Field of view for a body (masses at `positions` (M, 2) [m]) that travels up to `ahead` body lengths
        forward and `behind` body lengths back."""
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
    """Square reference tags of one size, fixed upright in the plane of motion at known places."""

    FORMAT = "eldir-tags/1"

    dictionary: Annotated[str, Field(pattern="^DICT_")]
    """OpenCV's name of the dictionary of tags, such as DICT_4X4_50; DICT_APRILTAG_36h11 for AprilTags."""
    side_m: Annotated[float, Field(json_schema_extra={"minimum": _TAG_SIDE.low, "maximum": _TAG_SIDE.high})]
    """Side of a tag's black square [m]."""
    tags: Annotated[tuple[Tag, ...], Field(min_length=4)]
    """The reference tags; at least four."""

    def __post_init__(self) -> None:
        _TAG_SIDE.require_plausible("the side of the tags", self.side_m, _METRES_REMEDY)
        spread = float(np.ptp(self.centres, axis=0).max())
        _TAG_SPREAD.require_plausible("the distance between the outermost tags", spread, _METRES_REMEDY)
        duplicates = sorted({i for i in self.ids if self.ids.count(i) > 1})
        if duplicates:
            raise InputError("duplicate tag numbers", expected="every number once", found=str(duplicates))

    @classmethod
    def at(cls, centres: FloatArray, side_m: float = 0.06, dictionary: str = "DICT_4X4_50") -> TagBoard:
        """Tags 0, 1, ... with their centres at these places [m], shape (N, 2)."""
        return cls(dictionary, side_m, tuple(Tag(i, *place) for i, place in enumerate(centres.tolist())))

    @classmethod
    def around(cls, view: FieldOfView, spacing: float = 0.3) -> TagBoard:
        """A row of tags under the ground and one above the field of view, at most `spacing` [m] from each
        other, and large enough for a camera of 640 pixels with all of them in its picture."""
        width = view.max_x - view.min_x
        side = 0.06 * max(1.0, width)
        columns = max(3, int(np.ceil(width / spacing)) + 1)
        x = np.linspace(view.min_x, view.max_x, columns)
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
        """Corners of the black squares from the top left, clockwise [m], shape (N, 4, 2)."""
        around = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * self.side_m / 2
        return self.centres[:, None] + around


@record
class Plane(FileRecord):
    """Maps between the plane of motion and one camera's picture.

    A point x [m] goes through the homography to u (in half diagonals of the picture), and from
    there to the pixel centre + half diagonal * (1 + k1 r^2 + k2 r^4) u, where r is the length of u. Pixel
    (0, 0) is the middle of the first pixel.
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
        """The reference tags that the plane was calibrated with; None if its file does not contain them."""
        values = self.provenance.get("board")
        return None if values is None else TagBoard.from_json(values)

    @property
    def half_diagonal_px(self) -> float:
        """Half the diagonal of the picture [px]."""
        return float(np.hypot(*self.size)) / 2

    def to_pixels(self, points: FloatArray) -> FloatArray:
        """Pixels of points (..., 2) [m] in the plane, shape (..., 2) [px]."""
        h = self.homography
        u = points @ h[:2, :2].T + h[:2, 2]
        return self.distort(u / (points @ h[2, :2] + h[2, 2])[..., None])

    def distort(self, u: FloatArray) -> FloatArray:
        """Pixels of points (..., 2) of the undistorted picture [half diagonals from the centre]."""
        return (
            self.centre_px + self.half_diagonal_px * self._radial_factor(u[..., 0], u[..., 1])[..., None] * u
        )

    def to_metres(self, pixels: FloatArray) -> FloatArray:
        """Points in the plane at pixels (..., 2), shape (..., 2) [m]."""
        distorted = (np.asarray(pixels, np.float64) - self.centre_px) / self.half_diagonal_px
        # Each coordinate by itself: numpy takes several times as long over an axis of two.
        start = u, v = distorted[..., 0].copy(), distorted[..., 1].copy()
        for _ in range(30):  # a contraction while the distortion is mild: a digit or more each time
            factor = self._radial_factor(u, v)
            before, (u, v) = (u, v), (start[0] / factor, start[1] / factor)
            if not any((np.abs(a - b) > 1e-13).any() for a, b in zip((u, v), before, strict=True)):  # nor NaN
                break
        u = np.stack([u, v], axis=-1)
        back = self._inverse
        points = u @ back[:2, :2].T + back[:2, 2]
        return points / (u @ back[2, :2] + back[2, 2])[..., None]

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.linalg.inv(self.homography)

    def _radial_factor(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Radial distortion at undistorted coordinates: distorted by undistorted radius, shape (...)."""
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
    def is_tilted(self) -> bool:
        """Whether the camera is tilted noticeably against the plane."""
        return self.scale[1] > _MAX_SCALE_VARIATION


class CameraPose(NamedTuple):
    """A camera in the frame of the ground: x forward in the plane, y away from the camera, z up."""

    position: FloatArray
    """Its centre of projection [m], shape (3,)."""
    rotation: FloatArray
    """Rotation from the optical frame (x right, y down, z into the picture) to the ground's, shape (3, 3)."""


def estimate_camera_pose(plane: Plane, focal: float) -> CameraPose:
    """The pose of a camera of this focal length [px], from a calibrated plane.

    The homography is a multiple of diag(f, f, 1) [r1 r2 t], with r1 and r2 the plane's axes and t its origin
    in the optical frame. The nearest rotation is taken, since noise leaves r1 and r2 not quite orthogonal.
    """
    f = focal / plane.half_diagonal_px
    h = np.diag([1 / f, 1 / f, 1.0]) @ plane.homography
    h = h / np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    if h[2, 2] + h[2, :2] @ _central_point(plane) < 0:  # the plane is in front of the camera
        h = -h
    right, up = h[:, 0], h[:, 1]
    u, _, v = np.linalg.svd(np.column_stack([right, -np.cross(right, up), up]))
    to_optical = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    return CameraPose(-to_optical.T @ h[:, 2], to_optical.T)


def _central_point(plane: Plane) -> FloatArray:
    """The point of the plane in the middle of the picture [m], shape (2,)."""
    return plane.to_metres((np.array(plane.size) - 1.0) / 2)


def to_quaternion(rotation: FloatArray) -> tuple[float, float, float, float]:
    """Quaternion x, y, z, w of a rotation matrix (3, 3), with w >= 0."""
    from scipy.spatial.transform import Rotation  # a quarter of a second, and only messages need it

    x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True).tolist()
    return x, y, z, w


def from_quaternion(x: float, y: float, z: float, w: float) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat([x, y, z, w]).as_matrix())
