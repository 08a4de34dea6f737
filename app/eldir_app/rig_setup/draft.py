"""The rig file during its setup."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from eldir.core.files import read_file, require_folder, write_text
from eldir.core.validation import validate
from eldir.core.yaml_files import MAX_YAML_BYTES, parse_yaml, with_entries, with_section
from eldir.parameters.wiring import Connection
from eldir_app.options import load_real_rig
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import real_rig


class RigDraft:
    """A rig file that is written answer by answer; each version of it is a whole and valid rig file."""

    def __init__(self, path: Path):
        """Raises `InputError` for an existing file that is no rig file of a real board."""
        self.path = path
        self._rig: Rig | None = None
        if not path.exists():
            require_folder(path)
            return
        self._rig, _ = load_real_rig(path)

    @property
    def is_begun(self) -> bool:
        """Whether the file exists."""
        return self._rig is not None

    @property
    def rig(self) -> Rig:
        """The rig as it is in the file now."""
        if self._rig is None:
            raise ValueError("the rig file is not begun")
        return self._rig

    def begin(self, board: str, port: str, in_series: bool) -> None:
        """Write a new file."""
        self._write(real_rig(board, port, in_series=in_series))

    def set_entries(self, section: str, entries: Mapping[str, float | str | None]) -> None:
        """Set entries of a section. Raises `InputError` for a value that the rig file may not have."""
        self._write(with_entries(self._read(), section, entries))

    def set_section(self, section: str, value: Any) -> None:
        """Replace a section. Raises `InputError` for values that the rig file may not have."""
        self._write(with_section(self._read(), section, value))

    def set_channels(self, connections: Iterable[Connection]) -> None:
        """Replace the wiring."""
        self.set_section(
            "channels", [{"channel": c.channel, "spring": c.spring, "face": c.face} for c in connections]
        )

    def _read(self) -> str:
        return read_file(self.path, MAX_YAML_BYTES).decode("utf-8-sig")

    def _write(self, text: str) -> None:
        name = self.path.name
        rig = validate(Rig, parse_yaml(text.encode(), name), name, remedy="give another value")
        write_text(self.path, text)
        self._rig = rig
