"""The status of a run of printed robots, read from its folder alone."""

from __future__ import annotations

import math

from pydantic import NonNegativeInt

from eldir.core.records import SourceDigest, record
from eldir.evolution import tables
from eldir.evolution.printed.archive import Archive, Walker
from eldir.evolution.printed.run_folder import PrintedRun
from eldir.evolution.status import RunStatus

WALKS = 1.0
"""An elite walks if its expected walk is above this [body lengths per five cycles]."""


@record
class PrintedStatus(RunStatus):
    """The status of one run."""

    FORMAT = "eldir-printed-status/1"

    tried: NonNegativeInt
    """Robots tried so far."""
    kinds: NonNegativeInt
    """Kinds of bodies in the archive."""
    walking: NonNegativeInt
    """Elites whose expected walk is above 1 body length in five cycles."""
    best: float | None
    """Expected walk of the best elite [body lengths per five cycles]; null if there is none."""
    standard_error: float | None
    """Standard error of that expected walk [body lengths per five cycles]; null where one sample is known."""
    samples: NonNegativeInt
    """Number of samples of the best elite."""
    source: SourceDigest
    """Digest of the code that started the run."""

    def summary(self) -> str:
        """The status in one line."""
        text = f"{self.state}, {self.whole} of {self.wanted} generations, {self.tried} robots tried"
        if self.best is not None:
            error = math.inf if self.standard_error is None else self.standard_error
            text += (
                f"; best {self.best:+.2f} +- {error:.2f} body lengths in 5 cycles "
                f"({self.samples} samples); {self.kinds} kinds of bodies, {self.walking} above {WALKS:g}"
            )
        return text


def progress_line(generation: int, archive: Archive) -> str:
    """A short line for the progress bar: the last complete generation, in the first one that one itself."""
    best = _best(archive)
    if best is None:
        return "no walker yet"
    walking = sum(w.expected > WALKS for w in archive.elites.values())
    return (
        f"generation {max(0, generation - 1)}, best {best.expected:+.2f} +- {best.error:.2f}, "
        f"{walking} above {WALKS:g}"
    )


def status_of(run: PrintedRun) -> PrintedStatus:
    """Read the status of a run."""
    search = run.restore()
    archive, whole = search.archive, search.generation
    best = _best(archive)
    tried = sum(tables.read(run.generation_file(g), ["number"]).num_rows for g in range(whole))
    return PrintedStatus(
        path=str(run.path),
        state="finished" if search.finished else "evolving" if run.evolving else "stopped",
        whole=whole,
        wanted=run.config.generations + 1,
        tried=tried,
        kinds=len(archive.elites),
        walking=sum(w.expected > WALKS for w in archive.elites.values()),
        best=None if best is None else best.expected,
        standard_error=best.error if best is not None and math.isfinite(best.error) else None,
        samples=0 if best is None else len(best.walks),
        source=run.source,
    )


def _best(archive: Archive) -> Walker | None:
    return next(iter(archive.ranked()), None)
