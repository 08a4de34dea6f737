"""What a robot and its bench cost, by the prices of the user."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from eldir_cad.kit.prices import Prices
from eldir_cad.packet.manifest import Content
from eldir_cad.packet.shopping import Item


@dataclass(frozen=True)
class Cost:
    """Sums over what has a price."""

    robot: float
    """Resin, and what is bought for the robot."""
    bench: float
    """What the bench needs, once."""
    currency: str
    """Currency of the sums."""
    unknown: tuple[str, ...]
    """Names of what has no price, in the order of the list; the sums are without it."""

    def describe(self, amount: float) -> str:
        """One of the sums; "at least" where something has no price."""
        return f"{'at least ' if self.unknown else ''}{amount:.2f} {self.currency}"

    def __str__(self) -> str:
        sums = f"robot {self.describe(self.robot)}, bench {self.describe(self.bench)}"
        return f"{sums}; without a price: {', '.join(self.unknown)}" if self.unknown else sums


def total_volume(c: Content) -> float:
    """Volume of all parts of the robot and of its ground, without supports [mm3]."""
    pieces = () if c.ground is None else c.ground.pieces
    return c.assembly.volume + sum(piece.part.volume for piece in pieces)


def resin_to_have(c: Content) -> float:
    """Mass of all parts, with supports and losses where the printer's profile has them [g]."""
    return 1e-3 * total_volume(c) * c.printer.material.density * (1 + (c.printer.extra_resin or 0.0))


def total_cost(c: Content, for_robot: Sequence[Item], for_bench: Sequence[Item], prices: Prices) -> Cost:
    """Sums for the robot and for the bench. Without `extra_resin` in the printer's profile, the resin of
    supports has no known price."""
    unknown = [] if prices.resin_kg is not None else ["resin"]
    if prices.resin_kg is not None and c.printer.extra_resin is None:
        unknown.append("resin of supports")
    unknown += [item.name for item in (*for_robot, *for_bench) if item.name not in prices.items]
    resin = 1e-3 * resin_to_have(c) * (prices.resin_kg or 0.0)
    return Cost(resin + _sum(for_robot, prices), _sum(for_bench, prices), prices.currency, tuple(unknown))


def _sum(items: Sequence[Item], prices: Prices) -> float:
    return sum(prices.cost_of(item.name, item.count) or 0.0 for item in items)
