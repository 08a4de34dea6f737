"""The command `eldir transfer`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from eldir_app.options import load_design_for_prediction

if TYPE_CHECKING:
    from eldir_calibration.transfer.compared_walks import TransferConfig
    from eldir_calibration.transfer.page import TransferResult


def transfer(
    designs: Annotated[
        list[Path], typer.Argument(metavar="DESIGN...", help="Design files, such as those of a shortlist.")
    ],
    out: Annotated[Path, typer.Option(help="Folder to create.")],
    samples: Annotated[
        int, typer.Option(min=2, max=100, help="Robots of each prediction, and as many others in MuJoCo.")
    ] = 8,
    cycles: Annotated[
        int, typer.Option(min=1, max=5, help="Cycles that are measured in MuJoCo, after one of conditioning.")
    ] = 2,
    phases: Annotated[
        int, typer.Option(min=0, max=15, help="Also compare this many other phases of each gait.")
    ] = 0,
    dimensions: Annotated[
        int,
        typer.Option(
            min=2,
            max=3,
            help="3: each face has its own strips, feet and springs in MuJoCo, and robots may turn and fall "
            "sideways. 2: both faces are one; a third of the time.",
        ),
    ] = 3,
    explain: Annotated[
        bool,
        typer.Option(
            "--explain",
            help="Also simulate without hubs, sockets, feet, contact and slope, one by one, in the plane.",
        ),
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

    require_new(out)
    names = [str(path) for path in designs]
    _require_designs(names)

    from eldir_hardware.virtual.mujoco_body import mujoco_version

    engine = mujoco_version()  # raises without MuJoCo, before the slow imports

    from eldir_calibration.transfer.compared_walks import TransferConfig
    from eldir_calibration.transfer.page import write_transfer
    from eldir_hardware.planning.workshop import make_workshop
    from eldir_hardware.rig.configuration import Rig
    from eldir_hardware.rig.supply import require_measured

    space: Literal[2, 3] = 3 if dimensions == 3 else 2
    if rig is None:
        config = TransferConfig(samples, cycles, phases, seed, space, make_workshop().springs)
    else:
        loaded = Rig.load(rig)
        require_measured(loaded)
        loaded.require_own_outputs("leave --rig out; eldir gait predicts walks with this rig file")
        springs, tolerances = loaded.spring_parameters(), loaded.spring_tolerances()
        config = TransferConfig(
            samples, cycles, phases, seed, space, springs, tolerances, rig.name, loaded.digest
        )
    result = _compare(names, config, explain, engine)

    write_transfer(result, out)
    if as_json:
        typer.echo((out / "transfer.json").read_text(), nl=False)
        return
    for sentence in result.verdict.sentences:
        typer.echo(sentence)
    for explained in result.explained:
        typer.echo(f"{explained.file}: {explained.finding}")
    typer.echo(f"wrote {out}/transfer.html")


def _require_designs(names: list[str]) -> None:
    """Raise `InputError` for a design that is given twice or cannot be read, before the slow imports."""
    from eldir.errors import InputError

    if len(set(names)) < len(names):
        raise InputError("the same design is given twice", expected="different files", found=", ".join(names))
    for name in names:
        load_design_for_prediction(Path(name))


def _compare(names: list[str], config: TransferConfig, explain: bool, engine: str) -> TransferResult:
    """Predict the walks, simulate them with MuJoCo, and compare, with a progress bar. `engine`: version of
    MuJoCo."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    from eldir_app.progress import progress_bar
    from eldir_calibration.transfer import compared_walks, verdict
    from eldir_calibration.transfer.page import TransferResult

    with progress_bar(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()) as progress:
        task = progress.add_task("reading designs", total=None)

        def show_stage(stage: str) -> None:
            progress.update(task, description=stage)

        def show(stage: str, done: float) -> None:
            progress.update(task, description=stage, advance=done)

        walking = [compared_walks.load_walking_design(name, config.springs, show_stage) for name in names]
        steps = compared_walks.count_steps(walking, config)
        steps += explain * verdict.STEPS_PER_EXPLANATION * len(walking)
        progress.update(task, total=steps)
        compared = compared_walks.compare_walks(walking, config, show)
        explained = [
            verdict.explain_walk(design, compared_walks.robot_seeds(index, config)[0], config, show)
            for index, design in enumerate(walking if explain else [])
        ]
    return TransferResult(walking, compared, explained, config, engine)
