"""Fixtures of several test modules: a walker's film, and the scene identified from it."""

from tests.eldir.built.filmed_walker import recording, scene  # noqa: F401
