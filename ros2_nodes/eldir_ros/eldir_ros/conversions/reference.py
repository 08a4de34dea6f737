# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The reference tags of a rig, and the plane of motion that they give."""

from __future__ import annotations

from typing import Any

import numpy as np
from eldir_msgs.msg import MotionPlane, ReferenceTag, ReferenceTags
from geometry_msgs.msg import Point

from eldir_hardware.camera.plane import Plane, Tag, TagBoard
from eldir_hardware.log.messages import FRAME_ID
from eldir_hardware.vision.pipeline import FIRST_PICTURE_KEY
from eldir_ros.conversions import header_of, nanoseconds

_TEXTS = {"source": "source", "eldir": "version", "made": "date", "expires": "expiry", "remark": "remark"}
"""Entries of a plane's provenance that are texts, with the names of their fields in the message."""


def tags_of(board: TagBoard, frame: str = FRAME_ID) -> ReferenceTags:
    """The message of the reference tags."""
    return ReferenceTags(
        header=header_of(0, frame),
        dictionary=board.dictionary,
        side=float(board.side_m),
        tags=[
            ReferenceTag(id=tag.id, position=Point(x=float(tag.x_m), y=0.0, z=float(tag.y_m)))
            for tag in board.tags
        ],
    )


def tags_from(message: ReferenceTags) -> TagBoard:
    """The reference tags in a message; raises `InputError` for impossible ones."""
    tags = tuple(Tag(int(t.id), float(t.position.x), float(t.position.z)) for t in message.tags)
    return TagBoard(message.dictionary, float(message.side), tags)


def plane_of(plane: Plane, frame: str = FRAME_ID) -> MotionPlane:
    """The message of a plane of motion."""
    origin = plane.provenance
    fields: dict[str, Any] = {field: str(origin.get(key, "")) for key, field in _TEXTS.items()}
    if plane.board is not None:
        fields["tags"] = tags_of(plane.board, frame)
    return MotionPlane(
        header=header_of(int(origin.get(FIRST_PICTURE_KEY, 0)), frame),
        height=plane.height_px,
        width=plane.width_px,
        homography=plane.homography.ravel(),
        centre=plane.centre_px,
        radial=plane.radial,
        rms=float(plane.rms_px),
        pictures=int(origin.get("pictures", 0)),
        visible_tags=[int(tag) for tag in origin.get("tags", ())],
        **fields,
    )


def plane_from(message: MotionPlane) -> Plane:
    """The plane of motion in a message; raises `InputError` for an impossible one."""
    origin: dict[str, Any] = {}
    if len(message.visible_tags):
        origin |= {"tags": [int(t) for t in message.visible_tags], "pictures": int(message.pictures)}
    if message.tags.dictionary:
        origin["board"] = tags_from(message.tags).to_json()
    origin |= {key: getattr(message, field) for key, field in _TEXTS.items() if getattr(message, field)}
    if first := nanoseconds(message.header.stamp):
        origin[FIRST_PICTURE_KEY] = first
    return Plane(
        int(message.width),
        int(message.height),
        np.array(message.homography, float).reshape(3, 3),
        np.array(message.centre, float),
        np.array(message.radial, float),
        float(message.rms),
        origin,
    )
