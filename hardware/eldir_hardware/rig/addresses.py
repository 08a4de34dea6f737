"""Addresses that get a word of a run. They hold passwords: no log, report or message contains them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from pydantic import SecretStr

_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://\S{1,2000}")
_IN_TEXT = re.compile(r"\b([A-Za-z][A-Za-z0-9+.-]*://)(?!\.\.\.)\S+")
_USER = re.compile(r"//[^/]*@")
HIDDEN = "hidden"
MOST = 8


def checked(value: Any) -> Any:
    """What the entry `notify` says. Raises `ValueError` without what was found: it may be half an address."""
    given = [v.get_secret_value() if isinstance(v, SecretStr) else v for v in _listed(value)]
    for number, address in enumerate(given, start=1):
        if not isinstance(address, str) or not _ADDRESS.fullmatch(address):
            raise ValueError(f"address {number} is none: expected one such as mailto://user:password@host")
    return tuple(given)


def name_of(number: int, address: str) -> str:
    """How an address is called in messages: its number in the list, from 1, and its kind."""
    return f"address {number} ({address.partition('://')[0]})"


def hidden(address: str) -> str:
    """An address of which only the kind is left."""
    return f"{address.partition('://')[0]}://{HIDDEN}"


def hide_addresses(text: str) -> str:
    """A message about a rig file in which only the kind is left of whatever looks like an address."""
    return _IN_TEXT.sub(rf"\1{HIDDEN}", text)


def hide_password(url: str) -> str:
    """A camera's address without its user and password."""
    return _USER.sub(f"//{HIDDEN}@", url)


def _listed(value: Any) -> Sequence[Any]:
    if not isinstance(value, list | tuple) or len(value) > MOST:
        raise ValueError(f"expected a list of at most {MOST} addresses")
    return value
