"""The command `eldir shortlist`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from eldir_app.options import PartsFile, Printer, SceneFile, check_printer
from eldir_cad.kit import PRINTER
from eldir_cad.shortlist import MAX_DESIGNS, SEED


def shortlist(
    run: Annotated[Path, typer.Argument(help="Run folder of eldir evolve.")],
    out: Annotated[Path, typer.Option(help="New folder for the designs and the ranking.")],
    top: Annotated[int, typer.Option(help="Largest number of designs to keep.", min=1, max=12)] = MAX_DESIGNS,
    printer: Printer = PRINTER,
    parts: PartsFile = None,
    seed: Annotated[int, typer.Option(help="Random seed of the samples.", min=0)] = SEED,
    scene: SceneFile = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the ranking as JSON.")] = False,
) -> None:
    """Choose designs to build, and rank them by the predicted walk of the printed robot.

    The build filter comes first. Then each body walks in all phases of its motors, or in the gait that
    evolved with it. The best ones are ranked by the walk of samples, robots with slightly different
    parameters: the mean less half the standard deviation, a fall counted as no walk. Different bodies come
    first, and the list says which designs have the same or similar bodies.

    Example: eldir shortlist run --out shortlist --top 6
    """
    import json

    from eldir.core.files import require_new

    require_new(out)
    from eldir.built.scene import PrintedScene
    from eldir.evolution.designs import load_run, open_run
    from eldir.evolution.printed.run_folder import PrintedRun
    from eldir_app.progress import progress_bar, show_stages
    from eldir_cad.checks.strip_law import on_supply_of, spring_parameters
    from eldir_cad.kit.printer import load_printer
    from eldir_cad.kit.specification import load_specification
    from eldir_cad.shortlist.folder import write_shortlist
    from eldir_cad.shortlist.ranking import rank

    check_printer(printer)
    specification = None if parts is None else load_specification(parts)
    profile = load_printer(printer)
    identified = None if scene is None else PrintedScene.load(scene)
    designs, folder = load_run(run), open_run(run)
    config = folder.config if isinstance(folder, PrintedRun) else None
    springs, tolerances = (None, None) if config is None else (config.springs, config.tolerances)
    if springs is not None and specification is not None:
        springs = on_supply_of(spring_parameters(specification), springs)
    with progress_bar(note="ranking: 1 to 5 minutes") as progress:
        show = show_stages(progress)
        best = rank(designs, top, specification, profile, seed, show, identified, springs, tolerances)
    rows = write_shortlist(best, out)
    if as_json:
        print(json.dumps([row.to_json() for row in rows], indent=1))
        return
    for row in rows:
        walks, lateral = row.predicted.sampled_walks, row.predicted.lateral_stability
        further = "".join(f", {text}" for text in (lateral and str(lateral), row.likeness) if text)
        print(f"{row.file}: {walks}, {walks.forward}; body {row.body}{further}")
    rejected = ", ".join(f"{n} {kind}" for kind, n in best.left_out.items())
    print(f"{out}: {len(rows)} of {best.considered} different bodies; left out: {rejected or 'none'}")
