"""The C header: bitwise equal to the FMU on two processors, and on a bare-metal Cortex-M7."""

import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_hosts import build_host
from compiled_header import CompiledHeader
from documents import blocks
from fmpy import read_model_description
from one_file_laws import STEP, first_torques_of, inputs, maxwell_slip, torques_of

from fmu_src.friction.friction_fmu import export_bare
from hesr.extras.one_file.c_header import export_c
from hesr_model.errors import ArtifactError, ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.compiler import compile_c

HERE = Path(__file__).parent
QEMU = shutil.which("qemu-aarch64")
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")  # from Debian's libc6-arm64-cross
M7_COMPILER, M7_MACHINE = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")


@pytest.fixture(scope="module")
def every(every_model, tmp_path_factory) -> CompiledHeader:
    return CompiledHeader(every_model, tmp_path_factory.mktemp("header"))


def test_every_law_is_bitwise_equal_to_the_fmu(every, every_model, every_fmu) -> None:
    rows = inputs(len(every_model.joints), seconds=4.0)
    state = every.state()
    found = np.array([every.step(state, *row, STEP) for row in zip(*rows, strict=True)])
    np.testing.assert_array_equal(found, torques_of(every_fmu, rows))


@pytest.mark.parametrize("robots", [1, 8, 19])
def test_a_batch_of_robots_equals_single_robots(every, robots: int) -> None:
    rows = [row[: 40 * robots].reshape(40, robots, -1) for row in inputs(every.joints, seconds=4.0)]
    x, alone = every.start(robots), [every.state() for _ in range(robots)]
    for dq, q, load in zip(*rows, strict=True):
        count, tau = every.side_by_side(x, dq.T, q.T, load.T, STEP)
        assert count == robots
        for i, state in enumerate(alone):
            expected = every.step(state, dq[i], q[i], load[i], STEP)
            np.testing.assert_array_equal(tau[:, i], expected)


def test_sines_of_huge_angles_equal_those_of_the_fmu(every) -> None:
    """Their sines are those of the C library, on a separate branch; other robots are unaffected."""
    dq, q, load = (row[100:119].T.copy() for row in inputs(every.joints, seconds=2.0))
    whole, some = every.start(19), every.start(19)
    _, near = every.side_by_side(whole, dq, q, load, STEP)
    q[:, 9] += 3e6
    count, tau = every.side_by_side(some, dq, q, load, STEP)
    expected = every.step(every.state(), dq[:, 9].copy(), q[:, 9].copy(), load[:, 9].copy(), STEP)
    assert count == 19
    np.testing.assert_array_equal(tau[:, 9], expected)
    others = np.arange(19) != 9
    np.testing.assert_array_equal(tau[:, others], near[:, others])
    np.testing.assert_array_equal(some[:, others], whole[:, others])
    assert not np.array_equal(tau[:, 9], near[:, 9])


def test_a_failed_robot_leaves_its_batch_unchanged(every) -> None:
    dq, q, load = (row[100:119].T.copy() for row in inputs(every.joints, seconds=2.0))
    whole, some = every.start(19), every.start(19)
    _, expected = every.side_by_side(whole, dq, q, load, STEP)
    dq[0, 9] = np.nan
    count, tau = every.side_by_side(some, dq, q, load, STEP)
    assert count == 11
    others = np.r_[0:8, 16:19]
    np.testing.assert_array_equal(tau[:, others], expected[:, others])
    np.testing.assert_array_equal(some[:, others], whole[:, others])
    np.testing.assert_array_equal(some[:, 8:16], every.start(8))
    assert np.isnan(tau[:, 8:16]).all()
    for dt in (0.0, -STEP, np.nan):
        assert every.side_by_side(some, dq, q, load, dt)[0] == 0


def test_the_start_in_motion_equals_that_of_the_fmu(every, every_fmu) -> None:
    rows = inputs(every.joints, seconds=1.5)
    for k in (0, 220, 299):  # in motion, at rest, in motion
        row, state = [r[k] for r in rows], every.state()
        before = bytes(state)
        every.begin(state, *row)
        assert (bytes(state) == before) is (k == 220)
        found = every.step(state, *row, 0.0)
        np.testing.assert_array_equal(found, first_torques_of(every_fmu, row))


def test_an_impossible_step_changes_nothing(table1, tmp_path) -> None:
    law, rows = CompiledHeader(table1, tmp_path), np.full((3, 3), 0.3)
    state = law.state()
    law.step(state, *rows, STEP)
    before = bytes(state)
    assert law.step(state, *rows, 0.2) is None  # alpha of joint 2 is 19.62 1/s
    assert law.step(state, *rows, -STEP) is None
    assert law.step(state, rows[0] * np.nan, *rows[1:], STEP) is None
    assert bytes(state) == before
    assert law.step(state, *rows, 0.0) is not None
    assert bytes(state) == before  # reading has no side effect


def test_a_batch_of_table_1_equals_single_robots(every) -> None:
    rows = inputs(every.joints, seconds=0.5)
    rows = [row[::10] for row in rows]  # one row per robot
    states = every.state(len(rows[0]))
    for _ in range(3):
        count, tau = every.batch(states, *rows, STEP)
    assert count == len(tau)
    for i, row in enumerate(zip(*rows, strict=True)):
        state = every.state()
        for _ in range(3):
            alone = every.step(state, *row, STEP)
        np.testing.assert_array_equal(alone, tau[i])


def test_the_data_next_to_the_header_are_the_torques_of_the_fmu(every_model, every_fmu, tmp_path):
    path = export_c(every_model, tmp_path / "law.h").with_suffix(".csv")
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    rows, tau = np.split(table[:, 1:], 4, axis=1)[:3], np.split(table[:, 1:], 4, axis=1)[3]
    found = torques_of(every_fmu, [row[1:] for row in rows])
    assert np.all(np.abs(found - tau[1:]).max(axis=0) <= 1e-12 * np.abs(tau).max(axis=0))
    varies = [law.name not in ("none", "constant") for law in every_model.laws]
    assert np.ptp(tau, axis=0)[varies].min() > 0.1


def test_two_headers_share_one_c_plus_plus_program(table1, make_model, tmp_path) -> None:
    export_c(table1, tmp_path / "one.h")
    export_c(make_model(maxwell_slip()), tmp_path / "two.h")
    text = '#include "one.h"\n#include "two.h"\nint main() { one_state a; two_state b; '
    text += "one_init(&a); two_init(&b); return 0; }\n"
    (tmp_path / "both.cpp").write_text(text, encoding="utf-8")
    flags = ("-x", "c++", "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror",
             "-Wno-unused-function", "-c")  # fmt: skip
    compile_c(tmp_path / "both.cpp", flags, tmp_path / "both.o")


CONTROLLER = """
#include <stdio.h>
int main(void) {
    const double q[3] = {0.1, 0.2, 0.3}, dq[3] = {0.4, -0.5, 0.6}, model[3] = {1.0, 2.0, 3.0};
    const double feedback[3] = {0.1, 0.2, 0.3};
    double tau[3], rubbing[3];
    friction_state other;
    start();
    friction_init(&other);
    for (int k = 0; k < 50; k++) {
        control(q, dq, model, feedback, tau);
        friction_step(&other, dq, q, model, 0.005, rubbing);
    }
    for (int i = 0; i < 3; i++) {
        if (tau[i] != model[i] + feedback[i] + rubbing[i] || rubbing[i] == 0.0) {
            return 1;
        }
    }
    puts("well");
    return 0;
}
"""


def test_the_documented_controller_works(table1, tmp_path) -> None:
    export_c(table1, tmp_path / "friction.h")
    [block] = (b for b in blocks("c") if "friction_init(&friction)" in b.text)
    source = tmp_path / "controller.c"
    source.write_text(block.text + CONTROLLER, encoding="utf-8")
    flags = ("-target", "x86_64-linux-gnu.2.17", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror",
             "-Wno-unused-function")  # fmt: skip
    compile_c(source, flags, tmp_path / "controller", ("-lm",))
    assert _lines(tmp_path / "controller") == ["well"]


# --- other processors -------------------------------------------------------------------------


def _program(model: FrictionModel, folder: Path, triple: str, steps: int) -> Path:
    export_c(model, folder / "law.h")
    source = folder / "host.c"
    source.write_text((HERE / "header_host.c").read_text(encoding="utf-8"), encoding="utf-8")
    flags = (
        "-target",
        triple,
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-DSTEPS={steps}",
        f"-I{HERE.parent}",
    )
    compile_c(source, flags, folder / "host", ("-lm",))
    return folder / "host"


def _lines(*command: object) -> list[str]:
    result = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, check=False, timeout=120
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


@pytest.mark.ci
@pytest.mark.skipif(
    QEMU is None or not ARM_LIBRARIES.is_dir(),
    reason="qemu-user and the C library of 64-bit ARM are not installed",
)
def test_arm_linux_is_bitwise_equal_to_the_fmu(every_law, make_model, tmp_path) -> None:
    """Both run on the same emulated processor with the same C library."""
    triple, run = "aarch64-linux-gnu.2.17", (QEMU, "-L", ARM_LIBRARIES)
    names = ("parfam_cos", "viscous", "elements", "fitted_lugre_load_ripple")
    chosen = make_model(*(every_law[name] for name in names), maxwell_slip())
    fmu = export_bare(chosen, tmp_path / "F.fmu", platforms=["aarch64-linux"])
    with zipfile.ZipFile(fmu) as archive:
        library = archive.extract("binaries/aarch64-linux/friction_by_hand.so", tmp_path)
    about = read_model_description(str(fmu))
    tau = [v.valueReference for v in about.modelVariables if v.name.startswith("tau[")]
    host = build_host("host.c", tmp_path, triple)
    expected = _lines(*run, host, library, about.guid, len(tau), tau[0], 500)
    (tmp_path / "header").mkdir()
    assert _lines(*run, _program(chosen, tmp_path / "header", triple, 500)) == expected


@pytest.mark.ci
@pytest.mark.skipif(
    M7_COMPILER is None or M7_MACHINE is None,
    reason="gcc-arm-none-eabi and qemu-system-arm are not installed",
)
def test_a_bare_metal_cortex_m7_matches(table1, tmp_path, capsys) -> None:
    steps, m7 = 500, HERE / "m7"
    here = _lines(_program(table1, tmp_path, "x86_64-linux-gnu.2.17", steps))
    command = [
        M7_COMPILER,
        "-mcpu=cortex-m7",
        "-mfpu=fpv5-d16",
        "-mfloat-abi=hard",
        "-std=c99",
        "-O2",
        "-ffp-contract=off",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-DSTEPS={steps}",
        "-DCOUNTER",
        *(f"-I{folder}" for folder in (tmp_path, HERE.parent, m7)),
        "--specs=rdimon.specs",
        "-nostartfiles",
        f"-T{m7 / 'mps2.ld'}",
        HERE / "header_host.c",
        m7 / "start.c",
        "-lm",
        "-o",
        tmp_path / "m7.elf",
    ]
    assert _lines(*command) == []
    *lines, counted = _lines(
        M7_MACHINE,
        "-machine",
        "mps2-an500",
        "-nographic",
        "-semihosting",
        "-icount",
        "shift=0",
        "-kernel",
        tmp_path / "m7.elf",
    )
    found, expected = (np.array([row.split() for row in text], float) for text in (lines, here))
    # The C libraries differ in the last digits.
    assert np.all(np.abs(found - expected).max(axis=0) <= 1e-13 * np.abs(expected).max(axis=0))
    with capsys.disabled():
        print(f"\nTable I, three joints, on a Cortex-M7: {counted}")  # noqa: T201
    assert 100 < int(counted.split()[0]) < 3000


# --- refusals ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("law.c", "header ends in .h, found '.c'"),
        ("my-law.h", "'my-law' is not a valid C name"),
    ],
)
def test_invalid_names_are_refused(table1, tmp_path, name, sentence) -> None:
    with pytest.raises(ExportError) as caught:
        export_c(table1, tmp_path / name)
    assert sentence in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_unwritable_data_leave_no_header(table1, tmp_path) -> None:
    (tmp_path / "law.csv").mkdir()
    with pytest.raises(ArtifactError, match="cannot be written"):
        export_c(table1, tmp_path / "law.h")
    assert [path.name for path in tmp_path.iterdir()] == ["law.csv"]


def test_a_law_without_finite_torques_is_refused(make_model, make_law, tmp_path) -> None:
    law = make_law("viscous")
    law = replace(law, values=law.values | {"sigma_2": 1e99, "F_c": 1e99})
    law = replace(law, form=replace(law.form, output=law.form.output**5))
    with pytest.raises(ExportError, match="finite at speeds up"):
        export_c(make_model(law), tmp_path / "law.h")
    assert not list(tmp_path.iterdir())


def test_texts_cannot_close_a_comment(make_law, tmp_path) -> None:
    model = FrictionModel(
        law="x", robot="a */ b", joints=("j \\",), laws=(make_law("bare"),), sample_time=STEP
    )
    law = CompiledHeader(model, tmp_path)
    one = np.ones(1)
    assert law.step(law.state(), one, one, one, STEP) == [3.0]
