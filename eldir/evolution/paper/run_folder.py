"""The run folder of an evolution in the paper's scene: losses, learned weights, and parts of a generation.

    survivors-0003.parquet    the last population, best first, with the learned weights; and the one before
    part-0004-000000.parquet  robots of the present generation that have learned

Other files are as in `eldir.evolution.run_folder`. Resuming starts after the last complete generation, with
the parts of the next one.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from eldir.core.files import write_bytes
from eldir.core.kernels import Device
from eldir.core.records import FileRecord, IntArray, record
from eldir.core.version import __version__
from eldir.engine.device.process import chosen_device
from eldir.evolution import tables
from eldir.evolution.paper import robot_tables, status
from eldir.evolution.paper.configuration import EvolutionConfig
from eldir.evolution.paper.encoding import make_encoding
from eldir.evolution.paper.learning import LearningBatch
from eldir.evolution.paper.population import Robot, is_valid
from eldir.evolution.paper.problem import PaperProblem
from eldir.evolution.problem import Batch
from eldir.evolution.run_folder import GenerationsFolder, RunFileHeader
from eldir.evolution.search import Generation, Search
from eldir.evolution.workers import Workers, workers_on

_logger = logging.getLogger(__name__)


@record
class RunFile(RunFileHeader):
    """The file run.json of an evolution."""

    FORMAT = "eldir-run/1"
    OPTIONAL = frozenset({"device"})
    """What older runs lack."""

    config: EvolutionConfig
    """The configuration: the same values give the same robots."""
    device: Device = "cpu"
    """Where the robots of the first generation began to learn: cpu, cuda or vulkan. Devices and processors
    differ in the last digits."""


@dataclass(frozen=True)
class RunFolder(GenerationsFolder[EvolutionConfig, Robot]):
    """The folder of an evolution in the paper's scene."""

    device: Device = field(default_factory=chosen_device, compare=False)
    """Where the robots learned when the run was started: cpu, cuda or vulkan."""

    FILE = RunFile
    COMPLETES = "survivors"

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open an existing folder. Raises `InputError` with the missing or damaged file."""
        file = cls.FILE.load(path / "run.json")
        return cls(path, file.config, file.source, file.device)

    def _file(self) -> FileRecord:
        return RunFile(__version__, self.source, self.config, self.device)

    def problem(self, *conditions: Any) -> PaperProblem:
        return PaperProblem(self.config, *conditions)

    def columns(self, generation: Generation[Robot]) -> tuple[dict[str, Any], dict[str, Any]]:
        learned, kept, encoding = generation.tried, generation.elites, make_encoding(self.config)
        losses = [r.losses for r in learned]
        born = robot_tables.robots_columns(learned, encoding)
        born |= {"losses": tables.lists(losses, np.float64)}
        born |= {"valid": is_valid(np.stack(losses), self.config.training.jump_threshold)}
        born |= robot_tables.flag_columns(learned)
        alive = robot_tables.robots_columns(kept, encoding)
        alive |= robot_tables.outcome_columns(kept, self.config.scene.precision)
        if self.config.second_stage:
            born["walk"], alive["walk"] = (
                [np.nan if r.walk is None else r.walk for r in robots] for robots in (learned, kept)
            )
        return born, alive

    def read_elites(self, path: Path) -> list[Robot]:
        return robot_tables.read_learned(path, self.config.lattice, make_encoding(self.config))

    def status(self, common: dict[str, Any]) -> status.Status:
        return status.describe_run(self, common)

    def progress_line(self, search: Search[Robot]) -> str:
        return status.progress_line(search)

    def workers(self) -> Workers:
        """By `ELDIR_DEVICE`. Logs a warning where a run began on another device."""
        device = chosen_device()
        if device != self.device:
            _logger.warning(
                f"{self.path} began to learn on {self.device} and continues on {device}: "
                "results differ in the last digits from those of one device"
            )
        _logger.info("robots learn on %s", device)
        return workers_on(device)

    def parts(self, generation: int) -> list[Path]:
        """Files of the robots of an incomplete generation that have learned."""
        return sorted(self.path.glob(f"part-{generation:04d}-*.parquet"))

    def read_parts(self, batch: Batch) -> list[tuple[IntArray, list[Robot]]]:
        if not isinstance(batch, LearningBatch):
            return []
        paths = self.parts(batch.robots[0].number // self.config.population)
        return [robot_tables.read_part(path, batch.robots, self.config.iterations) for path in paths]

    def save_part(self, result: list[Robot]) -> None:
        ids = np.array([r.number for r in result], np.int64)
        generation, first = divmod(int(ids.min()), self.config.population)
        columns = {"id": ids, **robot_tables.outcome_columns(result, self.config.scene.precision)}
        write_bytes(
            self.path / f"part-{generation:04d}-{first:06d}.parquet",
            tables.to_bytes(columns, "eldir-part/1"),
        )

    def _remove_outdated(self) -> None:
        """Also the parts of complete generations."""
        super()._remove_outdated()
        for generation, _ in self.complete_generations():
            for part in self.parts(generation):
                part.unlink()


def load_generation(path: Path | str, generation: int) -> dict[str, np.ndarray]:
    """Every robot evaluated in a generation: id, parents (N, 2), seed, triangles (N, B, A),
    springs (N, S), losses (N, iterations + 1), valid, and walk, chaotic_updates and rounded_updates
    (`Robot`), in order of id."""
    run = RunFolder.open(Path(path))
    file = run.generation_file(generation)
    table = tables.read(file)
    try:
        triangles, springs = tables.genotype_columns(table, run.config.lattice)
        return {
            "id": table["id"].to_numpy(),
            "parents": np.stack([table["parent_1"].to_numpy(), table["parent_2"].to_numpy()], axis=1),
            "seed": table["seed"].to_numpy(),
            "triangles": triangles,
            "springs": springs,
            "losses": np.stack(tables.rows(table, "losses")),
            "valid": np.array(table["valid"].to_pylist(), bool),
            "walk": np.array(table["walk"]) if "walk" in table.column_names else np.full(len(table), np.nan),
            **dict(zip(robot_tables.FLAGS, robot_tables.flags(table), strict=True)),
        }
    except (KeyError, ValueError, AttributeError) as error:
        raise tables.damaged(file, "the robots of this run", error) from None
