"""Names of components of other tools."""

import re
from collections.abc import Iterable
from itertools import chain, count

from pydantic import TypeAdapter, ValidationError

from cosim.systems.system import Name

_NAME: TypeAdapter[str] = TypeAdapter(Name)


def safe_names(names: Iterable[str]) -> dict[str, str]:
    """Map names of components to unique names that a system allows.

    Other characters become `_`; colliding names get a number.
    """
    names = list(dict.fromkeys(names))
    found = {name: name for name in names if _allowed(name)}
    taken = set(found)
    for name in names:
        if name in found:
            continue
        plain = re.sub(r"[^0-9A-Za-z_]", "_", name)
        plain = plain if _allowed(plain) else f"_{plain}"
        numbered = (f"{plain}_{k}" for k in count(2))
        found[name] = next(n for n in chain([plain], numbered) if n not in taken)
        taken.add(found[name])
    return found


def _allowed(name: str) -> bool:
    try:
        _NAME.validate_python(name)
    except ValidationError:
        return False
    return True
