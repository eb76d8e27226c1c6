"""Display of the arm of a closed loop: choice of runs, poses, videos and refusals."""

import ctypes.util
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import types
import zipfile
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import PIL.Image
import pyarrow.parquet
import pytest
from containing import Containing, OneSentence
from processes import HANG, wait_for_line
from small_study import Hesr, hesr_here

from cosim.loop.closed_loop import Scheme, StandIn
from cosim.loop.loops import assemble, build, motions
from cosim.loop.traces import TRACES, Tracked, read_traces, write_traces
from cosim.study.study import Study
from fmu_src import export_fmu, model_file
from fmu_src.arm.native import export_mjcf
from fmu_src.arm.plant import Plant
from fmu_src.arm.truth import true_friction
from hesr.extras.view.report import RATE, open_renderer, write_video
from hesr.extras.view.stage import HEIGHT, WIDTH, Paint, Stage, ViewOptions, build_arm, choose
from hesr_model.errors import ArtifactError, LogError, RobotError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder
from hesr_model.support.typed_files import to_json

UF850 = models_folder() / "uf850"
INVERSION = "servo_inversion"
PAINT = Paint(links=(1.0, 1.0, 1.0, 1.0), joints=(0.5, 0.5, 0.5, 1.0), end=(0.0, 0.0, 0.0, 1.0))
LIBRARY = next((name for name in ("EGL", "OSMesa") if ctypes.util.find_library(name)), None)

draws = pytest.mark.skipif(
    LIBRARY is None and not os.environ.get("MUJOCO_GL"),
    reason="neither libEGL nor libOSMesa draws without a screen on this machine",
)
encodes = pytest.mark.skipif(
    importlib.util.find_spec("imageio_ffmpeg") is None, reason="imageio-ffmpeg is not installed"
)


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of a closed-loop run: the arm, the paper's law, one second of its motion."""
    folder = tmp_path_factory.mktemp("result")
    plant = Plant.read(UF850 / "plant.toml")
    robot = Robot(RobotDescription.read(UF850 / "robot.toml"))
    settings = Study.read(models_folder() / "studies" / "default.toml").tracking
    assert settings
    settings = settings.model_copy(
        update={"seeds": (11, 12), "duration": 1.0, "peak_velocity": (0.6, 0.5, 0.6)}
    )
    fmus = folder / "fmus"
    fmus.mkdir()
    export_mjcf(plant.model, fmus / "Arm.fmu", table=UF850 / "arm.toml")
    law = export_fmu(FrictionModel.read(model_file("uf850-table1")), fmus / "parfam_h.fmu")
    body = identify([_excitation(robot)], robot)
    body.write(folder / "rigid_body.json")
    truth = true_friction(plant.model, plant.joints, sample_time=0.005)
    build(fmus, robot, body, plant, true_model=truth)
    loop = assemble(fmus, robot, tracking=settings, friction={"parfam_h": law}, plant=plant)
    inversion = Scheme(compensation="servo_inversion")
    rows = [
        loop.row(StandIn.VELOCITY_ONLY, Scheme(compensation="none")),
        *(loop.row(name, inversion) for name in (StandIn.BODY_ONLY, "parfam_h", StandIn.ORACLE)),
    ]
    loop = replace(loop, limits=np.tile([-10.0, 10.0], (3, 1)), checkpoints=folder / "checkpoints")
    found, again = (
        loop.track(rows, motions(settings), 1.0, "tracking", traced=True, workers=1)
        for _ in range(2)
    )
    for one, other in zip(found, again, strict=True):  # checkpoints of an interrupted run
        assert_same(one, other)
    write_traces(folder / TRACES, [(t.scheme, t.law, t.trace) for t in found if t.trace])
    (folder / "rmse.json").write_text(json.dumps(list(map(to_json, found))), encoding="utf-8")
    return folder


def assert_same(one: Tracked, other: Tracked) -> None:
    assert one.trace
    assert other.trace
    for name in ("t", "q_d", "q"):
        np.testing.assert_array_equal(getattr(one.trace, name), getattr(other.trace, name))
    assert to_json(one) == to_json(other)


def _excitation(robot: Robot) -> Log:
    from cosim.loop.excite import record_motions
    from cosim.loop.motions import Motions

    found = Motions.read(models_folder() / "studies" / "uf850_motions.toml")
    wanted = tuple(m for m in found.motions if m.name == "excitation")
    plant = Plant.read(UF850 / "plant.toml")
    return next(iter(record_motions(found.model_copy(update={"motions": wanted}), plant))).log


# --- traces ------------------------------------------------------------------------------------


def test_traces_are_those_of_the_scored_runs(result: Path) -> None:
    traces = read_traces(result / TRACES)
    rows = json.loads((result / "rmse.json").read_text(encoding="utf-8"))
    assert [(s.name, law) for s, law in traces] == [(row["scheme"], row["law"]) for row in rows]
    for row in rows:
        trace = traces[Scheme.from_name(row["scheme"]), row["law"]]
        assert trace.t[0] == 0.0
        assert trace.t[-1] == pytest.approx(1.0)
        error = np.sqrt(np.mean((trace.q - trace.q_d) ** 2, axis=0))
        np.testing.assert_allclose(error, row["rmse"][0], rtol=1e-12)


def test_traces_have_the_same_bytes_again_and_may_be_parquet(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Older results have `closed_loop.parquet`, which needs pyarrow."""
    traces = read_traces(result / TRACES)
    write_traces(tmp_path / TRACES, [(*key, trace) for key, trace in traces.items()])
    assert (tmp_path / TRACES).read_bytes() == (result / TRACES).read_bytes()
    with np.load(tmp_path / TRACES) as file:
        columns = {name: file[name] for name in file.files}
    assert list(columns)[:5] == ["scheme", "law", "t", "q_d1", "q_d2"]
    (tmp_path / TRACES).rename(tmp_path / "unused.npz")
    older = {name: column.tolist() for name, column in columns.items()}
    pyarrow.parquet.write_table(pyarrow.table(older), tmp_path / "closed_loop.parquet")
    found = read_traces(tmp_path / TRACES)
    assert list(found) == list(traces)
    for key, trace in traces.items():
        for name in ("t", "q_d", "q"):
            np.testing.assert_array_equal(getattr(found[key], name), getattr(trace, name))
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogError, match=r"need pyarrow: pip install '.+\[formats\]'"):
        read_traces(tmp_path / TRACES)


def test_files_without_traces_are_refused(tmp_path: Path) -> None:
    path = tmp_path / TRACES
    with pytest.raises(ArtifactError) as missing:
        read_traces(path)
    assert f"{path}: no such file; 'hesr run'" in str(missing.value)
    path.write_text("text", encoding="utf-8")
    with pytest.raises(ArtifactError) as wrong:
        read_traces(path)
    assert "file of closed-loop traces" in str(wrong.value)


# --- choice of runs ----------------------------------------------------------------------------


def test_the_best_law_is_shown_next_to_no_compensation(result: Path) -> None:
    shown = choose(result, ViewOptions())
    assert shown.scheme == INVERSION
    assert list(shown.runs) == [StandIn.BODY_ONLY.words, "ParFam-H"]
    assert list(shown.joints) == ["joint1", "joint2", "joint3"]


def test_laws_and_scheme_can_be_chosen(result: Path) -> None:
    shown = choose(result, ViewOptions(laws=[StandIn.ORACLE, "parfam_h"]))
    assert list(shown.runs) == [StandIn.ORACLE.words, "ParFam-H"]
    assert list(choose(result, ViewOptions(scheme="none")).runs) == [StandIn.VELOCITY_ONLY.words]


def test_unknown_choices_are_refused(result: Path, hesr: Hesr, tmp_path: Path) -> None:
    cases = {
        ("--law", "lugre"): "'lugre'; with scheme 'servo_inversion' there",
        ("--scheme", "x"): f"--scheme is 'x'; there are 'none', 'servo_inversion' in {result}.",
        ("--magnify", "0"): "--magnify is 0; it must be positive.",
        ("--speed", "nan"): "--speed is nan; it must be positive.",
        ("--law", "parfam_h") * 5: "given 5 times; at most 4",
    }
    for options, sentence in cases.items():
        answer = hesr("report", result, "--view", *options)
        assert (answer.code, answer.out, answer.err) == (2, "", OneSentence("hesr: ", sentence))
    answer = hesr("report", result, "-o", "arm.avi")
    assert (answer.code, answer.err) == (2, "hesr: arm.avi: reports are .html, .md, .mp4, .webp.\n")
    answer = hesr("report", tmp_path / "none", "--view")
    assert (answer.code, answer.err) == (
        2,
        Containing(f"hesr: {tmp_path / 'none'}: no such folder"),
    )


def test_results_without_their_arm_are_refused(result: Path, tmp_path: Path) -> None:
    for name in (TRACES, "rigid_body.json"):
        shutil.copy(result / name, tmp_path)
    fmu = tmp_path / "fmus" / "Arm.fmu"
    with pytest.raises(ArtifactError) as missing:
        choose(tmp_path, ViewOptions())
    assert str(missing.value) == f"{fmu}: no such file; rerun 'hesr run'."
    fmu.parent.mkdir()
    with zipfile.ZipFile(fmu, "w") as archive:
        archive.writestr("modelDescription.xml", "")
    with pytest.raises(ArtifactError) as empty:
        choose(tmp_path, ViewOptions())
    assert str(empty.value) == (f"{fmu}: holds no resources/model.xml to show.")


# --- poses -------------------------------------------------------------------------------------


@pytest.mark.parametrize("magnify", [1.0, 20.0])
def test_ghost_and_arm_have_the_poses_of_the_run(result: Path, magnify: float) -> None:
    """Compared with MuJoCo's own kinematics of the shipped model."""
    choice = ViewOptions(laws=["parfam_h", StandIn.BODY_ONLY], magnify=magnify)
    shown = choose(result, choice)
    stage = Stage(shown, choice)
    model = mujoco.MjModel.from_xml_path(str(UF850 / "uf850.xml"))
    data = mujoco.MjData(model)
    ways = []
    for t in (0.0, 0.4, 1.0):
        stage.set(t)
        for k, run in enumerate(shown.runs.values()):
            row = round(t / 0.005)
            q_d, q = run.q_d[row], run.q[row]
            spot = stage.mj_data.body(f"actual{k}/link_base").xpos
            for prefix, pose in ((f"commanded{k}", q_d), (f"actual{k}", q_d + magnify * (q - q_d))):
                data.qpos[:] = pose
                mujoco.mj_kinematics(model, data)
                for body in ("link3", "link6", "payload"):
                    np.testing.assert_allclose(
                        stage.mj_data.body(f"{prefix}/{body}").xpos - spot,
                        data.body(body).xpos,
                        atol=1e-12,
                    )
            ways.append(stage.mj_data.body(f"actual{k}/payload").xpos.copy())
    assert np.ptp(ways, axis=0).max() > 0.1  # the arm moves, and ghost and arm differ


def test_only_an_arm_without_shapes_gets_new_ones() -> None:
    mjcf = (UF850 / "uf850.xml").read_text(encoding="utf-8")
    joints = ["joint1", "joint2", "joint3"]
    drawn = build_arm(mjcf, joints, paint=PAINT).compile()
    kinds = [mujoco.mjtGeom(kind) for kind in drawn.geom_type]
    assert kinds.count(mujoco.mjtGeom.mjGEOM_CYLINDER) == 3
    assert kinds.count(mujoco.mjtGeom.mjGEOM_CAPSULE) >= 4
    assert (drawn.nu, drawn.nsensor, drawn.ntendon) == (0, 0, 0)
    own = mjcf.replace('<body name="payload"', '<geom size="0.07"/><body name="payload"')
    kept = build_arm(own, joints, paint=PAINT).compile()
    assert kept.ngeom == 1
    assert kept.geom_size[0, 0] == 0.07


def test_missing_meshes_do_not_matter() -> None:
    mjcf = (UF850 / "uf850.xml").read_text(encoding="utf-8")
    mjcf = mjcf.replace("<worldbody>", '<asset><mesh name="m" file="no.stl"/></asset><worldbody>')
    mjcf = mjcf.replace('<body name="payload"', '<geom type="mesh" mesh="m"/><body name="payload"')
    with pytest.raises(ValueError, match=r"no\.stl"):
        mujoco.MjModel.from_xml_string(mjcf)
    assert build_arm(mjcf, ["joint1"], paint=PAINT).compile().ngeom > 5


def test_a_sliding_joint_is_drawn() -> None:
    mjcf = """<mujoco><worldbody><body name="a"><joint name="j" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><body name="b" pos="0 0 1"/></body>
    </worldbody></mujoco>"""
    drawn = build_arm(mjcf, ["j"], paint=PAINT).compile()
    assert mujoco.mjtGeom.mjGEOM_BOX in drawn.geom_type


def test_unsuitable_models_are_refused() -> None:
    with pytest.raises(RobotError, match="model has no joint 'j'"):
        build_arm("<mujoco><worldbody/></mujoco>", ["j"], paint=PAINT)
    with pytest.raises(RobotError, match=r"^the arm's model cannot be shown \(.+\)\.$"):
        build_arm("<mujoco><worldbody>", ["j"], paint=PAINT)


# --- pictures ---------------------------------------------------------------------------------


@pytest.mark.ci
@draws
def test_the_picture_shows_both_poses_and_changes(result: Path) -> None:
    choice = ViewOptions(laws=[StandIn.BODY_ONLY], magnify=10.0)
    stage = Stage(choose(result, choice), choice)
    model = stage.mj_model
    names = [model.body(body).name for body in model.geom_bodyid]
    with open_renderer(stage) as draw:
        first, last = (draw(t).astype(float) for t in (0.0, 0.6))
        assert first.shape == (HEIGHT, WIDTH, 3)
        assert first[:40].mean() > 150.0  # a bright sky above
        assert seen(last, first) > 0.01
        for which in ("commanded0", "actual0"):
            colours = model.geom_rgba.copy()
            model.geom_rgba[[name.startswith(which) for name in names], 3] = 0.0
            assert seen(last, draw(0.6).astype(float)) > 0.02  # it fails to reach the target
            model.geom_rgba[:] = colours
        np.testing.assert_array_equal(draw(0.6), last)


def seen(one: np.ndarray, other: np.ndarray) -> float:
    """Share of pixels with a visible difference."""
    return float(np.mean(np.abs(one - other).max(axis=2) > 12.0))


@pytest.mark.ci
@draws
@encodes
def test_a_video_is_as_long_as_the_motion(result: Path, tmp_path: Path, hesr: Hesr) -> None:
    import imageio_ffmpeg

    path = tmp_path / "new" / "arm.mp4"
    answer = hesr("report", result, "--law", "parfam_h", "--speed", "2", "-o", path)
    assert answer.code == 0, answer.err
    assert answer.out == f"Written: {path}\n"
    decoded = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True,
        check=True,
    )
    about = decoded.stderr.decode()
    assert f"{WIDTH}x{HEIGHT}" in about
    assert f" {RATE} fps" in about
    images = np.frombuffer(decoded.stdout, dtype=np.uint8).reshape(-1, HEIGHT, WIDTH, 3)
    assert len(images) == RATE // 2
    choice = ViewOptions(laws=["parfam_h"], speed=2.0)
    with open_renderer(Stage(choose(result, choice), choice)) as draw:
        for k in (0, 7, 14):
            assert np.abs(images[k].astype(float) - draw(2.0 * k / RATE)).mean() < 3.0
    assert np.abs(images[0].astype(float) - images[14]).mean() > 0.1
    assert [p.name for p in path.parent.iterdir()] == ["arm.mp4"]


@pytest.mark.ci
@draws
def test_an_animated_picture_for_a_page_needs_no_encoder(
    result: Path, tmp_path: Path, hesr: Hesr
) -> None:
    path = tmp_path / "arm.webp"
    answer = hesr("report", result, "--law", "parfam_h", "--speed", "2", "-o", path)
    assert answer.code == 0, answer.err
    with PIL.Image.open(path) as film:
        assert film.size == (WIDTH // 2, HEIGHT // 2)
        assert film.n_frames == round(0.5 * RATE / 2)
        first = np.asarray(film.convert("RGB"), dtype=float)
        film.seek(film.n_frames - 1)
        assert np.abs(np.asarray(film.convert("RGB"), dtype=float) - first).mean() > 0.1


@pytest.mark.ci
@draws
@encodes
def test_an_interrupt_leaves_no_partial_video(result: Path, tmp_path: Path) -> None:
    path = tmp_path / "arm.mp4"
    path.write_text("old", encoding="utf-8")

    def interrupt(done: int, _all: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    choice = ViewOptions(laws=[StandIn.ORACLE])
    with pytest.raises(KeyboardInterrupt):
        write_video(path, choose(result, choice), choice, progress=interrupt)
    assert path.read_text(encoding="utf-8") == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["arm.mp4"]


# --- unsuitable machines -----------------------------------------------------------------------


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere there is always a screen")
def test_a_missing_screen_is_reported(
    result: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    answer = hesr("report", result, "--view")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == OneSentence("hesr: no screen found")


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere OpenGL is part of the system")
@encodes
def test_missing_opengl_is_reported(
    result: Path, hesr: Hesr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(ctypes.util, "find_library", lambda _name: None)
    answer = hesr("report", result, "-o", tmp_path / "arm.mp4")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == OneSentence("hesr: videos need libEGL or libOSMesa")
    assert not list(tmp_path.iterdir())


@pytest.mark.ci
@pytest.mark.skipif(sys.platform != "linux", reason="a display is set for X")
@encodes
def test_failing_opengl_is_reported(result: Path, tmp_path: Path) -> None:
    """A driver without a device: here GLFW on a display that does not exist."""
    program = "from hesr.cli import main; main()"
    path = tmp_path / "arm.mp4"
    answer = subprocess.run(
        [sys.executable, "-c", program, "report", str(result), "-o", str(path)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"MUJOCO_GL": "glfw", "DISPLAY": ":4711"},
    )
    assert (answer.returncode, answer.stdout) == (2, "")
    said = answer.stderr.splitlines()[-1]
    assert said.startswith("hesr: OpenGL is not available (")
    assert said.endswith("); try MUJOCO_GL=osmesa or MUJOCO_GL=egl.")
    assert "Traceback" not in answer.stderr
    assert not list(tmp_path.iterdir())


def test_a_missing_encoder_is_reported(
    result: Path, hesr: Hesr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    answer = hesr("report", result, "-o", tmp_path / "arm.mp4")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == OneSentence("hesr: videos need the package imageio-ffmpeg")


def test_a_package_without_its_encoder_is_reported(
    result: Path, hesr: Hesr, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on platforms without an encoder in the package."""
    package = pytest.importorskip("imageio_ffmpeg")

    def nothing() -> str:
        raise RuntimeError("No ffmpeg exe could be found. Install ffmpeg on your system.")

    monkeypatch.setattr(package, "get_ffmpeg_exe", nothing)
    answer = hesr("report", result, "-o", tmp_path / "arm.mp4")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("hesr: ffmpeg is missing (No ffmpeg exe could be found.")


def test_a_crashed_encoder_is_reported(
    result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    if LIBRARY is None:
        pytest.skip("nothing draws on this machine")
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", shutil.which("false") or "false")
    choice = ViewOptions(laws=[StandIn.ORACLE])
    path = tmp_path / "arm.mp4"
    with pytest.raises(ArtifactError) as told:
        write_video(path, choose(result, choice), choice)
    assert str(told.value) == f"{path}: the video cannot be encoded (exit code 1)."
    assert not list(tmp_path.iterdir())


# --- the window -------------------------------------------------------------------------------


def test_a_viewer_that_needs_another_interpreter_is_reported(
    result: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on macOS; without a screen the viewer itself cannot be loaded."""

    def refused(*_: object, **__: object) -> None:
        raise RuntimeError("`launch_passive` requires that the script be run under `mjpython`.")

    viewer = types.SimpleNamespace(launch_passive=refused)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    answer = hesr("report", result, "--view")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == (
        "hesr: the viewer cannot open (`launch_passive` requires that the script be run under "
        "`mjpython`); write a video (-o FILE.mp4).\n"
    )


VIEW = """
import sys
from mujoco import viewer
from hesr.cli import main

launch_passive = viewer.launch_passive

def launch_and_tell(*arguments, **options):
    window = launch_passive(*arguments, **options)
    print("the window is open", file=sys.stderr, flush=True)
    return window

viewer.launch_passive = launch_and_tell
main()
"""


@pytest.mark.ci
@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="there is no Xvfb to open a window on")
def test_the_viewer_opens_moves_and_closes(result: Path, tmp_path: Path) -> None:
    """On a virtual screen; Ctrl-C ends it."""
    screen = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "320x240x24"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert screen.stdout
        number = screen.stdout.readline().strip()  # written when it accepts clients
        variables = os.environ | {"DISPLAY": f":{number}"}
        variables.pop("MUJOCO_GL", None)
        program = (
            "import sys\nfrom pathlib import Path\n"
            "from hesr.extras.view.stage import ViewOptions, choose\n"
            "from hesr.extras.view.report import show\n"
            "choice = ViewOptions(speed=1.0)\n"
            "show(choose(Path(sys.argv[1]), choice), choice, turns=1)"
        )
        done = subprocess.run(
            [sys.executable, "-c", program, str(result)],
            capture_output=True,
            text=True,
            env=variables,
            check=False,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        viewing = subprocess.Popen(
            [sys.executable, "-c", VIEW, "report", str(result), "--view"],
            stderr=subprocess.PIPE,
            text=True,
            env=variables,
        )
        wait_for_line(viewing, lambda line: line == "the window is open")
        viewing.send_signal(signal.SIGINT)  # it runs until it is closed
        _, err = viewing.communicate(timeout=HANG)
        assert viewing.returncode == 130
        assert "Traceback" not in err
    finally:
        screen.terminate()
        screen.communicate()
