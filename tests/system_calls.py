"""Numbers of system calls, from the kernel's headers that the C compiler carries."""

import re
from importlib.resources import files

_FOLDERS = {"x86_64": "x86-linux-any", "aarch64": "aarch64-linux-any"}


def read_numbers(processor: str) -> dict[str, int]:
    """Return the numbers of system calls by name for 'x86_64' or 'aarch64'."""
    headers = files("ziglang") / "lib" / "libc" / "include" / _FOLDERS[processor] / "asm"
    text = (headers / "unistd_64.h").read_text(encoding="utf-8")
    return {name: int(n) for name, n in re.findall(r"#define __NR_(\w+)\s+(\d+)", text)}
