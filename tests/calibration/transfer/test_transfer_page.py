"""The page and the numbers of a transfer, from made-up walks."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.parameters.springs import SpringParameters
from eldir_calibration.transfer import page
from eldir_calibration.transfer.compared_walks import TransferConfig, WalkingDesign
from eldir_calibration.transfer.page import TransferNumbers, TransferResult, write_transfer
from eldir_calibration.transfer.verdict import ExplainedWalk
from tests.calibration.transfer.made_up_walks import FALL, compared, tiny_design
from tests.paths import DATA, SCHEMAS

SCHEMA = json.loads((SCHEMAS / "transfer.schema.json").read_text())
DESIGN = tiny_design({})


def test_a_page_with_falls_ties_and_markup_in_names(tmp_path: Path) -> None:
    walks = [
        compared([0.9, 1.0, 1.1], [1.0, FALL], file="<b>.json"),
        compared([FALL, FALL, FALL], [0.2, 0.3], np.nan, file="c.json"),
        compared([0.3, 0.4, FALL], [FALL, FALL], 0.5, file="d.json"),
        compared([0.3, 0.4, 0.5], [-0.1, 0.1], 0.5, file="e.json"),
    ]
    designs = [WalkingDesign(w.file, DESIGN, w.gait, True) for w in walks]
    explained = [ExplainedWalk("<b>.json", 1, 0.5, FALL, {"pins": FALL})]
    result = TransferResult(designs, walks, explained, TransferConfig(), "MuJoCo 4")
    write_transfer(result, tmp_path / "out")
    page = re.sub('base64,[^"]+', "", (tmp_path / "out" / "transfer.html").read_text())
    assert "&lt;b&gt;.json" in page and "<b>.json" not in page and "nan" not in page and "inf" not in page
    values = json.loads((tmp_path / "out" / "transfer.json").read_text())
    jsonschema.validate(values, SCHEMA)
    assert values["walks"][1]["predicted"] == {"walks": [None] * 3, "mean": 0.0, "interval": None}
    assert values["walks"][1]["tie_share"] is None and values["walks"][1]["tied"] is False
    assert values["explained"][0]["without"] == {"pins": None}
    assert "rig_file" not in values["settings"] and "as in evolution, current limit 4 A" in page
    assert values["settings"]["current_limit_a"] == SpringParameters().current_limit


def test_the_rig_file_is_told(tmp_path: Path) -> None:
    """Two transfers of one design with other springs can be told apart."""
    walk = compared([0.9, 1.1], [1.0, 1.0], file="a.json")
    springs = SpringParameters(current_limit=3.1)
    settings = TransferConfig(springs=springs, rig_file="weak.yaml", rig_digest=64 * "b")
    designs = [WalkingDesign(walk.file, DESIGN, walk.gait, True)]
    write_transfer(TransferResult(designs, [walk], [], settings, "MuJoCo 4"), tmp_path / "out")
    found = json.loads((tmp_path / "out" / "transfer.json").read_text())["settings"]
    assert (found["rig_file"], found["rig_digest"], found["current_limit_a"]) == ("weak.yaml", 64 * "b", 3.1)
    page = (tmp_path / "out" / "transfer.html").read_text()
    assert f"of weak.yaml (SHA-256 {16 * 'b'}), current limit 3.1 A" in page


def test_ties_are_drawn_apart() -> None:
    figure = page.draw_scatter([compared([0.9, 1.1], [1.0, 1.0]), compared([0.1, 0.2], [0.0, 0.3], ties=0.9)])
    (axes,) = figure.axes
    labels = [t.get_text() for t in axes.get_legend().get_texts()]
    assert any("flagged as ties" in text for text in labels) and len(labels) == 3
    large = [line for line in axes.get_lines() if line.get_markersize() == 8]
    assert [line.get_marker() for line in large] == ["o", "D"]
    assert [tuple(map(float, (*line.get_xdata(), *line.get_ydata()))) for line in large] == [
        pytest.approx((1.0, 1.0)), pytest.approx((0.15, 0.15))
    ]  # fmt: skip


def test_a_wide_interval_does_not_make_the_robots_small() -> None:
    figure = page.draw_scatter([compared([0.0, 2.0], [1.0, -0.5]), compared([FALL, FALL], [FALL])])
    (axes,) = figure.axes
    assert axes.get_xlim() == axes.get_ylim() == pytest.approx((-0.75, 2.25))


def test_a_file_of_version_0_1_0_is_read_and_written_as_it_is(tmp_path: Path) -> None:
    old = DATA / "old" / "transfer.json"
    found = TransferNumbers.load(old)
    assert np.isnan(found.walks[1].tie_share) and found.verdict.all.walks == 4
    found.save(tmp_path / "transfer.json")
    assert (tmp_path / "transfer.json").read_bytes() == old.read_bytes()
