"""What installed packages register as entry points: relay boards, kinds of marker, problems.

A package adds one with a line in its pyproject.toml. The name on the left is the one that files and options
use. Nothing is imported until it is loaded.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from eldir.core.arguments import require_known
from eldir.errors import InputError

_Kind = TypeVar("_Kind")
_OWN = ("eldir.", "eldir_hardware.")


def registered_names(group: str) -> tuple[str, ...]:
    """The names in a group, sorted."""
    return tuple(sorted(_find(group, tuple(sys.path))))


def require_registered(group: str, name: str, what: str, remedy: str = "") -> str:
    """The name itself. Raises `InputError` where the group does not have it; does not load it. `what`: what
    the group registers, such as "kind of marker"."""
    remedy = remedy or "correct the name, or install the package that provides it"
    known = registered_names(group) or ("the name of an installed one: there is none",)
    require_known(what, name, known, remedy)
    return name


def load_registered(
    group: str, name: str, what: str, kind: type[_Kind], make: Callable[[Any], Any] = lambda found: found
) -> _Kind:
    """What a registered name stands for: `make` of the object, which must be a `kind`. Raises `InputError`
    where the group does not have it, or its package cannot be used."""
    point = _find(group, tuple(sys.path))[require_registered(group, name, what)]
    try:
        found = make(point.load())
    except (Exception, SystemExit) as error:  # another package's code runs here
        found = error
    if not isinstance(found, kind):
        raise InputError(
            f"the {what} {name} cannot be loaded from {point.value}",
            code="package.broken",
            expected=f"an object of the class {kind.__module__}.{kind.__qualname__}",
            found=f"{type(found).__name__}: {found}",
            remedy="repair or remove the package that provides it",
        )
    return found


@lru_cache(maxsize=16)
def _find(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """Entry points by name; `path` is the import path on which they were searched. Each rig file that is read
    asks for them, and a search takes longer than the reading.

    No package replaces what eldir has: `eldir rig off` must reach the board of the rig file. Of other
    packages the first one on the path counts.
    """
    points = [*entry_points(group=group)][::-1]
    points.sort(key=lambda point: point.value.startswith(_OWN))
    return {point.name: point for point in points}
