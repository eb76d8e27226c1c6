"""An open and a closed system and their packages."""

from collections.abc import Callable
from pathlib import Path

import pytest
from closed_loop import MOTION, Bench
from small_fmus import LAGS
from small_study import Hesr, hesr_here

from cosim.loop.closed_loop import Scheme
from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.blocks.trajectory import start_values
from hesr.extras.ssp.contents import SystemContents, read_contents

Write = Callable[..., Path]


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def lags(tmp_path: Path, lag_fmu: Path) -> Write:
    """Write a system of two lags, the second half as fast, with some text replaced."""

    def file(*changes: tuple[str, str]) -> Path:
        text = LAGS
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "lags.toml"
        path.write_text(text.replace("FMU", str(lag_fmu)), encoding="utf-8")
        return path

    return file


@pytest.fixture(scope="session")
def closed(bench: Bench) -> SystemContents:
    """The whole loop with model feed-forward through the inverse of the servo."""
    spec = bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))
    return read_contents(spec.model_copy(update={"name": "closed"}), Path("closed.toml"))


@pytest.fixture(scope="session")
def opened(bench: Bench) -> SystemContents:
    """A motion that drives friction."""
    spec = SystemSpec(
        name="open",
        step=0.005,
        stop=10.0,
        components=(
            ComponentSpec(name="trajectory", fmu=bench.fmus.trajectory, start=start_values(MOTION)),
            ComponentSpec(name="friction", fmu=bench.fmus.friction, start={"tau_load": 1.5}),
        ),
        connections={"friction.dq": "trajectory.dq", "friction.q": "trajectory.q"},
        observe=("trajectory.dq", "friction.tau"),
    )
    return read_contents(spec, Path("open.toml"))


@pytest.fixture(params=["opened", "closed"], ids=["open", "closed"])
def either(request: pytest.FixtureRequest) -> SystemContents:
    found: SystemContents = request.getfixturevalue(request.param)
    return found
