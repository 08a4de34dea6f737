"""The command `eldir shortlist`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_cad.kit.defaults import PRINTER, SEED, TOP


def shortlist(
    run: Annotated[Path, typer.Argument(help="Run folder of eldir evolve.")],
    out: Annotated[Path, typer.Option(help="New folder for the designs and the ranking.")],
    top: Annotated[int, typer.Option(help="Largest number of designs to keep.", min=1, max=12)] = TOP,
    printer: Annotated[str, typer.Option(help="Printer profile: its name, or a YAML file.")] = PRINTER,
    parts: Annotated[Path | None, typer.Option(help="Specification of the parts: a YAML file.")] = None,
    seed: Annotated[int, typer.Option(help="Random seed of the samples.", min=0)] = SEED,
    scene: Annotated[
        Path | None, typer.Option(help="Identified robot: a file of eldir calibrate dynamics.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the ranking as JSON.")] = False,
) -> None:
    """Choose designs to build, and rank them by the predicted walk of the printed robot.

    The build filter comes first. Then each body walks in all phases of its motors, or in the gait that
    evolved with it. The best ones are ranked by the walk of samples, robots with slightly different
    parameters: the mean less half the standard deviation, a fall counted as no walk.

    Example: eldir shortlist run --out shortlist --top 6
    """
    import json

    from eldir.built.scene import BuiltScene
    from eldir.core.files import require_new
    from eldir.evolution.designs import load_run, open_run
    from eldir.evolution.printed.run_folder import PrintedRun
    from eldir_app.commands.packet import check_printer
    from eldir_app.terminal.progress import bar, stages
    from eldir_cad.kit.printer import load_printer
    from eldir_cad.kit.specification import load_specification
    from eldir_cad.shortlist.folder import write_shortlist
    from eldir_cad.shortlist.ranking import rank

    check_printer(printer)
    require_new(out)  # before the minutes that the ranking takes
    specification, profile = load_specification(parts), load_printer(printer)
    known = None if scene is None else BuiltScene.load(scene)
    designs, opened = load_run(run), open_run(run)
    springs = opened.config.springs if isinstance(opened, PrintedRun) else None
    with bar(note="ranking: 1 to 5 minutes") as bars:
        best = rank(designs, top, specification, profile, seed, stages(bars), known, springs)
    rows = write_shortlist(best, out)
    if as_json:
        print(json.dumps([row.to_json() for row in rows], indent=1))
        return
    for row in rows:
        walks = row.predicted.sampled_walks
        print(f"{row.file}: {walks}, {walks.forward}")
    others = ", ".join(f"{n} {kind}" for kind, n in best.left_out.items())
    print(f"{out}: {len(rows)} of {best.considered} different bodies; left out: {others or 'none'}")
