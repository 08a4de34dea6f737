"""Finding equal robots in a batch, so that each is simulated once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import fields
from hashlib import blake2b
from typing import Any

import numpy as np

from eldir.controller import Controller
from eldir.morphology import Morphology
from eldir.physics import Physics


def distinct(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller | tuple[int, ...]],
    physics: Sequence[Physics],
) -> tuple[list[int], list[int]]:
    """Indices of the first robot of each group of equal robots; and for every robot the index of its group.
    A controller may be given by its seed."""
    origins = [_digest(brain) if isinstance(brain, Controller) else brain for brain in controllers]
    repeated = {origin for origin, count in Counter(origins).items() if count > 1}
    first: list[int] = []
    seen: dict[Any, int] = {}
    which = []
    for i, (body, origin, own) in enumerate(zip(morphologies, origins, physics, strict=True)):
        robot = (_digest(body), _digest(own), origin) if origin in repeated else origin
        known = seen.setdefault(robot, len(first))
        if known == len(first):
            first.append(i)
        which.append(known)
    return first, which


def _digest(record: Morphology | Controller | Physics) -> bytes:
    digest = blake2b(digest_size=16)
    for field in fields(record):
        array = np.ascontiguousarray(getattr(record, field.name))
        digest.update(repr(array.shape).encode())
        digest.update(array.data)
    return digest.digest()
