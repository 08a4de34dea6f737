"""Errors that a user may meet. Each prints one line: what happened, what was expected, what was found, what
to do."""

_LONGEST = 400  # characters of what was found


class EldirError(Exception):
    """A failure that the user can act on; the command prints it in one line and exits with 1."""

    def __init__(
        self,
        problem: str,
        *,
        expected: str | None = None,
        found: str | None = None,
        remedy: str | None = None,
    ):
        parts = [problem]
        if expected is not None:
            parts.append(f"expected {expected}")
        if found is not None:
            parts.append(f"found {_shortened(found)}")
        if remedy is not None:
            parts.append(remedy)
        super().__init__("; ".join(parts))


def _shortened(found: str) -> str:
    """What was found, on one line of a readable length: it may come from a damaged file."""
    line = " ".join(found.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 3]}..."


class InputError(EldirError):
    """An argument, an option or a file is wrong."""


class MissingDependencyError(EldirError):
    """An optional package is needed, and it is not installed."""
