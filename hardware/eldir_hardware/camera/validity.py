"""How long a calibration is valid, and for which pictures."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from eldir.errors import InputError, damaged

LENS_DAYS = 180.0
"""Days for which a lens is valid: sooner or later somebody changes focus or zoom."""
PLANE_DAYS = 7.0
"""Days for which a plane is valid: sooner or later somebody moves the tripod."""


TURNED = ", turned by a quarter: take the files as the camera stores them, not as a program has turned them"


def valid_for(days: float) -> dict[str, str]:
    """Provenance of a calibration that is made now and is valid for so many days."""
    now = datetime.now(UTC).replace(microsecond=0)
    return {"made": now.isoformat(), "expires": (now + timedelta(days=days)).isoformat()}


def require_valid(provenance: dict[str, Any], used: datetime, name: str) -> None:
    """Raise `InputError` where a calibration had expired when a recording was made (`used`); one without a
    date never expires."""
    expires = provenance.get("expires")
    if expires is None:
        return
    try:
        end = datetime.fromisoformat(expires)
    except (TypeError, ValueError):
        raise damaged(name, "a date in expires", repr(expires)) from None
    if used > end:
        raise InputError(
            f"{name} had expired when the recording was made",
            code="camera.expired",
            expected=f"a recording before {end:%Y-%m-%d %H:%M} UTC",
            found=f"{used:%Y-%m-%d %H:%M}",
            remedy="calibrate again",
        )


def require_size(calibrated: tuple[int, int], pictures: tuple[int, int], what: str) -> None:
    """Raise `InputError` where pictures have another width and height [px] than those that `what` was
    calibrated with."""
    if calibrated != pictures:
        turned = calibrated == pictures[::-1]
        raise InputError(
            f"these pictures have another size than those of the {what} calibration",
            code="camera.other-size",
            expected=f"{calibrated[0]} x {calibrated[1]} pixels",
            found=f"{pictures[0]} x {pictures[1]}{TURNED if turned else ''}",
            remedy=f"film at the size that was calibrated, or calibrate the {what} for this one",
        )
