"""The command `eldir calibrate dynamics`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def dynamics(
    logs: Annotated[list[Path], typer.Argument(help="Logs of runs of one robot (MCAP).")],
    *,
    design: Annotated[Path, typer.Option(help="The design that was driven.")],
    out: Annotated[Path, typer.Option(help="Scene to write, JSON.")],
    weight: Annotated[
        float | None, typer.Option(help="Grams of the whole robot, if it was weighed: no film tells it.")
    ] = None,
    current: Annotated[
        float | None,
        typer.Option(help="Amperes through one hot spring alone, if they were read (mean of the springs)."),
    ] = None,
    voltage: Annotated[
        float | None, typer.Option(help="Volts across the same hot spring, at its ends, if they were read.")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            help="Folder to make: what explains which millimetre, what to film next. A minute more."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scene as JSON.")] = False,
) -> None:
    """Find stiffness, friction, masses and heating of the robot from films of it; say what they cannot tell.

    The last cycle is held out to show the gain. Other commands take the result as --scene.

    Example: eldir calibrate dynamics log.mcap --design design.json --weight 74.5 --out scene.json
    """
    from dataclasses import replace

    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from calibration.dynamics.measurements import Measurements
    from calibration.dynamics.results import identify_robot
    from calibration.dynamics.verdict import sentences
    from eldir.commands.progress import bar
    from eldir.core.files import require_new
    from eldir.design import Design
    from hardware.analysis.identification import films_of, write_pictures

    require_new(out, figures)
    if weight is not None and not 0 < weight < 10_000:
        raise typer.BadParameter("grams, more than 0", param_hint="--weight")
    for name, value, unit in (("current", current, "amperes"), ("voltage", voltage, "volts")):
        if value is not None and not 0 < value < 100:
            raise typer.BadParameter(f"{unit}, more than 0", param_hint=f"--{name}")
    of_one_plane = None if weight is None else 1e-3 * weight / 2  # [kg]
    robot = Design.load(design)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with bar(*columns) as progress:
        task = progress.add_task("reading", total=None)

        def tell(what: str, part: float) -> None:
            progress.update(task, description=f"{what}: {part:.0%}")

        films = films_of(logs, robot, tell)
        scene = identify_robot(
            films.body,
            films.recordings,
            films.nominal,
            others=films.others,
            measurements=Measurements(of_one_plane, current, voltage),
            seed=seed,
            tell=tell,
            provenance=films.provenance
            | {"seed": seed, "weight_g": weight, "current_a": current, "voltage_v": voltage},
        )
        driven = {"driven": [seen.to_json() for seen in films.driven]}
        scene = replace(scene, results=scene.results | driven)
        if figures is not None:
            tell("figures", 0.0)
            scene = write_pictures(films, scene, figures)
    scene.save(out)
    if as_json:
        typer.echo(out.read_text(), nl=False)
        return
    for name, q in scene.results["quantities"].items():
        low, high = q["interval"]
        mark = " " if q["identified"] else "?"
        typer.echo(
            f"{mark} {name:15} {q['value']:10.4g} {q['unit']:9} 95 %: {low:.4g} to {high:.4g}, "
            f"nominal {q['nominal']:.4g}"
        )
    if scene.results["not_identified"]:
        typer.echo(f"? these logs do not tell: {', '.join(scene.results['not_identified'])}")
    for line in sentences(scene.results["model"]):
        typer.echo(f"! {line}")
    for seen in films.driven:
        typer.echo(f"seen in {seen.log}: {seen.in_words}")
    held, left = scene.results["held_out_cycle"], scene.results["left_m"]["shape"]
    typer.echo(
        f"wrote {out}: {1e3 * left:.2f} mm left unexplained; vertical range of motion in the held-out cycle "
        f"off by {held['error_before']:.1%} before, {held['error_after']:.1%} after"
    )
