"""FMUs as WebAssembly modules for pages, and that of a rigid body: the InverseDynamics FMU."""

import base64
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fmu_src.blocks.inverse_dynamics import inverse_dynamics
from fmu_src.export.package import Content, own_source, translation_unit
from fmu_src.export.toolchain import build_wasm
from hesr_model.errors import ExportError
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.files import scratch_folder


def wasm(sources: Mapping[str, str]) -> bytes:
    """Compile the C files of `package.translation_unit` to a WebAssembly module without imports.

    It exports the functions of `c/live.c` around those of FMI.
    """
    with scratch_folder() as folder:
        for name, text in (*sources.items(), ("live.c", own_source("live.c"))):
            (folder / name).write_text(text, encoding="utf-8")
        powers = any(re.search(r"\bpow\(", text) for text in sources.values())
        return build_wasm(folder / "live.c", powers=powers)


def packed(module: bytes) -> str:
    """Return a module as text for embedding in pages."""
    return base64.b64encode(zlib.compress(module, 9)).decode()


@dataclass(frozen=True, kw_only=True)
class PageBody:
    """A rigid body's InverseDynamics FMU for pages; the cut-off filters the robot's logs [Hz]."""

    joints: Sequence[str]
    fmu: Content
    cutoff: float

    @classmethod
    def of(cls, robot: Robot, body: RigidBody) -> "PageBody":
        """Return the body of a robot; RobotError if `body` belongs to another robot."""
        return cls(
            joints=robot.description.joints,
            fmu=inverse_dynamics(robot, body.parameters_for(robot)),
            cutoff=robot.description.log.filter_cutoff,
        )

    @property
    def key(self) -> dict[str, object]:
        """Return everything that determines the page, as JSON data."""
        return {"cutoff": self.cutoff, **self.files}

    @property
    def files(self) -> dict[str, str]:
        """Return its C files by name, which define everything but the cut-off."""
        return translation_unit(self.fmu)[1]

    def data(self, joints: Sequence[str]) -> dict[str, Any]:
        """Return the data for a page: the module and the connectors of each joint."""
        if tuple(joints) != tuple(self.joints):
            raise ExportError(
                f"the rigid body has the joints {', '.join(self.joints)}, but the friction model "
                f"has {', '.join(joints)}: they belong to different robots."
            )
        places = self.fmu.table.places
        return {
            "module": packed(wasm(self.files)),
            "joints": [
                {"references": {x: places[f"{x}[{i}]"] for x in ("q", "dq", "ddq", "tau")}}
                for i, _ in enumerate(joints, start=1)
            ],
        }
