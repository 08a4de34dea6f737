"""The command `eldir calibrate dynamics`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

_NOTE = "identifying: minutes, a quarter of an hour where every strip gets its own values"


def dynamics(
    logs: Annotated[list[Path], typer.Argument(help="Logs (MCAP) of runs of one robot.")],
    *,
    design: Annotated[Path, typer.Option(help="Design file of the robot in the logs.")],
    out: Annotated[Path, typer.Option(help="Scene file to write (JSON).")],
    weight: Annotated[
        float | None, typer.Option(help="Mass of the whole robot in grams. No film can determine it.")
    ] = None,
    current: Annotated[
        float | None,
        typer.Option(
            help="Current in amperes through one hot spring while the others are off (mean of all springs). "
            "Default: as a current sensor measured it in the logs."
        ),
    ] = None,
    voltage: Annotated[
        float | None,
        typer.Option(help="Voltage in volts at the ends of the same hot spring. Default: as in the logs."),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            help="Folder to create with figures: which parameter explains which motion, and what to film "
            "next. This takes half a minute to some minutes more."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Random seed of the optimiser's starting points.")] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the scene as JSON.")] = False,
) -> None:
    """Identify stiffness, friction, masses and heating of a robot from films of it.

    Prints each value with its 95 % interval, and names the values that the films do not determine. The last
    cycle is held out to show how much better the prediction has become. Other commands take the result as
    --scene.

    Example: eldir calibrate dynamics log.mcap --design design.json --weight 74.5 --out scene.json
    """
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from eldir.core.files import require_new
    from eldir.design import Design
    from eldir_app.terminal.progress import bar
    from eldir_calibration.dynamics.verdict import predictions, sentences
    from eldir_calibration.identification.identification import films_of, identify_films

    require_new(out, figures)
    if weight is not None and not 0 < weight < 10_000:
        raise typer.BadParameter("expected more than 0 and less than 10000 grams", param_hint="--weight")
    for name, value, unit in (("current", current, "amperes"), ("voltage", voltage, "volts")):
        if value is not None and not 0 < value < 100:
            raise typer.BadParameter(f"expected more than 0 and less than 100 {unit}", param_hint=f"--{name}")
    robot = Design.load(design)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}: {task.percentage:.0f} %"),
        TimeElapsedColumn(),
    )
    with bar(*columns, note=_NOTE) as progress:
        task = progress.add_task("reading", total=1.0)

        def show(what: str, part: float) -> None:
            progress.update(task, description=what, completed=part)

        films = films_of(logs, robot, show)
        scene = identify_films(
            films,
            weight_g=weight,
            current_a=current,
            voltage_v=voltage,
            seed=seed,
            figures=figures,
            progress=show,
        )
    scene.save(out)
    if as_json:
        typer.echo(out.read_text(), nl=False)
        return
    results = scene.identification
    for name, q in results.quantities.items():
        low, high = q.interval
        mark = " " if q.identified else "?"
        typer.echo(
            f"{mark} {name:15} {q.value:10.4g} {q.unit:9} 95 %: {low:.4g} to {high:.4g}, "
            f"nominal {q.nominal:.4g}"
        )
    if results.not_identified:
        typer.echo(f"? these logs do not determine: {', '.join(results.not_identified)}")
    held, left = results.held_out_cycle, results.left_m.shape
    for line in sentences(results.model) + predictions(results):
        typer.echo(f"! {line}")
    if films.readings is not None:
        read, replaced = films.readings, [n for n, v in (("current", current), ("voltage", voltage)) if v]
        typer.echo(
            f"measured in the logs: {read.current_a:.3f} A and {read.voltage_v:.3f} V at hot springs, "
            f"{read.pulses} pulses, known to {read.error:.1%}"
            + (f"; not used: {' and '.join(replaced)}, given as options" if replaced else "")
        )
    for gait in films.filmed_gaits:
        typer.echo(f"filmed in {gait.log}: {gait.in_words}")
    walk = ", ".join(
        f"{kind} unknown" if w is None else f"{kind} {w:+.2f}" for kind, w in (held.walk or {}).items()
    )
    typer.echo(
        f"wrote {out}: residual {1e3 * left:.2f} mm (root mean square); error of the vertical ranges in the "
        f"held-out cycle {held.error_before:.1%} before, {held.error_after:.1%} after; its walk in "
        f"body lengths per five cycles: {walk}"
    )
