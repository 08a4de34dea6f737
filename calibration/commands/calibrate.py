"""The command group `eldir calibrate`."""

from __future__ import annotations

from importlib.metadata import entry_points

import typer

GROUP = "eldir.commands.calibrate"
_ORDER = ["camera", "plane", "springs", "dynamics"]


def _group() -> typer.Typer:
    """The group with every installed sub-command (entry-point group `eldir.commands.calibrate`)."""
    group = typer.Typer(
        no_args_is_help=True,
        help="Find the parameters of the camera, the plane of motion, the springs and the robot.",
    )
    found = {point.name: point for point in entry_points(group=GROUP)}
    for name in sorted(found, key=lambda n: (_ORDER.index(n) if n in _ORDER else len(_ORDER), n)):
        group.command(name)(found[name].load())
    return group


calibrate = _group()
