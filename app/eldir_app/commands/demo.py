"""The command `eldir demo`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eldir_app.demo import DemoResult


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
    from eldir_app.progress import progress_bar, show_stages

    require_new(out)
    from eldir_app.demo import DemoConfig, folder_size, run_demo

    columns = (TextColumn("{task.description:36}"), BarColumn(), TimeElapsedColumn())
    with progress_bar(*columns, is_permanent=True) as progress:
        result = run_demo(out, DemoConfig(seed, cycles=cycles), show_stages(progress))
        progress.update(progress.task_ids[-1], completed=1.0)
    for line in _summary(result):
        typer.echo(line)
    typer.echo(f"open {out}/report/index.html in a browser ({folder_size(out) / 1e6:.0f} MB in {out})")


def _summary(result: DemoResult) -> Iterator[str]:
    """Lines that compare the learned, the predicted and the filmed walk with those of the paper's robot."""
    from eldir_calibration.report.comparison import NOT_COMPARABLE
    from eldir_calibration.report.page import PAPER
    from eldir_hardware.virtual.bodies import default_physics, physics_version

    learned, walk = result.report.displacement["simulated"], result.content.verdict.walk
    rejected = ", ".join(f"{n} {reason}" for reason, n in result.shortlist.left_out.items())
    yield f"{result.shortlist.considered} evolved bodies; left out: {rejected}"
    body = result.choice.design.morphology
    yield f"robot with {len(body.positions)} hubs and {body.motors} motors, body {body.body_name}"
    yield "body lengths per five cycles:"
    yield f"  learned   {learned:+.2f}; the paper's robot {PAPER['simulated']:+.2f}"
    expected, filmed = walk.predicted, walk.tracked
    interval = f"{expected.low:+.2f} to {expected.high:+.2f} for 95 % of such robots"
    yield f"  predicted {expected.mean:+.2f}, {interval}; most probable robot {walk.nominal:+.2f}"
    over = f", {filmed.low:+.2f} to {filmed.high:+.2f} over cycles"
    yield f"  filmed    {filmed.mean:+.2f}{over}; the paper's robot {PAPER['tracked']:+.2f}"
    yield NOT_COMPARABLE
    yield f"the filmed robot was moved by {physics_version(default_physics())}"
    for warning in (*result.report.warnings, *result.content.remarks):
        yield f"note: {warning}"
