"""The command `eldir calibrate dynamics`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.options import load_design_for_prediction

if TYPE_CHECKING:
    from eldir.built.scene import Identification, PrintedScene
    from eldir.design import Design
    from eldir_calibration.identification.identification import RobotFilms

_NOTE = (
    "identifying: 1 to 10 minutes with one film, half an hour with two, an hour or more if the robot is large"
)


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
    --scene. Ctrl-C ends the search, and keeps the best model so far.

    Example: eldir calibrate dynamics log.mcap --design design.json --weight 74.5 --out scene.json
    """
    from eldir.core.files import require_new
    from eldir_calibration.dynamics.results import STOPPED

    require_new(out, figures)
    if weight is not None and not 0 < weight < 10_000:
        raise typer.BadParameter("expected more than 0 and less than 10000 grams", param_hint="--weight")
    for name, value, unit in (("current", current, "amperes"), ("voltage", voltage, "volts")):
        if value is not None and not 0 < value < 100:
            raise typer.BadParameter(f"expected more than 0 and less than 100 {unit}", param_hint=f"--{name}")
    measured = {"weight_g": weight, "current_a": current, "voltage_v": voltage}
    films, scene = _identify(logs, load_design_for_prediction(design), measured, seed, figures)
    scene.save(out)
    if scene.provenance.get(STOPPED):
        typer.echo(f"stopped: {out} has the best of the models so far; others were not tried", err=True)
    if as_json:
        typer.echo(out.read_text(), nl=False)
        return
    for line in (*_parameter_lines(scene.identification), *_film_lines(films, current, voltage)):
        typer.echo(line)
    typer.echo(f"wrote {out}: {_prediction_error(scene.identification)}")


def _identify(
    logs: list[Path], design: Design, measured: dict[str, float | None], seed: int, figures: Path | None
) -> tuple[RobotFilms, PrintedScene]:
    """The films of the logs, and the scene that was identified from them, with a progress bar."""
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    from eldir_app.progress import progress_bar
    from eldir_calibration.identification.identification import identify_films, read_films

    percentage = TextColumn("{task.description}: {task.percentage:.0f} %")
    with progress_bar(SpinnerColumn(), percentage, TimeElapsedColumn(), note=_NOTE) as progress:
        task = progress.add_task("reading", total=1.0)

        def show(stage: str, fraction: float) -> None:
            progress.update(task, description=stage, completed=fraction)

        films = read_films(logs, design, show)
        return films, identify_films(films, seed=seed, figures=figures, progress=show, **measured)


def _parameter_lines(result: Identification) -> Iterator[str]:
    """A line for each parameter with its interval, then what the logs do not determine, and the verdicts."""
    from eldir_calibration.dynamics.verdict import describe_model, describe_predictions

    for name, quantity in result.quantities.items():
        low, high = quantity.interval
        mark = " " if quantity.identified else "?"
        yield (
            f"{mark} {name:15} {quantity.value:10.4g} {quantity.unit:9} 95 %: {low:.4g} to {high:.4g}, "
            f"nominal {quantity.nominal:.4g}"
        )
    if result.not_identified:
        yield f"? these logs do not determine: {', '.join(result.not_identified)}"
    for line in describe_model(result.model) + describe_predictions(result):
        yield f"! {line}"


def _film_lines(films: RobotFilms, current: float | None, voltage: float | None) -> Iterator[str]:
    """What the logs measured, and which gaits they show."""
    if films.readings is not None:
        readings = films.readings
        given = [name for name, value in (("current", current), ("voltage", voltage)) if value]
        unused = f"; not used: {' and '.join(given)}, given as options" if given else ""
        yield (
            f"measured in the logs: {readings.current_a:.3f} A and {readings.voltage_v:.3f} V at hot "
            f"springs{readings.partial}, {readings.pulses} pulses, known to {readings.error:.1%}{unused}"
        )
    for gait in films.filmed_gaits:
        yield f"filmed in {gait.log}: {gait.summary}"


def _prediction_error(result: Identification) -> str:
    """How much better the held-out cycle is predicted."""
    held_out = result.held_out_cycle
    walk = ", ".join(
        f"{kind} unknown" if lengths is None else f"{kind} {lengths:+.2f}"
        for kind, lengths in (held_out.walk or {}).items()
    )
    return (
        f"residual {1e3 * result.left_m.shape:.2f} mm (root mean square); error of the vertical ranges in "
        f"the held-out cycle {held_out.error_before:.1%} before, {held_out.error_after:.1%} after; its "
        f"walk in body lengths per five cycles: {walk}"
    )
