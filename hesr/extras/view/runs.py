"""Selection of the runs of a closed loop to show."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.loop.closed_loop import ARM, StandIn
from cosim.loop.traces import TRACES, Trace, read_traces
from cosim.report.tables.table import title
from fmu_src.run.archive import Archive
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.rigid_body.identification import RigidBody

_SCHEME = "servo_inversion"  # scheme with the largest effect of models
_MODEL = "resources/model.xml"
_MOST = 4  # arms side by side


@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """Options of `show_arm`."""

    laws: Sequence[str] = ()
    scheme: str | None = None
    magnify: float = 1.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        for name, value in (("magnify", self.magnify), ("speed", self.speed)):
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"--{name} is {value:g}; it must be positive.")


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Runs to show, by title of the law."""

    mjcf: str
    joints: Sequence[str]
    scheme: str
    runs: Mapping[str, Trace]


def choose(folder: Path, choice: ViewOptions) -> Shown:
    """Read the runs to show."""
    if not folder.is_dir():
        raise ArtifactError(f"{folder}: no such folder; give a result of 'hesr run'.")
    traces = read_traces(folder / TRACES)
    schemes = list(dict.fromkeys(scheme.name for scheme, _ in traces))
    scheme = choice.scheme or (_SCHEME if _SCHEME in schemes else schemes[-1])
    if scheme not in schemes:
        raise ConfigError(f"--scheme is '{scheme}'; there are {_listed(schemes)} in {folder}.")
    of_scheme = {law: trace for (s, law), trace in traces.items() if s.name == scheme}
    laws = list(choice.laws) or _telling(of_scheme)
    for law in laws:
        if law not in of_scheme:
            raise ConfigError(
                f"--law is '{law}'; with scheme '{scheme}' there are {_listed(of_scheme)} in "
                f"{folder}."
            )
    if len(laws) > _MOST:
        raise ConfigError(f"--law is given {len(laws)} times; at most {_MOST} fit side by side.")
    return Shown(
        mjcf=_mjcf(folder / "fmus" / ARM),
        joints=RigidBody.read(folder / "rigid_body.json").joints,
        scheme=scheme,
        runs={title(law): of_scheme[law] for law in laws},
    )


def _telling(runs: Mapping[str, Trace]) -> list[str]:
    errors = {
        law: float(np.sqrt(np.mean((trace.q - trace.q_d) ** 2)))
        for law, trace in runs.items()
        if law not in set(StandIn)
    }
    best = min(errors, key=lambda law: errors[law], default=None)
    chosen = [law for law in (StandIn.BODY_ONLY, best) if law in runs]
    return [law for law in chosen if law is not None] or list(runs)[:1]


def _mjcf(fmu: Path) -> str:
    if not fmu.is_file():
        raise ArtifactError(f"{fmu}: no such file; rerun 'hesr run'.")
    with Archive(fmu) as archive:
        content = archive.read(_MODEL) if _MODEL in archive.names else b""
    with suppress(UnicodeDecodeError):
        if text := content.decode("utf-8"):
            return text
    raise ArtifactError(f"{fmu}: holds no {_MODEL} to show.")


def _listed(names: Sequence[str] | Mapping[str, object]) -> str:
    return ", ".join(f"'{name}'" for name in names)
