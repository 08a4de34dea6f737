"""The installed problems: entry points of the group `eldir.problems`, of any package.

A package adds a problem with one line in its pyproject.toml; the name on the left is the problem's name:

    [project.entry-points."eldir.problems"]
    tall = "my_robots.tall:TallRobots"
"""

from __future__ import annotations

from importlib.metadata import entry_points

from eldir.core.arguments import require_known
from eldir.errors import InputError
from eldir.evolution.own.vectors import VectorProblem

GROUP = "eldir.problems"


def load_problem(name: str) -> VectorProblem:
    """The installed problem of that name. Raises `InputError` with the installed names for an unknown one,
    and for one that cannot be loaded. A name is not a module: a run folder cannot have other code run."""
    points = {point.name: point for point in entry_points(group=GROUP)}
    remedy = "correct the name, or install the package that provides the problem"
    require_known("problem", name, sorted(points) or ["the name of an installed one: there is none"], remedy)
    point = points[name]
    try:
        found = point.load()()
    except (Exception, SystemExit) as error:  # another package's code runs here
        found = error
    if not isinstance(found, VectorProblem):
        raise InputError(
            f"the problem {name} cannot be loaded from {point.value}",
            code="package.broken",
            expected="a subclass of eldir.evolution.own.vectors.VectorProblem that takes no arguments",
            found=f"{type(found).__name__}: {found}",
            remedy="repair or remove the package that provides it",
        )
    return found
