"""The record of an FMU: its sources, and the hashes of its other members."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

from hesr_model.support.text import parse_json, quote

MEMBER = "extra/org.hesr.record/record.json"
_FORMAT = "hesr-record-1"


def write_record(members: Mapping[str, bytes], origin: Mapping[str, Any]) -> bytes:
    """Return the record of an FMU with these members, made from `origin`, as JSON."""
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in members.items()}
    record = {"format": _FORMAT, **origin, "sha256": dict(sorted(hashes.items()))}
    return json.dumps(record, indent=1, ensure_ascii=False).encode() + b"\n"


def find_changes(record: bytes, hashes: Mapping[str, str]) -> Iterator[str]:
    """Yield how members differ from their record: changed, missing or added ones.

    Parameters
    ----------
    record : content of `MEMBER`.
    hashes : SHA-256 of the other members by name.

    Raises
    ------
    ValueError
        If the record is not one.
    """
    data = parse_json(record)
    if not isinstance(data, dict) or data.get("format") != _FORMAT:
        raise ValueError("it is not a record of this version")
    recorded = data.get("sha256")
    if not isinstance(recorded, dict):
        raise ValueError("it has no hashes")
    for name in sorted({*recorded, *hashes}):
        if name not in hashes:
            yield f"{quote(name)} is missing"
        elif name not in recorded:
            yield f"{quote(name)} was added"
        elif recorded[name] != hashes[name]:
            yield f"{quote(name)} was changed"
