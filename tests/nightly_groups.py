"""Groups of long tests that `tests/nightly.toml` keeps out of every gate."""

import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple


class Group(NamedTuple):
    """Tests of one group: whole files, and node ids with or without a case in brackets."""

    name: str
    files: frozenset[str]
    tests: frozenset[str]
    gate: frozenset[str]

    @property
    def entries(self) -> frozenset[str]:
        """All node ids that the group names."""
        return self.tests | self.gate

    def has(self, node_id: str) -> bool:
        """Return whether a test is run with this group only."""
        if node_id in self.gate or without_case(node_id) in self.gate:
            return False
        return (
            file_of(node_id) in self.files
            or node_id in self.tests
            or without_case(node_id) in self.tests
        )

    def missing_files(self, root: Path) -> list[str]:
        """Return the files of entries that are not there."""
        files = self.files | {file_of(entry) for entry in self.entries}
        return sorted(file for file in files if not (root / file).is_file())

    def unknown_entries(self, node_ids: Collection[str]) -> list[str]:
        """Return the node ids that name no test of the files that were collected entirely."""
        known = {*node_ids, *map(without_case, node_ids)}
        files = {file_of(node_id) for node_id in node_ids}
        return sorted(e for e in self.entries if file_of(e) in files and e not in known)


def file_of(node_id: str) -> str:
    """Return the file of a node id."""
    return node_id.partition("::")[0]


def without_case(node_id: str) -> str:
    """Return a node id without the case in brackets."""
    return node_id.partition("[")[0]


def read_groups(record: Path) -> dict[str, Group]:
    """Return the groups of a file by name."""
    tables = tomllib.loads(record.read_text(encoding="utf-8"))
    return {
        name: Group(
            name,
            files=frozenset(table.get("files", ())),
            tests=frozenset(table.get("tests", ())),
            gate=frozenset(table.get("gate", ())),
        )
        for name, table in tables.items()
    }
