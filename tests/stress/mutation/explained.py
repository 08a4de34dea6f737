"""Mutants that no test needs to notice: the reviewed list, one reason each."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import yaml

from eldir.core.yaml_files import PlainLoader
from tests.stress.mutation.mutants import Mutant

FILE = Path(__file__).with_name("explained.yaml")
Key = tuple[str, str, str, str, int]


def read_entries(path: Path = FILE) -> dict[str, Any]:
    """Module, place and entries. Raises `yaml.YAMLError` where a module or a place stands twice."""
    return yaml.load(path.read_text(), PlainLoader) or {}


class Explained:
    """Entries of the file by mutant: `equivalent` ones cannot be noticed, `accepted` ones survive."""

    def __init__(self, mutants: Iterable[Mutant], path: Path = FILE):
        """Raises `ValueError` for an entry that names no mutant, or that another entry names too."""
        known = {m.key for m in mutants}
        modules = {key[0] for key in known}
        self.equivalent: dict[Key, str] = {}
        self.accepted: dict[Key, str] = {}
        for module, places in read_entries(path).items():
            for where, entries in places.items() if module in modules else ():
                for entry in entries:
                    for number in entry.get("numbers", [1]):
                        key = (module, where, entry["before"], entry["after"], number)
                        if key not in known:
                            raise ValueError(f"{path.name}: there is no such mutant any more: {key}")
                        if key in self.equivalent | self.accepted:
                            raise ValueError(f"{path.name}: explained twice: {key}")
                        kind = "equivalent" if "equivalent" in entry else "accepted"
                        getattr(self, kind)[key] = entry[kind]
