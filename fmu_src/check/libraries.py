"""Libraries that every installation of an operating system has."""

import re

_ELF = re.compile(
    r"(libc|libm|libdl|libpthread|librt|libutil|libresolv|libgcc_s|libstdc\+\+|libc\+\+|"
    r"linux-vdso|ld-linux[a-z0-9_-]*|ld-musl[a-z0-9_-]*)\.so(\.[0-9]+)*"
)
_PE = re.compile(
    r"(kernel32|kernelbase|ntdll|user32|gdi32|advapi32|shell32|shlwapi|ole32|oleaut32|ws2_32|"
    r"msvcrt|ucrtbase|bcrypt|crypt32|rpcrt4|winmm|version|psapi|dbghelp|iphlpapi|comdlg32|"
    r"comctl32|setupapi|secur32|userenv|wsock32|mswsock|powrprof|api-ms-win-[a-z0-9-]+|"
    r"ext-ms-win-[a-z0-9-]+|bcryptprimitives|cfgmgr32|imm32|netapi32|opengl32|pdh|uxtheme|wininet|"
    r"winhttp|normaliz|propsys|sechost|wldap32)\.dll",
    re.IGNORECASE,
)
_MACH_O = re.compile(r"/usr/lib/.*|/System/Library/.*", re.DOTALL)
_USUAL = {"ELF": _ELF, "PE": _PE, "Mach-O": _MACH_O}

_PYTHON = re.compile(r"(lib)?python[0-9._]*[a-z]*(\.so|\.dll|\.dylib).*|Python", re.IGNORECASE)


def is_usual(name: str, binary_format: str) -> bool:
    """Whether a library is part of the system that loads this format."""
    return bool(_USUAL[binary_format].fullmatch(name))


def is_python(name: str) -> bool:
    """Whether a library is that of the Python interpreter."""
    return bool(_PYTHON.fullmatch(name.rpartition("/")[2]))
