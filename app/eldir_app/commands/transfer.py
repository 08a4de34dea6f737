"""The command `eldir transfer`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def transfer(
    designs: Annotated[
        list[Path], typer.Argument(metavar="DESIGN...", help="Design files, such as those of a shortlist.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to create.")],
    samples: Annotated[
        int, typer.Option(min=2, max=100, help="Robots of each prediction, and as many others in MuJoCo.")
    ] = 8,
    cycles: Annotated[
        int, typer.Option(min=1, max=5, help="Cycles that count in MuJoCo, after one that does not.")
    ] = 2,
    phases: Annotated[
        int, typer.Option(min=0, max=15, help="Also compare this many other phases of each gait.")
    ] = 0,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Also take hubs, sockets, feet, contact and slope away, one by one."),
    ] = False,
    rig: Annotated[
        Path | None,
        typer.Option(help="Rig file: springs and supply. Default: those that `eldir evolve` uses."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of all robots.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")] = False,
) -> None:
    """Compare predicted walks with those of a second physics, MuJoCo.

    Each design walks with the gait that eldir shortlist wrote into it; without one, all phases are tried.
    The engine predicts from sampled robots; other robots of the same design walk in MuJoCo. The page tells
    how well order, direction and distance agree. It needs MuJoCo: install eldir with its extra mujoco.

    Example: eldir transfer shortlist/design_01.json shortlist/design_02.json --out transfer
    """
    from eldir.core.files import require_new
    from eldir.design import Design
    from eldir.errors import InputError

    require_new(out)
    names = [str(path) for path in designs]
    if len(set(names)) < len(names):
        raise InputError("a design is named twice", expected="different files", found=", ".join(names))
    for path in designs:
        Design.load(path)  # a wrong file is told before what takes seconds to import

    from eldir_hardware.virtual.mujoco_body import engine_name

    engine = engine_name()

    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    from eldir_app.terminal.progress import bar
    from eldir_calibration.transfer.transfer import (
        TransferSettings,
        compare_walks,
        first_seeds,
        steps,
        walking_design,
    )
    from eldir_calibration.transfer.transfer_explained import STEPS
    from eldir_calibration.transfer.transfer_explained import explain as explained_walk
    from eldir_calibration.transfer.transfer_page import TransferResult, write_transfer
    from eldir_hardware.planning.workshop import workshop
    from eldir_hardware.rig.configuration import Rig

    springs = workshop().springs if rig is None else Rig.load(rig).spring_parameters()
    settings = TransferSettings(samples, cycles, phases, seed, springs)
    with bar(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()) as progress:
        task = progress.add_task("reading designs", total=None)
        walking = [
            walking_design(name, settings.springs, lambda what: progress.update(task, description=what))
            for name in names
        ]
        progress.update(task, total=steps(walking, settings) + explain * STEPS * len(walking))

        def show(what: str, done: float) -> None:
            progress.update(task, description=what, advance=done)

        compared = compare_walks(walking, settings, show)
        explained = [
            explained_walk(one, first_seeds(number, settings)[0], settings, show)
            for number, one in enumerate(walking if explain else [])
        ]
    result = TransferResult(walking, compared, explained, settings, engine)
    write_transfer(result, out)
    if as_json:
        typer.echo((out / "transfer.json").read_text(), nl=False)
        return
    for sentence in result.verdict.in_words:
        typer.echo(sentence)
    for one in explained:
        typer.echo(f"{one.file}: {one.finding}")
    typer.echo(f"wrote {out}/transfer.html")
