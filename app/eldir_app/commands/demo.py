"""The command `eldir demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def demo(
    out: Annotated[Path, typer.Option(help="New folder.")] = Path("demo"),
    seed: Annotated[int, typer.Option(min=0, help="Random seed: the same robot on the same machine.")] = 1,
    cycles: Annotated[
        int, typer.Option(min=2, max=5, help="Filmed cycles of the gait; fewer take less time.")
    ] = 5,
) -> None:
    """Run all steps on a virtual rig: evolve, choose, write the packet, drive, film, compare.

    Processors differ in how they round, so that the same seed finds another robot on another kind of machine.

    Example: eldir demo --out demo --seed 1
    """
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

    from eldir.core.files import require_new
    from eldir_app.terminal.progress import bar, stages
    from eldir_calibration.report.page import PAPER

    require_new(out)
    from eldir_app.demo import folder_size, run_demo
    from eldir_hardware.virtual.bodies import best_physics, physics_name

    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    with bar(*columns, stays=True) as shown:
        found = run_demo(out, seed, stages(shown), cycles=cycles)
        shown.update(shown.task_ids[-1], completed=1.0)
    walk, samples = found.report.displacement, found.choice.spread
    left_out = ", ".join(f"{n} {reason}" for reason, n in found.shortlist.left_out.items())
    typer.echo(f"{found.shortlist.considered} evolved bodies; left out: {left_out}")
    typer.echo("body lengths per five cycles:")
    typer.echo(f"  evolved   {walk['simulated']:+.2f}   the paper's robot {PAPER['simulated']:+.2f}")
    sure = f"{samples.mean:+.2f} +- {samples.spread:.2f}, forward in {samples.probability_forward:.0%}"
    if samples.fallen:
        sure += f", falls in {samples.fallen:.0%}"
    count = len(samples.displacement)
    typer.echo(f"  predicted {walk['predicted']:+.2f}   over {count} samples of the shortlist {sure}")
    typer.echo(f"  filmed    {walk['tracked']:+.2f}   the paper's robot {PAPER['tracked']:+.2f}")
    typer.echo(f"the filmed robot was moved by {physics_name(best_physics())}")
    for warning in (*found.report.warnings, *found.content.remarks):
        typer.echo(f"note: {warning}")
    typer.echo(f"open {out}/report/index.html in a browser ({folder_size(out) / 1e6:.0f} MB in {out})")
