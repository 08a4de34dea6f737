"""What a calibration holds for: pictures of one size, and until lenses are refocused and tripods moved."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

from eldir.errors import InputError


def valid_for(days: float) -> dict[str, str]:
    """Provenance of what is made now and holds for so many days."""
    now = datetime.now(UTC).replace(microsecond=0)
    return {"made": now.isoformat(), "expires": (now + timedelta(days=days)).isoformat()}


def require_valid(provenance: dict[str, Any], used: datetime, name: str) -> None:
    """Refuse a calibration that had expired when a recording was made; one without a date never does."""
    expires = provenance.get("expires")
    if expires is None:
        return
    try:
        end = datetime.fromisoformat(expires)
    except (TypeError, ValueError):
        raise InputError(f"{name} is damaged", expected="a date in expires", found=repr(expires)) from None
    if used > end:
        raise InputError(
            f"{name} had expired when the recording was made",
            expected=f"a recording before {end:%Y-%m-%d %H:%M} UTC",
            found=f"{used:%Y-%m-%d %H:%M}",
            remedy="calibrate again",
        )


def require_size(calibrated: tuple[int, int], pictures: tuple[int, int], what: str) -> None:
    """Refuse pictures of another width and height [px] than those that `what` was calibrated with."""
    if calibrated != pictures:
        raise InputError(
            f"these pictures are of another size than those of the {what} calibration",
            expected=f"{calibrated[0]} x {calibrated[1]} pixels",
            found=f"{pictures[0]} x {pictures[1]}",
            remedy=f"film in the setting that was calibrated, or calibrate the {what} for this one",
        )
