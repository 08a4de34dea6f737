"""The command `eldir runs`."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from eldir_app.catalogue import Column

if TYPE_CHECKING:
    from eldir_app.catalogue.comparison import ComparedRun
    from eldir_app.catalogue.runs import Catalogue, CataloguedRun

_MAX_COMPARED = 8  # the palette has as many colours


def runs(
    paths: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FOLDER|LOG]...", help="Folders of logs, or single logs; default: this one."),
    ] = None,
    find: Annotated[
        list[str] | None,
        typer.Option(metavar="WORD", help="Only runs that have this word in any text; #good finds a tag."),
    ] = None,
    since: Annotated[
        datetime | None,
        typer.Option(metavar="DATE", formats=["%Y-%m-%d"], help="Only runs of that day or later."),
    ] = None,
    sort: Annotated[Column, typer.Option(help="Column to sort by.")] = "recorded",
    reverse: Annotated[bool, typer.Option("--reverse", help="The other way round.")] = False,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Also write them as a page to filter and sort.")
    ] = None,
    compare: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Also write a page with 2 to 8 runs overlaid.")
    ] = None,
    note: Annotated[str | None, typer.Option(help="Write a note beside the log. One log only.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="Add a tag to the log. One log only.")] = None,
    untag: Annotated[list[str] | None, typer.Option(help="Remove a tag from the log. One log only.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the runs as JSON.")] = False,
) -> None:
    """List recorded runs: design, rig, predicted and filmed walk, verdict, how they ended.

    Reports below the folder are found by their logs' fingerprints. What was read from a log is kept in an
    index, so that only new logs are read.

    Example: eldir runs films --find bench --sort filmed
    """
    from eldir.core.files import require_ending, require_new
    from eldir_app.catalogue.listing import ordered, selected, write_page

    places = paths or [Path()]
    for option, file in (("--page", page), ("--compare", compare)):
        require_ending(option, file, ".html")
    require_new(page, compare)
    if note is not None or tag or untag:
        _annotate(places, note, tag or [], untag or [])
    catalogue = _find_runs(places)
    chosen = ordered(selected(catalogue.runs, find or [], since and since.date()), sort, reverse)
    if compare is not None and not 2 <= len(chosen) <= _MAX_COMPARED:
        raise typer.BadParameter(
            f"--compare overlays 2 to {_MAX_COMPARED} runs, these are {len(chosen)}; name the logs, or "
            "choose them with --find"
        )
    if page is not None:
        write_page(chosen, page)
    if compare is not None:
        _compare([run.log for run in chosen], compare)
    _print_runs(catalogue, chosen, as_json)
    for file in (page, compare):
        if file is not None:
            typer.echo(f"wrote {file}", err=as_json)


def _annotate(places: list[Path], note: str | None, tags: list[str], untags: list[str]) -> None:
    from eldir_app.catalogue.facts import read_notes, write_notes

    if len(places) != 1 or not places[0].is_file() or places[0].suffix != ".mcap":
        raise typer.BadParameter("--note, --tag and --untag are for one log: eldir runs LOG --note TEXT")
    write_notes(places[0], read_notes(places[0]).changed(note, tags, untags))


def _find_runs(places: list[Path]) -> Catalogue:
    """Find the runs with a progress bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn

    from eldir_app.catalogue.runs import Index, find_runs, index_file
    from eldir_app.progress import progress_bar

    with (
        progress_bar(TextColumn("reading logs"), BarColumn(), MofNCompleteColumn()) as progress,
        Index(index_file()) as index,
    ):
        task = progress.add_task("reading logs", total=None)
        return find_runs(
            places, index, lambda done, total: progress.update(task, completed=done, total=total)
        )


def _compare(logs: Sequence[Path], page: Path) -> None:
    from eldir_app.catalogue.comparison import compared_run, write_comparison
    from eldir_app.progress import progress_bar

    with progress_bar() as progress:

        def track(log: Path) -> ComparedRun:
            task = progress.add_task(f"tracking {log.name}", total=None)
            return compared_run(
                log, lambda frames, total: progress.update(task, completed=frames, total=total)
            )

        compared = [track(log) for log in logs]
    write_comparison(compared, page)


def _print_runs(catalogue: Catalogue, chosen: Sequence[CataloguedRun], as_json: bool) -> None:
    import json
    from dataclasses import asdict

    from eldir_app.catalogue.listing import table
    from eldir_app.catalogue.runs import FORMAT

    for problem in catalogue.problems:
        typer.echo(f"note: {problem}", err=True)
    if as_json:
        values = {"format": FORMAT, "runs": [asdict(run) for run in chosen]}
        typer.echo(json.dumps(values, indent=1, ensure_ascii=False, default=str))
        return
    damaged = sum(bool(run.damage) for run in chosen)
    hidden = len(catalogue.runs) - len(chosen)
    counts = [
        "1 run" if len(chosen) == 1 else f"{len(chosen)} runs",
        damaged and f"{damaged} damaged",
        hidden and f"{hidden} not chosen",
    ]
    typer.echo("\n".join([*table(chosen), ", ".join(c for c in counts if c)]))
