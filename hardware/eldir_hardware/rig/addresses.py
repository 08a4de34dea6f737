"""Names of cameras, and addresses for notifications. Their passwords are in no log, report or message."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from pydantic import SecretStr

_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://\S{1,2000}")
_IN_TEXT = re.compile(r"\b([A-Za-z][A-Za-z0-9+.-]*://)(?!\.\.\.)\S+")
_USER = re.compile(r"//[^/]*@")
HIDDEN = "hidden"
"""What a message shows instead of the secret part of an address."""
MAX_ADDRESSES = 8
"""Number of addresses for notifications that a rig file may have."""
CAMERA_NAME = re.compile(
    r"camera:(?P<number>\d{1,3})|(?P<path>/dev/video\d+)|(?P<stream>(?i:https?|rtsp)://\S+)"
)
"""Names of cameras: camera:0, /dev/video0, or the address of a stream."""


def validate_addresses(value: Any) -> Any:
    """Validate the entry `notify`. The message of its `ValueError` does not contain the address."""
    given = [v.get_secret_value() if isinstance(v, SecretStr) else v for v in _require_list(value)]
    for number, address in enumerate(given, start=1):
        if not isinstance(address, str) or not _ADDRESS.fullmatch(address):
            raise ValueError(f"invalid address {number}: expected one such as mailto://user:password@host")
    return tuple(given)


def describe_address(number: int, address: str) -> str:
    """The name of an address in messages: its number in the list, from 1, and its kind."""
    return f"address {number} ({address.partition('://')[0]})"


def hide_address(address: str) -> str:
    """The address with only its kind visible."""
    return f"{address.partition('://')[0]}://{HIDDEN}"


def hide_addresses(text: str) -> str:
    """The message with only the kinds of all addresses in it visible."""
    return _IN_TEXT.sub(rf"\1{HIDDEN}", text)


def hide_password(url: str) -> str:
    """A camera's address without its user and password."""
    return _USER.sub(f"//{HIDDEN}@", url)


def _require_list(value: Any) -> Sequence[Any]:
    if not isinstance(value, list | tuple) or len(value) > MAX_ADDRESSES:
        raise ValueError(f"expected a list of at most {MAX_ADDRESSES} addresses")
    return value


def is_camera(name: str) -> bool:
    """Whether a name means a camera: camera:0, /dev/video0, or a stream, http://... or rtsp://..."""
    return CAMERA_NAME.fullmatch(name) is not None
