# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Pictures of the camera, raw and compressed, and its camera_info."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from eldir.errors import InputError
from eldir_hardware.camera.lens import Lens
from eldir_hardware.images import jpeg
from eldir_hardware.log.messages import CAMERA_FRAME_ID as FRAME_ID
from eldir_hardware.log.messages import calibration_fields
from eldir_ros.conversions import header_of


def raw_of(stamp: int, bgr: NDArray[np.uint8], frame: str = FRAME_ID) -> Image:
    """Raw picture (H, W, 3)."""
    return Image(
        header=header_of(stamp, frame),
        height=bgr.shape[0],
        width=bgr.shape[1],
        encoding="bgr8",
        is_bigendian=0,
        step=3 * bgr.shape[1],
        data=np.ascontiguousarray(bgr).tobytes(),
    )


def compressed_of(stamp: int, data: bytes, kind: str = "jpeg", frame: str = FRAME_ID) -> CompressedImage:
    """Compressed picture of JPEG or PNG bytes."""
    return CompressedImage(
        header=header_of(stamp, frame),
        format=f"bgr8; {kind} compressed bgr8",
        data=data,
    )


def info_of(
    stamp: int,
    width: int,
    height: int,
    lens: Lens | None = None,
    frame: str = FRAME_ID,
) -> CameraInfo:
    """The lens of a camera; without one all zeros: not calibrated."""
    if lens is not None:
        lens.require_size(width, height)
    fields = calibration_fields(lens)
    return CameraInfo(
        header=header_of(stamp, frame),
        width=width,
        height=height,
        **(fields | {"d": fields["d"].tolist()}),  # ROS's classes take no numpy for a sequence
    )


def info_from(message: CameraInfo) -> dict[str, Any]:
    """The fields of a lens by name, without its header, as a recorder takes them."""
    size = {name: int(getattr(message, name)) for name in ("height", "width", "binning_x", "binning_y")}
    lens = {name: np.array(getattr(message, name), np.float64) for name in ("d", "k", "r", "p")}
    region = {name: int(getattr(message.roi, name)) for name in ("x_offset", "y_offset", "height", "width")}
    region["do_rectify"] = bool(message.roi.do_rectify)
    return size | lens | {"distortion_model": message.distortion_model, "roi": region}


def picture_from(message: Image | CompressedImage) -> NDArray[np.uint8]:
    """BGR picture (H, W, 3) of a message."""
    if hasattr(message, "encoding"):
        return _raw_from(cast(Image, message))
    return jpeg.decode(np.frombuffer(message.data, np.uint8))


def _raw_from(message: Image) -> NDArray[np.uint8]:
    data: NDArray[np.uint8] = np.frombuffer(message.data, np.uint8)
    if message.encoding not in ("bgr8", "rgb8", "mono8"):
        raise InputError(
            "pictures of this encoding cannot be read",
            expected="bgr8, rgb8 or mono8",
            found=message.encoding,
            remedy="set the camera driver's output format",
        )
    depth = 1 if message.encoding == "mono8" else 3
    rows = data.reshape(message.height, message.step)[:, : depth * message.width]
    picture = rows.reshape(message.height, message.width, depth)
    if message.encoding == "rgb8":
        picture = picture[:, :, ::-1]
    return np.ascontiguousarray(np.broadcast_to(picture, (message.height, message.width, 3)))
