"""Malicious FMUs: ours with `hostile.c` compiled in. Their hash marks them as foreign."""

import re
import zipfile
from pathlib import Path

from fmu_src.export import record
from fmu_src.export.toolchain import TARGETS, build

SOURCE = Path(__file__).with_name("hostile.c")

CALLS = {
    "fmi2DoStep": "fmi2_step.c",
    "fmi2GetReal": "fmi2_variables.c",
    "fmi2SetReal": "fmi2_variables.c",
    "fmi2Instantiate": "fmi2.c",
    "fmi2Terminate": "fmi2.c",
    "fmi2FreeInstance": "fmi2.c",
    "fmi2ExitInitializationMode": "fmi2.c",
    "fmi2GetFMUstate": "fmi2_state.c",
}
"""Functions that may misbehave, and their files."""

NOT_A_NUMBER = """
    if (getenv("DEED") && strcmp(getenv("DEED"), "fmi2GetReal nan") == 0) {
        for (size_t i = 0; i < n; i++) {
            value[i] = NAN;
        }
        return fmi2OK;
    }
"""

UNDEFINED = """
    if (getenv("DEED") && strncmp(getenv("DEED"), "CALL status ", sizeof "CALL status") == 0) {
        return (fmi2Status)atoi(getenv("DEED") + sizeof "CALL status");
    }
"""

FREED = """
    if (getenv("FREED")) {
        fclose(fopen(getenv("FREED"), "w"));
    }
"""


def infected(fmu: Path, copy: Path) -> Path:
    """Write a copy of one of our FMUs that misbehaves as set in the environment."""
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    folder = copy.with_suffix("")
    folder.mkdir(parents=True)
    for name, content in members.items():
        if name.startswith("sources/"):
            (folder / Path(name).name).write_bytes(content)
    for call, name in CALLS.items():
        file = folder / name
        text = file.read_text(encoding="utf-8")
        found = re.search(rf"\({call}\)[^;{{]*\{{", text)
        assert found, f"{name} has no {call}"
        more = f'misbehave("{call}");' + NOT_A_NUMBER * (call == "fmi2GetReal")
        if call == "fmi2FreeInstance":
            more += FREED
        elif call != "fmi2Instantiate":
            more += UNDEFINED.replace("CALL", call)
        file.write_text(text[: found.end()] + more + text[found.end() :], encoding="utf-8")
    all_c = folder / "all.c"
    all_c.write_text(SOURCE.read_text() + all_c.read_text(encoding="utf-8"), encoding="utf-8")
    library = next(name for name in members if name.startswith("binaries/linux64/"))
    members[library] = build(all_c, Path(library).stem, TARGETS["linux64"])
    members.pop(record.MEMBER, None)  # `hesr check` would name every change
    return archived(members, copy)


def archived(members: dict[str, bytes], path: Path) -> Path:
    """Write an archive as other tools do."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return path
