"""The setup of a recording, from its attachments: tags, lens and plane of its camera, and its design."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.errors import InputError
from eldir.parameters.printed import BuiltParameters
from eldir_hardware.camera.drift import DriftWatch
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.camera.tags import WrongLensError, calibrate_plane
from eldir_hardware.camera.validity import require_valid
from eldir_hardware.log.attachments import read_attachment
from eldir_hardware.markers.registration import DEFAULT, require_kind
from eldir_hardware.vision.sources import Source, recorded_at

CALIBRATION_FRAMES = 10
"""Number of frames whose mean gives the plane, so that noise at the tags' corners averages out."""


def plane_from_frames(source: Source, board: TagBoard, lens: Lens | None = None, **extra: str) -> Plane:
    """Calibrate the plane of motion from the first frames of a source; `extra` is added to its provenance."""
    images = [image for _, image in islice(source, CALIBRATION_FRAMES)]
    return calibrate_plane(images, board, {"source": source.name, **extra}, lens)


def attached_board(source: Source) -> TagBoard | None:
    """The places of the fixed tags that are attached to a log; None without."""
    return read_attachment(source.attachments, source.name, "tags.json", TagBoard.from_json)


def attached_lens(source: Source) -> Lens | None:
    """The calibrated lens that is attached to a log; None without. Raises `InputError` if it has expired."""
    lens = read_attachment(source.attachments, source.name, "camera.json", Lens.from_json)
    if lens is not None:
        require_valid(lens.provenance, recorded_at(source), f"camera.json in {source.name}")
    return lens


def recorded_plane(source: Source) -> Plane:
    """The plane that is attached to a log, or else the one that its own tags, pictures and lens give.

    If the tags show that the camera had moved, or that the lens belongs to another camera, only the tags
    are used, and the plane's provenance holds a remark. Raises `InputError` without plane and tags.
    """
    plane = read_attachment(source.attachments, source.name, "plane.json", Plane.from_json)
    board = attached_board(source)
    extra = {}
    if plane is not None:
        require_valid(plane.provenance, recorded_at(source), f"plane.json in {source.name}")
        if board is None or _stands(source, plane):
            return plane
        extra["remark"] = (
            "The camera had moved since plane.json was calibrated: the log's own tags give the plane."
        )
    if board is None:
        raise InputError(
            f"{source.name} does not say where the plane of motion is",
            code="film.no-plane",
            expected="at least four fixed tags in the picture",
            remedy="give their places with --tags, or give a calibrated --plane",
        )
    try:
        return plane_from_frames(source, board, attached_lens(source), **extra)
    except WrongLensError as error:
        return plane_from_frames(source, board, remark=f"camera.json is not used: {error}.")


def _stands(source: Source, plane: Plane) -> bool:
    """Whether the fixed tags of the first picture are at their places in the plane."""
    t, image = next(iter(source))
    plane.require_size(image.shape[1], image.shape[0])
    try:
        if plane.board is not None:
            DriftWatch(plane, plane.board).look(image, t)
    except InputError:
        return False
    return True


def attached_layout(source: Source) -> FloatArray | None:
    """Places of the marks in the design that is attached to a log, shape (K, 2) [m]; None without design."""
    design = read_attachment(source.attachments, source.name, "design.json", Design.from_json)
    return None if design is None else layout_of(design)


def attached_marker(source: Source) -> str:
    """The kind of marker that the rig file of a log names; discs where it names none."""
    return marker_of(source.attachments, source.name)


def marker_of(attachments: dict[str, bytes], name: str | Path) -> str:
    """The kind of marker that the rig file among a log's attachments names; discs where it names none."""
    kind = read_attachment(attachments, name, "rig.yaml", lambda rig: rig.get("marker"))
    return require_kind(str(kind or DEFAULT))


def layout_of(design: Design) -> FloatArray:
    """Places of m1, m2, ... on the robot as built, up to a shift [m], shape (K, 2)."""
    return design.morphology.positions[design.marks] * BuiltParameters().scale
