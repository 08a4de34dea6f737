"""Fixtures of several test modules: films of marks."""

from tests.hardware.vision.walking_films import filmed, first_film, recordings  # noqa: F401
