"""Writes docs/schemas from the records that read and write the files: python docs/site/schemas.py

The pages of formats on the site are made from the schemas (format_pages.py).
"""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import benchmark_results
import results
from pydantic.json_schema import GenerateJsonSchema

from eldir.built.scene import PrintedScene
from eldir.core.validation import Plain, adapter, field_texts
from eldir.design import Design
from eldir.evolution.own.run_folder import ProblemRunFile, ProblemStatus
from eldir.evolution.paper.run_folder import RunFile
from eldir.evolution.paper.status import Status
from eldir.evolution.printed.run_folder import PrintedRunFile, PrintedStatus
from eldir.terrain import TerrainFile
from eldir.trajectory import Trajectory
from eldir_app.catalogue.facts import Notes
from eldir_cad.kit.prices import Prices
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification
from eldir_cad.packet.manifest import Manifest
from eldir_cad.shortlist.folder import Ranking
from eldir_calibration.adaptation.runs import Adaptation
from eldir_calibration.report.numbers import ReportNumbers
from eldir_calibration.transfer.page import TransferNumbers
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.plane import Plane, TagBoard
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.safety.spring_memory import SavedSprings
from eldir_hardware.schedule import ActuationSchedule

SCHEMAS = Path(__file__).parents[1] / "schemas"
FORMATS: dict[str, tuple[type, str]] = {
    "adaptation": (Adaptation, "Runs of a robot that learns on the table"),
    "benchmark-accuracy": (benchmark_results.Accuracy, "Result of eldir benchmark accuracy"),
    "benchmark-built": (benchmark_results.Built, "Result of eldir benchmark built"),
    "benchmark-device": (benchmark_results.Device, "Result of eldir benchmark speed --device"),
    "benchmark-skips": (benchmark_results.Skips, "Result of eldir benchmark skips"),
    "benchmark-speed": (benchmark_results.Speed, "Result of eldir benchmark speed"),
    "benchmark-stability": (benchmark_results.Stability, "Result of eldir benchmark stability"),
    "board": (results.Board, "A relay board that is driven or stopped"),
    "built-scene": (PrintedScene, "The printed robot as identified from films"),
    "camera": (Lens, "Lens of one camera"),
    "design": (Design, "A robot with its trained controller"),
    "info": (results.Info, "An installation"),
    "notes": (Notes, "Notes and tags of a log, beside it as LOG.notes.json"),
    "packet-manifest": (Manifest, "Contents of a build packet"),
    "plane": (Plane, "Plane of motion as one camera sees it"),
    "prices": (Prices, "Prices of what a robot and its bench need"),
    "printed-run": (PrintedRunFile, "Configuration of an evolution of printed robots"),
    "printed-status": (PrintedStatus, "Status of an evolution of printed robots"),
    "printer": (Printer, "Printer"),
    "problem-run": (ProblemRunFile, "Configuration of an evolution of an own problem"),
    "problem-status": (ProblemStatus, "Status of an evolution of an own problem"),
    "ranking": (Ranking, "Ranking of a shortlist: its designs, best first"),
    "report": (ReportNumbers, "Report of a run: three motions side by side"),
    "rig": (Rig, "Rig file"),
    "run": (RunFile, "Configuration of an evolution run"),
    "runs": (results.Runs, "Recorded runs"),
    "schedule": (ActuationSchedule, "Heating schedule"),
    "specification": (Specification, "Parts"),
    "springs": (SavedSprings, "State of a board's springs between two runs"),
    "status": (Status, "Status of an evolution"),
    "tags": (TagBoard, "Reference tags in the plane of motion"),
    "terrain": (TerrainFile, "Terrain: the ground under a robot"),
    "trajectory": (Trajectory, "Trajectory: marked masses over time"),
    "transfer": (TransferNumbers, "How well predicted walks transfer to a second physics"),
}
"""Name of each schema, the record, and the title of its page."""


class _Schema(GenerateJsonSchema):
    """Plain dataclasses as records; fields that are not compared are not in their files."""

    def dataclass_schema(self, schema: Any) -> Any:
        result, kind = super().dataclass_schema(schema), schema["cls"]
        if not issubclass(kind, Plain):
            entries, texts = result["properties"], field_texts(kind)
            result["properties"] = {
                f.name: entries[f.name] | {"description": texts[f.name]} for f in fields(kind) if f.compare
            }
            result |= {"additionalProperties": False, "required": list(result["properties"])}
        return result


def schema_text(name: str) -> str:
    """The text of a schema."""
    kind, title = FORMATS[name]
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": title}
    return (
        json.dumps(head | _without_titles(adapter(kind).json_schema(schema_generator=_Schema)), indent=1)
        + "\n"
    )


def _without_titles(values: Any) -> Any:
    """Remove the titles that pydantic makes from the names of entries."""
    if isinstance(values, list):
        return [_without_titles(value) for value in values]
    if not isinstance(values, dict):
        return values
    return {k: _without_titles(v) for k, v in values.items() if k != "title" or not isinstance(v, str)}


if __name__ == "__main__":
    for name in FORMATS:
        (SCHEMAS / f"{name}.schema.json").write_text(schema_text(name))
