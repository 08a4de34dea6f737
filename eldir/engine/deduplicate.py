"""Which designs are the same ones: they need not be simulated twice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from hashlib import blake2b

import numpy as np

from eldir.controller import Controller
from eldir.morphology import Morphology
from eldir.physics import Physics


def distinct(
    morphologies: Sequence[Morphology],
    controllers: Sequence[Controller | tuple[int, ...]],
    physics: Sequence[Physics],
) -> tuple[list[int], list[int]]:
    """Indices of robots that differ, each the first of its kind; and for every robot, which of those it
    is. A controller may be given by its seed."""
    first: list[int] = []
    seen: dict[bytes, int] = {}
    which = []
    for i, (body, brain, own) in enumerate(zip(morphologies, controllers, physics, strict=True)):
        origin = _digest(brain) if isinstance(brain, Controller) else repr(brain).encode()
        known = seen.setdefault(_digest(body) + _digest(own) + origin, len(first))
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
