"""MuJoCo's clock is disabled while a system of FMUs runs."""

import ctypes
import subprocess
import sys
from pathlib import Path
from threading import Barrier, Thread

import mujoco
import pytest

from fmu_src.arm.clock import stop_clock
from fmu_src.arm.library import find_host_libraries

ARM = """<mujoco><worldbody><body><joint/><geom size=".1"/></body></worldbody></mujoco>"""


def pointer() -> int | None:
    """MuJoCo's own pointer to its clock."""
    return ctypes.c_void_p.in_dll(ctypes.CDLL(str(find_host_libraries()[-1])), "mjcb_time").value


def timed() -> float:
    """Time of several steps as measured by MuJoCo [s]."""
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=50)
    return float(data.timer[mujoco.mjtTimer.mjTIMER_STEP].duration)


def test_the_clock_is_restored_afterwards() -> None:
    before = pointer()
    assert before
    assert timed() > 0.0
    with stop_clock():
        assert pointer() is None
        assert timed() == 0.0
        with stop_clock():
            assert pointer() is None
        assert pointer() is None
    assert pointer() == before
    assert timed() > 0.0


def test_the_clock_is_restored_after_an_error() -> None:
    before = pointer()
    with pytest.raises(ValueError, match="stopped"), stop_clock():
        raise ValueError("stopped")
    assert pointer() == before


def test_concurrent_users_share_the_clock() -> None:
    before, together, seen = pointer(), Barrier(8), []

    def use() -> None:
        for _ in range(200):
            together.wait()
            with stop_clock():
                seen.append(pointer())

    threads = [Thread(target=use) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(seen) == {None}
    assert pointer() == before


def test_nothing_is_loaded_without_the_package(tmp_path: Path) -> None:
    code = (
        "import sys\nfrom fmu_src.arm.clock import stop_clock\n"
        "with stop_clock():\n    print('mujoco' in sys.modules)\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert found.stdout.strip() == "False"
