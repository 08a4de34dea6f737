"""What a workshop pays for resin and for what it buys, as a data file of the user."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from eldir.core.validation import Section
from eldir_cad.kit.specification import load_section

ItemName = Literal[
    "shape_memory_spring",
    "marker",
    "ballast",
    "supply_output",
    "fuse",
    "relay_board",
    "timer_relay",
    "main_switch",
    "fan",
    "fan_interlock",
    "lead",
    "bench_wire",
    "ferrule",
    "terminal",
    "test_resistor",
]
ITEM_NAMES: tuple[str, ...] = get_args(ItemName)
"""What is bought for robot and bench, by the names of bom.csv."""

Price = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]


class Prices(Section):
    """Prices of what a robot and its bench need."""

    format: Literal["eldir-prices/1"]
    """Format of this file."""
    currency: Annotated[str, Field(pattern=r"^[A-Za-z$€£¥]{1,8}$")]
    """Currency of all prices, such as EUR."""
    resin_kg: Price | None = None
    """Price of a kilogram of resin. Default: not known."""
    items: dict[ItemName, Price] = Field(default_factory=dict)
    """Price of a piece, of wire of a metre, by the name of bom.csv. What is not named has no known price."""

    def cost_of(self, name: ItemName, count: int) -> float | None:
        """Price of so many pieces or metres; None if it is not known."""
        each = self.items.get(name)
        return None if each is None else count * each


def load_prices(path: Path) -> Prices:
    """Read a file with prices. Raises `InputError` that names the invalid entry."""
    return load_section(path, Prices)
