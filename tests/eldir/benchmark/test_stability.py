"""The stability benchmark: bodies at the edge, the map's two sides, and what is written."""

import json
from pathlib import Path

import jsonschema
import pytest

from eldir.benchmark import stability
from eldir.benchmark.measurement import save
from eldir.benchmark.stability import extreme_bodies, extreme_grounds
from eldir.scene import Scene
from tests.paths import SCHEMAS


def test_bodies_at_the_edge_are_what_they_are_called() -> None:
    bodies = extreme_bodies()
    assert len(bodies["triangle"].springs) == 3 and len(bodies["lattice"].springs) == 453
    assert bodies["no active spring"].motors == 0 and bodies["all active"].active.all()
    merged = bodies["coincident masses"].positions
    assert (merged[0] == merged[1]).all() and bodies["in the ground"].positions[:, 1].min() < 0.02
    assert bodies["beam"].positions[:, 0].max() > 0.5 and bodies["tower"].positions[:, 1].max() > 0.5
    assert set(extreme_grounds(Scene())) == {"no slip", "friction", "rugged", "steep", "ridge"}


def test_stability_is_written_as_its_schema_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stability, "PARTS", (0.9, 1.1))
    monkeypatch.setattr(stability, "get_args", lambda kind: ("f32",))
    monkeypatch.setattr(stability, "big", lambda n, seed=1: [extreme_bodies()["hinge"]] * min(n, 2))
    said: list[str] = []
    values = stability.measure(True, said.append)
    save(tmp_path / "out", "stability", values, stability.plot(values))
    written = json.loads((tmp_path / "out" / "stability.json").read_text())
    jsonschema.validate(written, json.loads((SCHEMAS / "benchmark-stability.schema.json").read_text()))
    assert (tmp_path / "out" / "stability.png").read_bytes().startswith(b"\x89PNG") and len(said) == 3
    printed = stability.describe(values)
    assert "passive robots" in printed and "The predicted limit holds" in printed and "FAULT" not in printed
    values["edge"][3]["flagged"] = False
    next(p for p in values["map"] if p["part"] < 1 and p["damping"] and not p["actuation"])["lasted"] = 0.5
    printed = stability.describe(values)
    assert "does NOT hold" in printed and f"{values['edge'][3]['body']!r}" in printed and "FAULT" in printed
    damped = [p for p in written["map"] if p["damping"] == 15 and p["actuation"] == 0]
    assert all(p["lasted"] == 1 for p in damped if p["part"] < 1)
    assert sum(p["lasted"] for p in damped if p["part"] > 1) < 0.5 * len(damped) / 2
    assert all(e["flagged"] and e["alone"] for e in written["edge"])
    assert {e["body"] for e in written["edge"] if e["status"] >= 0} == {"bursting"}
