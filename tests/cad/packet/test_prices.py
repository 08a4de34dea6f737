"""Prices of the user: sums by hand, what has no price is named, and list and page agree."""

import csv
import io
from dataclasses import replace

import pytest

from eldir.core.yaml_files import dump_yaml
from eldir.design import Ballast, Variant
from eldir.errors import InputError
from eldir.parameters.wiring import wiring
from eldir_cad.checks.buildability import check
from eldir_cad.kit.prices import ITEM_NAMES, Prices, load_prices
from eldir_cad.kit.printer import fit_to_printer, load_printer
from eldir_cad.kit.specification import load_specification
from eldir_cad.packet._kit import draw_kit
from eldir_cad.packet._tables import bill_of_materials
from eldir_cad.packet.cost import resin_to_have, total_cost
from eldir_cad.packet.manifest import make_content
from eldir_cad.packet.shopping import bench_items, parts_to_buy
from tests.cad.drawn_bodies import WHEEL, design

PRINTER = load_printer()
SPEC = fit_to_printer(load_specification(), PRINTER)
ALL = dict.fromkeys(ITEM_NAMES, 2.5)
LEAD = 210


@pytest.fixture(scope="module")
def robot():
    """A wheel with two motors and a ballast, so that everything is bought."""
    drawn = design(*WHEEL, motors=(0, 4))
    report = check(drawn.morphology, SPEC, PRINTER)
    return make_content(replace(drawn, variant=Variant(None, Ballast(11.0, 6))), report, SPEC, PRINTER)


def lists(robot):
    return parts_to_buy(robot), bench_items(robot, wiring(2), LEAD)


def with_extra_resin(robot, share):
    return replace(robot, printer=PRINTER.model_copy(update={"extra_resin": share}))


def page_of(robot, prices):
    figures = draw_kit(robot, wiring(2), LEAD, prices)
    return " ".join(" ".join(text.get_text() for page in figures for text in page.texts).split())


def test_every_item_that_is_bought_may_have_a_price_and_no_other(robot):
    assert [item.name for items in lists(robot) for item in items] == list(ITEM_NAMES)


def test_sums_by_hand(robot):
    """Four coils of 30, six metres of lead of 2; resin of 100 a kilogram with half as much again."""
    prices = Prices(
        format="eldir-prices/1", currency="EUR", resin_kg=100.0,
        items={"shape_memory_spring": 30.0, "lead": 2.0},
    )  # fmt: skip
    half = with_extra_resin(robot, 0.5)
    resin = 1.5 * 1e-6 * robot.assembly.volume * 1.15
    cost = total_cost(half, *lists(half), prices)
    assert cost.robot == pytest.approx(120.0 + 100.0 * resin)
    assert cost.bench == pytest.approx(12.0)
    assert cost.unknown == tuple(n for n in ITEM_NAMES if n not in ("shape_memory_spring", "lead"))
    told = page_of(half, prices)
    assert f"Robot: at least {cost.robot:.2f} EUR" in told
    assert f"have {1e3 * resin:.1f} g ready" in told and "Bench, once: at least 12.00 EUR." in told
    assert "120.00 EUR" in told and "Without a price, and not in these sums: marker, ballast, " in told


def test_rows_of_the_list_add_up_to_the_sums(robot):
    prices = Prices(format="eldir-prices/1", currency="CHF", resin_kg=180.0, items=ALL)
    known = with_extra_resin(robot, 0.3)
    cost = total_cost(known, *lists(known), prices)
    assert cost.unknown == ()
    text = bill_of_materials(known, [i for items in lists(known) for i in items], prices)
    rows = list(csv.DictReader(io.StringIO(text)))
    total = sum(float(row["price_CHF"]) for row in rows)
    assert total == pytest.approx(cost.robot + cost.bench, abs=0.005 * len(rows) + 1e-9)
    weighed = sum(float(row["weight_g"]) * int(row["count"]) for row in rows if row["weight_g"])
    assert weighed == pytest.approx(resin_to_have(known), abs=0.0005 * sum(int(r["count"]) for r in rows))
    told = page_of(known, prices)
    assert "at least" not in told.split("Cost")[1].split("Bench, once")[0] and "Without a price" not in told


def test_what_is_not_known_is_said(robot):
    """A price of the resin says nothing of the supports, and a sum of nothing is not told as the cost."""
    prices = Prices(format="eldir-prices/1", currency="EUR", resin_kg=180.0, items=ALL)
    assert total_cost(robot, *lists(robot), prices).unknown == ("resin of supports",)
    none = Prices(format="eldir-prices/1", currency="EUR")
    cost = total_cost(robot, *lists(robot), none)
    assert (cost.robot, cost.bench, cost.unknown) == (0.0, 0.0, ("resin", *ITEM_NAMES))
    assert "at least 0.00 EUR" in page_of(robot, none)
    assert "Cost" not in page_of(robot, None) and "price" not in bill_of_materials(robot, [])


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"items": {"fuze": 1.0}}, "fuze"),
        ({"items": {"fuse": -1.0}}, "fuse"),
        ({"items": {"fuse": "1 EUR"}}, "fuse"),
        ({"currency": "EUR,\n"}, "currency"),
        ({"resin": 1.0}, "resin"),
        ({"format": "eldir-prices/9"}, "format"),
    ],
)
def test_a_wrong_file_of_prices_gives_one_line(tmp_path, change, key):
    path = tmp_path / "prices.yaml"
    path.write_text(dump_yaml({"format": "eldir-prices/1", "currency": "EUR"} | change))
    with pytest.raises(InputError, match=key) as caught:
        load_prices(path)
    told = str(caught.value)
    assert "\n" not in told and str(path) in told and "[key]" not in told
