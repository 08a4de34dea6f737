"""The command `eldir rig watch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def watch(
    rig_file: Annotated[
        Path | None, typer.Option("--rig", help="The rig file. Default: whatever this computer drives.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Show this log: a finished one, or one that is being written.")
    ] = None,
    listen: Annotated[
        str, typer.Option(help="Address and port. Any address but this computer's own needs a token.")
    ] = "127.0.0.1:8642",
    host: Annotated[
        list[str] | None, typer.Option(help="Name by which browsers call this computer, besides its own.")
    ] = None,
    stop_without_token: Annotated[
        bool, typer.Option("--stop-without-token", help="Whoever opens the page may stop, without the token.")
    ] = False,
    allow_start: Annotated[
        Path | None,
        typer.Option(help="Schedule that whoever has the token may start from the page. It heats the rig."),
    ] = None,
    foxglove: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=65535,
            help="Port of a live connection for Foxglove on this computer: 8765 is what it expects.",
        ),
    ] = None,
) -> None:
    """Show a run in a browser: camera, temperatures, contacts, and a button that stops the heating.

    The page only looks: the run does not depend on it.

    Example: eldir rig watch --rig rig.yaml
    """
    from eldir_app.watch.listening import WatchConfig, serve_page

    config = WatchConfig(rig_file, log, listen, tuple(host or ()), stop_without_token, allow_start, foxglove)
    serve_page(config, typer.echo)
