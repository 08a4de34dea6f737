"""Elements and numbers of an MJCF file."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from eldir.core.records import FloatArray


def add(parent: Element, tag: str, **attributes: str) -> Element:
    """A new element in `parent`."""
    return SubElement(parent, tag, dict(attributes))


def text_of(values: FloatArray | Sequence[float]) -> str:
    """Numbers as MJCF writes them."""
    return " ".join(f"{float(value):.12g}" for value in values)
