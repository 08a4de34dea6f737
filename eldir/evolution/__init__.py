"""Evolution of populations: search, the loop over generations, run folders, their analysis and figures.

How one robot learns is in `eldir.learning` and `eldir.training`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_PUBLIC = {
    "Evolution": "search",
    "Search": "search",
    "evolve": "loop",
    "resume": "loop",
    "RunFolder": "run_folder",
    "load_run": "designs",
    "load_generation": "run_folder",
    "read_history": "history",
}


def __getattr__(name: str) -> Any:
    """Public names load their module when they are first used: the command imports this package to read
    `defaults`, and must not load NumPy for it."""
    if name in _PUBLIC:
        return getattr(import_module(f"eldir.evolution.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])
