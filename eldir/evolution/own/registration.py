"""The installed problems: entry points of the group `eldir.problems`, of any package.

A package adds a problem with one line in its pyproject.toml; the name on the left is the problem's name:

    [project.entry-points."eldir.problems"]
    tall = "my_robots.tall:TallRobots"
"""

from __future__ import annotations

from eldir.core.entry_points import load_registered
from eldir.evolution.own.vectors import VectorProblem

GROUP = "eldir.problems"


def load_problem(name: str) -> VectorProblem:
    """The installed problem of that name. Raises `InputError` with the installed names for an unknown one,
    and for one that cannot be loaded. A name is not a module: a run folder cannot have other code run."""
    return load_registered(GROUP, name, "problem", VectorProblem, lambda problem: problem())  # type: ignore[type-abstract]
