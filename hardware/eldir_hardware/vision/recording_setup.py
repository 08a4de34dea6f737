"""The setup of a recording, from its attachments: tags, lens and plane of its camera, and its design."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir_hardware.camera.lens import Lens, require_not_expired
from eldir_hardware.camera.plane import Image, Plane, TagBoard
from eldir_hardware.camera.plane_fit import WrongLensError, calibrate_plane
from eldir_hardware.camera.tags import DriftMonitor
from eldir_hardware.log.mcap_file import iter_messages
from eldir_hardware.log.messages import CAMERA_INFO
from eldir_hardware.log.reader import read_attachment
from eldir_hardware.markers.registration import DEFAULT_KIND, require_kind
from eldir_hardware.rig.addresses import is_camera
from eldir_hardware.vision.sources import LoggedFrames, Source, open_source, recording_time

REPORTED_KEY = "reported_by"
"""In a lens's provenance: the message that it comes from, which tells no errors."""
CALIBRATION_FRAMES = 10
"""Number of frames whose mean gives the plane, so that noise at the tags' corners averages out."""
_UNCHECKED = (
    "The first picture does not show the reference tags: whether the camera moved since plane.json was "
    "calibrated is unknown."
)


def calibrate_from_frames(source: Source, board: TagBoard, **extra: str) -> Plane:
    """Calibrate the plane of motion from the first frames of a source and the lens that a log keeps; `extra`
    is added to its provenance."""
    images = [image for _, image in islice(source, CALIBRATION_FRAMES)]
    provenance = {"source": source.name, **extra}
    return calibrate_with_recorded_lens(images, board, provenance, find_recorded_lens(source))


def calibrate_with_recorded_lens(
    images: Iterable[Image], board: TagBoard, provenance: dict[str, Any], lens: Lens | None
) -> Plane:
    """As `calibrate_plane`, with the lens that the pictures' log keeps. If it belongs to another camera, only
    the tags are used, and the plane's provenance holds a remark."""
    images = list(images)
    try:
        return calibrate_plane(images, board, provenance, lens)
    except WrongLensError as error:
        remark = {"remark": f"The log's lens is not used: {error}."}
        return calibrate_plane(images, board, provenance | remark)


def read_attached_board(source: Source) -> TagBoard | None:
    """The places of the reference tags that are attached to a log; None without."""
    return read_attachment(source.attachments, source.name, "tags.json", TagBoard.from_json)


def find_recorded_lens(source: Source) -> Lens | None:
    """The calibrated lens that a log keeps, as a file or as its camera reported it; None for every other
    source. Raises `InputError` if the file has expired."""
    lens = read_attachment(source.attachments, source.name, "camera.json", Lens.from_json)
    if lens is not None:
        require_not_expired(lens.provenance, recording_time(source), f"camera.json in {source.name}")
        return lens
    return _read_reported_lens(source) if isinstance(source, LoggedFrames) else None


def find_recorded_plane(source: Source) -> Plane:
    """The plane that is attached to a log, or else a plane calibrated from its tags, pictures and lens.

    If the tags show that the camera had moved, or that the lens belongs to another camera, only the tags
    are used, and the plane's provenance holds a remark; so it does where the first picture does not show the
    tags. Raises `InputError` without plane and tags.
    """
    plane = read_attachment(source.attachments, source.name, "plane.json", Plane.from_json)
    board = read_attached_board(source)
    extra = {}
    if plane is not None:
        require_not_expired(plane.provenance, recording_time(source), f"plane.json in {source.name}")
        unmoved = True if board is None else _is_unmoved(source, plane)
        if unmoved is None:
            remarks = filter(None, (plane.provenance.get("remark"), _UNCHECKED))
            return replace(plane, provenance=plane.provenance | {"remark": " ".join(remarks)})
        if unmoved:
            return plane
        extra["remark"] = (
            "The camera had moved since plane.json was calibrated: the log's own tags give the plane."
        )
    if board is None:
        raise InputError(
            f"{source.name} has neither a plane of motion nor reference tags",
            code="film.no-plane",
            expected="at least four reference tags in the picture",
            remedy="track it with eldir track and --tags, the places of the tags, or a calibrated --plane",
        )
    return calibrate_from_frames(source, board, **extra)


def _is_unmoved(source: Source, plane: Plane) -> bool | None:
    """Whether the reference tags of the first picture are at their calibrated places; None if fewer than
    three of them are seen."""
    t, image = next(iter(source))
    plane.require_size(image.shape[1], image.shape[0])
    if plane.board is None:
        return True
    tags = DriftMonitor(plane, plane.board)
    try:
        tags.check(image, t)
    except InputError:
        return False
    return None if math.isnan(tags.max_shift) else True


def read_attached_design(source: Source) -> Design | None:
    """The design that is attached to a log; None without."""
    return read_attachment(source.attachments, source.name, "design.json", Design.from_json)


def read_attached_layout(source: Source) -> FloatArray | None:
    """Places of the markers in the design that is attached to a log, shape (K, 2) [m]; None without
    design."""
    design = read_attached_design(source)
    return None if design is None else marker_layout(design)


def read_marker_kind(attachments: dict[str, bytes], name: str | Path) -> str:
    """The kind of marker that the rig file among a log's attachments names; discs where it names none."""
    kind = read_attachment(attachments, name, "rig.yaml", lambda rig: rig.get("marker"))
    return require_kind(str(kind or DEFAULT_KIND))


def marker_layout(design: Design) -> FloatArray:
    """Positions of m1, m2, ... on the printed robot, up to a shift [m], shape (K, 2)."""
    return design.morphology.positions[design.marks] * BuiltParameters().scale


def load_recorded_lens(source: str) -> Lens | None:
    """As `find_recorded_lens`, for the name of a source, which may be a camera."""
    return None if is_camera(source) else find_recorded_lens(open_source(source))


def _read_reported_lens(source: LoggedFrames) -> Lens | None:
    """The lens in a log's CameraInfo; None if it is not calibrated, or for pictures of another size.

    The message has no deviations: they are as large as the values, so that nobody takes the lens for an
    accurate one."""
    for _, _, info in iter_messages(source.log.path, [CAMERA_INFO]):
        if info.k[0] > 0 and info.distortion_model == "plumb_bob" and len(info.d) == 5:
            shown = next((image.shape[1::-1] for _, image in source), None)
            if shown != (info.width, info.height):
                return None
            focal, size = np.array([info.k[0], info.k[4]]), np.array([info.width, info.height])
            return Lens(
                width_px=info.width,
                height_px=info.height,
                focal_px=focal,
                focal_deviation_px=focal,
                centre_px=np.array([info.k[2], info.k[5]]),
                centre_deviation_px=size.astype(float),
                distortion=np.array(info.d),
                distortion_deviation=np.ones(5),
                rms_px=float(size.max()),
                rms_interval_px=(0.0, float(size.max())),
                provenance={REPORTED_KEY: f"camera_info of {source.log.path.name}"},
            )
    return None
