"""Writes the tables of parameters into docs/reference/dynamics.md, from the fields of the printed robot's
records: python docs/site/parameters.py
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from math import hypot
from pathlib import Path

from eldir.core.validation import field_texts
from eldir.parameters.annotations import LargeSpread, Tolerance, field_annotations
from eldir.parameters.printed import BuiltParameters
from eldir.parameters.springs import SpringParameters
from eldir.parameters.uncertain import PARAMETERS, UncertainParameter

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "dynamics.md"
HEADS = (
    "| parameter | standard deviation | changes | reason |\n| --- | --- | --- | --- |\n",
    "| field | prior | robots of one print | springs of one robot | `parameter_spread: large` |\n"
    "| --- | --- | --- | --- | --- |\n",
)


def page_text() -> str:
    """The page, with the tables as the records have them."""
    text = PAGE.read_text(encoding="utf-8")
    for head, rows in zip(HEADS, (_parameters(), _fields()), strict=True):
        table = head + "".join(f"| {' | '.join(row)} |\n" for row in rows)
        text, found = re.subn(re.escape(head) + r"(\|.*\n)*", lambda _, table=table: table, text)
        if found != 1:
            raise ValueError(f"{PAGE.name} has no table that begins with {head.splitlines()[0]}")
    return text


def _parameters() -> Iterator[list[str]]:
    for parameter in PARAMETERS.values():
        changes = (
            f"`{field}`" if power == 1 else f"`{field}` (power {power:g})"
            for field, power in parameter.powers.items()
        )
        yield [f"`{parameter.name}`", _spread(parameter), ", ".join(changes), parameter.reason]


def _fields() -> Iterator[list[str]]:
    for record in (BuiltParameters, SpringParameters):
        large = dict(field_annotations(record, LargeSpread))
        for name in (field.name for field in fields(record)):
            found = re.search(r"\[(.+?)\]", field_texts(record)[name])
            unit = found[1] if found else ""
            own = [p for p in PARAMETERS.values() if name in p.powers]
            cells = [
                _prior(name, own),
                "; ".join(_tolerance(t, unit) for n, t in field_annotations(record, Tolerance) if n == name),
                "".join(_spread(p, p.between_springs) for p in own if p.between_springs is not None),
                f"{100 * large[name].low:g} to {100 * large[name].high:g} %" if name in large else "",
            ]
            if any(cells):
                yield [f"`{name}` [{unit}]" if unit else f"`{name}`", *cells]


def _prior(field: str, parameters: list[UncertainParameter]) -> str:
    """Standard deviation that all parameters together give the field."""
    if any(p.additive for p in parameters):
        return ", ".join(map(_spread, parameters))
    total = hypot(*(p.spread * p.powers[field] for p in parameters))
    return f"{100 * total:.2g} %" if total else ""


def _spread(parameter: UncertainParameter, spread: float | None = None) -> str:
    value = parameter.spread if spread is None else spread
    return f"{value:g} K" if parameter.additive else f"{100 * value:g} %"


def _tolerance(tolerance: Tolerance, unit: str) -> str:
    text = f"{100 * tolerance.spread:g} %"
    if tolerance.form == "absolute":
        text = {"C": f"{tolerance.spread:g} K", "m": f"{1e3 * tolerance.spread:g} mm"}[unit]
    text = f"at most {text}" if tolerance.form == "uniform" else text
    text += f" of `{tolerance.attribute}`" if tolerance.attribute else ""
    text += ", in common" if tolerance.shared else ""
    return f"with {tolerance.joints} {text}" if tolerance.joints else text


if __name__ == "__main__":
    PAGE.write_text(page_text(), encoding="utf-8")
