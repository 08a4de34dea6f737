"""The simulation on all cores; the only place that knows Taichi. Nothing starts on import."""

from eldir.engine import runtime  # noqa: F401  loads Taichi quietly, before any other module does
