"""Records of the files that commands write, or print, as plain values without a record.

Those commands use no records: an emergency stop must not wait for imports, and a listing has ten thousand
runs. Those of benchmarks are in benchmark_results.py. Tests compare the files with the schemas.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, PositiveInt

from eldir.core.records import FileRecord, Record, record
from eldir_app.catalogue import runs
from eldir_hardware.safety import latch

Versions = dict[str, str | None]


@record
class Board(latch.BoardRecord, FileRecord):
    """A relay board that is driven or stopped, in the state folder."""

    FORMAT = latch.FORMAT
    OPTIONAL = frozenset({"sensor", "sensor_entries"})


@record
class Runs(FileRecord):
    """Recorded runs, as `eldir runs --json` prints them; walks in body lengths per five cycles."""

    FORMAT = runs.FORMAT

    runs: tuple[runs.CataloguedRun, ...]
    """The runs, in the order of their paths."""


@record
class Package(Record):
    """The package eldir."""

    version: Annotated[str, Field(pattern=r"^[0-9]+\.[0-9]+\.[0-9]+")]
    """Version of eldir."""
    source: str
    """Digest of the source files and the compiler's name, as files of runs hold it; or `none:` and the
    reason."""
    folder: str
    """Folder of the package eldir."""


@record
class Interpreter(Record):
    """The Python interpreter."""

    version: str
    """Version of Python."""
    implementation: str
    """Name of the interpreter, such as CPython."""


@record
class Platform(Record):
    """The machine."""

    system: str
    """Operating system and its version."""
    machine: str
    """Architecture of the processor: x86_64, aarch64, ..."""
    processor: str
    """Name of the processor."""
    cores: PositiveInt
    """Number of cores that a process may use here."""
    vectors: tuple[str, ...]
    """Vector instructions of the processor that the engine may use."""
    memory_gb: float
    """Memory of the machine [GB]."""


@record
class Compiler(Record):
    """The compiler of the engine's kernels."""

    chosen: str
    """Compiler that the engine takes; or `none:` and the reason."""
    installed: Versions
    """Version of each installed compiler."""


@record
class Info(FileRecord):
    """An installation, as `eldir info --json` prints it."""

    FORMAT = "eldir-info/1"

    eldir: Package
    """The package eldir."""
    python: Interpreter
    """The Python interpreter."""
    platform: Platform
    """The machine."""
    compiler: Compiler
    """The compiler of the engine's kernels."""
    libraries: Versions
    """Version of each distribution that eldir requires; null where it is not installed."""
    extras: dict[str, Versions]
    """For each extra of eldir, the version of each distribution that it adds; null where it is not
    installed."""
    plug_ins: Annotated[tuple[str, ...], Field(alias="plug-ins")]
    """Commands, boards and kinds of marker that other distributions add."""
    variables: dict[str, str]
    """Environment variables that change what eldir does, where they are set."""
    ports: tuple[str, ...]
    """Serial ports below /dev."""
    cameras: tuple[str, ...]
    """Cameras below /dev."""
