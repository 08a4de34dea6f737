"""The context manager of what is opened and closed: a log, a camera, the guardian's process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from eldir.errors import EldirError


class Resource(ABC):
    """Something that is used between `open` and `close`, or in a `with` statement."""

    @abstractmethod
    def open(self) -> None:
        """Acquire the resource. Raises `EldirError` if this fails."""

    @abstractmethod
    def close(self) -> None:
        """Release the resource."""

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except EldirError as failure:
            if error is None:
                raise
            error.add_note(str(failure))  # printed behind the first error
