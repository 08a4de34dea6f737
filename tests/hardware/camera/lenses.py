"""A lens with given values and an unimportant quality."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from eldir_hardware.camera.lens import Lens


def lens_of(
    size: tuple[int, int],
    focal: ArrayLike,
    centre: ArrayLike,
    distortion: ArrayLike,
    provenance: dict[str, Any] | None = None,
) -> Lens:
    """The lens of pictures of a size."""
    values: Any = dict(focal_px=focal, centre_px=centre, distortion=distortion)
    values |= {name: [0.1] * 2 for name in ("focal_deviation_px", "centre_deviation_px")}
    values |= dict(distortion_deviation=[0.1] * 5, rms_px=0.2, rms_interval_px=(0.1, 0.3))
    return Lens(*size, **values, provenance=provenance or {})
