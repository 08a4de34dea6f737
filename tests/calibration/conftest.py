"""Fixtures of several test modules: films of marks, and a walker's film with the scene identified from it."""

from tests.eldir.built.filmed_walker import recording, scene  # noqa: F401
from tests.hardware.vision.walking_films import filmed, first_film  # noqa: F401
