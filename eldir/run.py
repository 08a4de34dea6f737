"""Run folders: what an evolution keeps on disk, so that it can be read, resumed and repeated.

    run.json                  what was asked for, "eldir-run/1"
    generation-0000.parquet   every robot evaluated in a generation, with all its losses
    survivors-0003.parquet    the last population, best first, with the taught weights

The survivors' file is written last: with it a generation is whole. Resuming starts after the
last whole generation and overwrites what lies beyond it.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldir import __version__
from eldir.controller import HIDDEN, Controller
from eldir.design import Design
from eldir.errors import EldirError, InputError
from eldir.evolution import Accept, Evolution, Learned, Robots, Search, valid
from eldir.files import new_folder, read_json, write_bytes, write_text
from eldir.frozen import BoolArray, FloatArray
from eldir.genotype import stack, unstack
from eldir.lattice import Lattice

if TYPE_CHECKING:
    import pyarrow as pa

FORMAT = "eldir-run/1"
_LAYERS = ("w1", "b1", "w2", "b2")


@dataclass(frozen=True)
class Run:
    """An evolution's folder."""

    path: Path
    config: Evolution

    @classmethod
    def create(cls, path: Path, config: Evolution) -> Run:
        """A new folder; raises `EldirError` where something stands already."""
        values = {"format": FORMAT, "version": __version__, "config": config.to_json()}
        with new_folder(path) as folder:
            write_text(folder / "run.json", json.dumps(values, indent=1) + "\n")
        return cls(path, config)

    @classmethod
    def open(cls, path: Path) -> Run:
        """An existing folder; names what is missing or damaged."""
        values = read_json(path / "run.json", FORMAT)
        try:
            return cls(path, Evolution.from_json(values["config"]))
        except EldirError as error:
            raise InputError(f"{path / 'run.json'} is not sound: {error}") from None
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f"{path / 'run.json'} is damaged",
                expected="a run as in docs/schemas/run.schema.json",
                found=f"{type(error).__name__}: {error}",
            ) from None

    def save(self, search: Search, learned: Learned) -> None:
        """Keep a generation that `search` has just been told."""
        generation = search.generation - 1
        if search.survivors is None:
            raise EldirError("nothing to save", expected="a search that was told a generation")
        write_bytes(self.path / f"generation-{generation:04d}.parquet", self._generation(learned))
        write_bytes(self.path / f"survivors-{generation:04d}.parquet", self._survivors(search.survivors))
        for number, old in self._whole_generations():
            if number != generation:
                old.unlink()

    def restore(self, accept: Accept | None = None) -> Search:
        """The search after the last whole generation; a new one where there is none."""
        whole = self._whole_generations()
        if not whole:
            return Search(self.config, accept)
        generation, path = whole[-1]
        return Search(self.config, accept, generation + 1, self._read_survivors(path))

    def _whole_generations(self) -> list[tuple[int, Path]]:
        """Numbers and survivors' files, ascending; after an interruption there may be two."""
        found = ((re.fullmatch(r"survivors-(\d{4,})\.parquet", p.name), p) for p in self.path.iterdir())
        return sorted((int(match[1]), p) for match, p in found if match)

    def _generation(self, learned: Learned) -> bytes:
        sound = valid(learned.losses, self.config.scene.jump_threshold)
        return _to_parquet(_columns(learned) | {"valid": sound}, "eldir-generation/1")

    def _survivors(self, survivors: Learned) -> bytes:
        weights = {k: [getattr(c, k).ravel() for c in survivors.controllers] for k in _LAYERS}
        return _to_parquet(_columns(survivors) | weights, "eldir-survivors/1")

    def _read_survivors(self, path: Path) -> Learned:
        table = _read_parquet(path)
        try:
            return _learned(table, self.config.lattice)
        except (KeyError, ValueError, IndexError, AttributeError, EldirError) as error:
            raise InputError(
                f"{path} is damaged", expected="the survivors of this run", found=str(error)
            ) from None


def load_run(path: Path | str) -> list[Design]:
    """The last population as designs, best first; provenance tells fitness, generation and seed."""
    run = Run.open(Path(path))
    search = run.restore()
    if search.survivors is None:
        raise InputError(
            f"{path} has no whole generation yet", remedy=f"go on with eldir evolve --resume {path}"
        )
    config, robots = run.config, search.survivors.robots
    return [
        Design(
            config.lattice,
            genotype,
            controller,
            config.scene,
            {
                "fitness_m": float(fitness),
                "generation": int(number) // config.population,
                "id": int(number),
                "parents": [int(p) for p in parents if p >= 0],
                "seed": int(seed),
                "run_seed": config.seed,
                "version": __version__,
            },
        )
        for genotype, controller, fitness, number, parents, seed in zip(
            robots.genotypes,
            search.survivors.controllers,
            search.survivors.fitness(),
            robots.ids,
            robots.parents,
            robots.seeds,
            strict=True,
        )
    ]


def load_generation(path: Path | str, generation: int) -> dict[str, np.ndarray]:
    """Every robot evaluated in a generation: id, parents (N, 2), seed, triangles (N, B, A),
    springs (N, S), losses (N, iterations + 1) and valid, all in order of id."""
    run = Run.open(Path(path))
    table = _read_parquet(run.path / f"generation-{generation:04d}.parquet")
    lattice = run.config.lattice
    return {
        "id": table["id"].to_numpy(),
        "parents": np.stack([table["parent_1"].to_numpy(), table["parent_2"].to_numpy()], axis=1),
        "seed": table["seed"].to_numpy(),
        "triangles": _unpacked(table, "triangles", lattice.rows * lattice.columns).reshape(
            -1, lattice.rows, lattice.columns
        ),
        "springs": _unpacked(table, "springs", len(lattice.springs)),
        "losses": np.stack(_rows(table, "losses")),
        "valid": np.array(table["valid"].to_pylist(), bool),
    }


def _columns(learned: Learned) -> dict[str, Any]:
    """Bits are packed eight to a byte, the first bit the highest; masks row by row from the bottom."""
    robots = learned.robots
    triangles, springs = stack(robots.genotypes)
    return {
        "id": robots.ids,
        "parent_1": robots.parents[:, 0],
        "parent_2": robots.parents[:, 1],
        "seed": robots.seeds,
        "triangles": _packed(triangles.reshape(len(triangles), -1)),
        "springs": _packed(springs),
        "losses": list(learned.losses),
    }


def _learned(table: pa.Table, lattice: Lattice) -> Learned:
    triangles = _unpacked(table, "triangles", lattice.rows * lattice.columns)
    genotypes = unstack(
        triangles.reshape(-1, lattice.rows, lattice.columns),
        _unpacked(table, "springs", len(lattice.springs)),
    )
    parents = np.stack([table["parent_1"].to_numpy(), table["parent_2"].to_numpy()], axis=1)
    robots = Robots(tuple(genotypes), table["id"].to_numpy(), parents, table["seed"].to_numpy())
    weights = zip(*(_rows(table, k) for k in _LAYERS), strict=True)
    controllers = tuple(
        Controller(w1.reshape(HIDDEN, -1), b1, w2.reshape(-1, HIDDEN), b2) for w1, b1, w2, b2 in weights
    )
    return Learned(robots, np.stack(_rows(table, "losses")), controllers)


def _rows(table: pa.Table, name: str) -> list[FloatArray]:
    """A column of lists as arrays, without a Python number for every weight of the population."""
    rows: list[FloatArray] = []
    for chunk in table[name].chunks:
        values, ends = chunk.values.to_numpy(), chunk.offsets.to_numpy()
        rows += [values[a:b] for a, b in pairwise(ends)]
    return rows


def _packed(bits: BoolArray) -> list[bytes]:
    return [row.tobytes() for row in np.packbits(bits, axis=1)]


def _unpacked(table: pa.Table, name: str, count: int) -> BoolArray:
    rows: Sequence[bytes] = table[name].to_pylist()
    packed = np.stack([np.frombuffer(row, np.uint8) for row in rows])
    return np.unpackbits(packed, axis=1, count=count).astype(bool)


def _to_parquet(columns: dict[str, Any], format_name: str) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table(columns).replace_schema_metadata({"format": format_name})
    buffer = io.BytesIO()
    pq.write_table(table, buffer, compression="zstd")
    return buffer.getvalue()


def _read_parquet(path: Path) -> pa.Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return pq.read_table(io.BytesIO(path.read_bytes()))
    except FileNotFoundError:
        raise InputError(f"{path} does not exist", remedy="check the run folder") from None
    except (OSError, pa.ArrowException) as error:
        raise InputError(f"{path} is damaged", expected="a Parquet file", found=str(error)) from None
