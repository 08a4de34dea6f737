"""Errors that a test expects."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from eldir.errors import EldirError


@contextmanager
def raises(
    kind: type[EldirError], code: str, key: str | None = None, match: str | None = None
) -> Iterator[pytest.ExceptionInfo[EldirError]]:
    """The code within raises an error of this kind, code and key, in one line. `match`: where a value in the
    line, such as the file or the number that was found, is a part of what is tested."""
    with pytest.raises(kind, match=match or None) as raised:
        yield raised
    error = raised.value
    assert (error.code, error.key) == (code, key), error
    assert "\n" not in str(error)
