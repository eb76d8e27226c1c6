"""C headers that are independent of FMI, compiled separately."""

import ctypes
from collections.abc import Mapping
from pathlib import Path

from fmu_src.export.package import read_c_source
from fmu_src.export.toolchain import TARGETS, build

UNUSED = '#pragma clang diagnostic ignored "-Wunused-function"\n'
COMPONENT = """
#ifndef COMPONENT_H
#define COMPONENT_H
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
typedef struct { char text[256]; } Message;
static inline bool deny(Message *why, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(why->text, sizeof why->text, format, arguments);
    va_end(arguments);
    return false;
}
#endif
"""


def compiled(
    folder: Path, text: str, *headers: str, others: Mapping[str, str] | None = None
) -> ctypes.CDLL:
    """Load C functions that use headers of the project; further files replace others."""
    files = {name: read_c_source(name) for name in headers} | {"component.h": COMPONENT}
    exported = text.replace("EXPORT ", '__attribute__((visibility("default"))) ')
    for name, content in (files | dict(others or {}) | {"pure.c": UNUSED + exported}).items():
        (folder / name).write_text(content, encoding="utf-8")
    library = folder / "pure.so"
    library.write_bytes(build(folder / "pure.c", "pure", TARGETS["linux64"]))
    return ctypes.CDLL(str(library))


def function(library: ctypes.CDLL, name: str, result: type, *arguments: type) -> ctypes._CFuncPtr:
    found = getattr(library, name)
    found.restype, found.argtypes = result, arguments
    return found
