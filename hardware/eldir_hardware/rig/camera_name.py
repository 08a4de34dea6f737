"""Names of cameras: a device of this computer, or a network stream."""

from __future__ import annotations

import re

CAMERA = re.compile(r"camera:(?P<number>\d{1,3})|(?P<path>/dev/video\d+)|(?P<stream>(?i:https?|rtsp)://\S+)")


def is_camera(name: str) -> bool:
    """Whether a name means a camera: camera:0, /dev/video0, or a stream, http://... or rtsp://..."""
    return CAMERA.fullmatch(name) is not None
