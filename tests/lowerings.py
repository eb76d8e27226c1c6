"""Every form into which a friction law is lowered, as one table: `LOWERINGS`.

Each lowering gives the torque of a law on the reference motion of this module. To add one, write
a function and its entry; contract/test_lowerings.py then runs it with every law.
"""

import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from binary import Binary
from browser_pages import start_chromium
from compiled_header import CompiledHeader
from modelica_truth import MODELICA, TIMES, fmu_torque, open_compilers, python_torque, simulate
from registry_models import STUDIED, live_of, models_of_registry

from fmu_src import model_file
from fmu_src.friction.friction_fmu import export_bare
from fmu_src.run.fmu import FmuInstance
from hesr.extras.modelica.modelica_package import export_modelica
from hesr.extras.mujoco_plugin.plugin_library import export_mujoco_plugin
from hesr.extras.one_file.tensors import export_jax, export_torch
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.support.arrays import Array

STEP = 0.005
"""Step of the even rows [s]; rows after `EVEN_ROWS` have others."""
EVEN_ROWS, ROWS = 500, 600
INPUTS = ("dq", "q", "tau_load")
PUBLISHED = "table1"
"""The law of the paper on three joints, whose integration is Euler's."""

_MASS, _ARM, _GRAVITY = 10.0, 0.1, 9.81
_DEBIAN_PYTHON = Path("/usr/bin/python3")
_HERE = Path(__file__).parent

# --- the motion and the law ---------------------------------------------------------------------


@dataclass(frozen=True)
class Motion:
    """Inputs of each step: its size (N,) [s], dq, q and tau_load (N, n) [rad/s, rad, N.m]."""

    dt: Array
    dq: Array
    q: Array
    tau_load: Array

    @classmethod
    def reference(cls, joints: int, rows: int = ROWS) -> "Motion":
        """Return smooth motion with rests, then speeds of all sizes that jump.

        The load is that of a pendulum, so that MuJoCo can make it.
        """
        rng = np.random.default_rng(7)
        t = STEP * np.arange(rows)[:, None]
        phase = 0.3 + 0.4 * np.arange(joints)
        q = 0.4 * np.sin(2.0 * t + phase) + 0.1 * np.sin(9.0 * t)
        dq = 0.8 * np.cos(2.0 * t + phase) + 0.9 * np.cos(9.0 * t)
        dq[60:90] = 0.0
        dq[120:130] = 1e-9  # series branch of phi
        jumping = dq[300:]
        jumping[:] = rng.normal(size=jumping.shape)
        jumping *= 10.0 ** rng.uniform(-5.0, 0.0, (len(jumping), 1))
        jumping[rng.random(len(jumping)) < 0.05] = 0.0
        dt = np.full(rows, STEP)
        dt[EVEN_ROWS:] = STEP * rng.uniform(0.2, 1.5, max(rows - EVEN_ROWS, 0))
        load = -_MASS * _GRAVITY * _ARM * (np.cos(q) + np.sin(q))
        return cls(dt=dt, dq=dq, q=q, tau_load=load)

    def with_even_steps(self) -> "Motion":
        """Return the motion with the step `STEP` in all rows."""
        return replace(self, dt=np.full_like(self.dt, STEP))

    def first_rows(self, rows: int) -> "Motion":
        """Return the beginning of the motion."""
        return Motion(**{name: column[:rows] for name, column in vars(self).items()})

    @property
    def times(self) -> Array:
        """Times (N,) at the beginning of the steps [s]."""
        return np.cumsum(self.dt) - self.dt

    @property
    def rows(self) -> Array:
        """Inputs of each step (N, 3 n), in the order of `INPUTS`."""
        return np.column_stack([self.dq, self.q, self.tau_load])


BEGINS = (0, 70, 125, 450)
"""Rows with which an instance begins: in motion, at rest, hardly moving and at any speed."""


@dataclass(frozen=True)
class Torques:
    """Torques of a lowering [N.m] on a motion, which all instances but `first` begin at rest.

    Attributes
    ----------
    stepped
        After each step (N, n).
    first
        Of instances that begin with the inputs of the rows `BEGINS` (K, n), or None.
    single
        As `stepped`, in single precision, or None.
    """

    stepped: Array
    first: Array | None = None
    single: Array | None = None

    def write(self, path: Path) -> None:
        np.savez(path, **{name: v for name, v in vars(self).items() if v is not None})

    @classmethod
    def read(cls, path: Path) -> "Torques":
        with np.load(path) as file:
            return cls(**file)


@dataclass(frozen=True)
class Case:
    """A law as a model of the registry, or the published one, with its FMU of FMI 2.0."""

    name: str
    model: FrictionModel
    fmu: Path

    @classmethod
    def write(cls, name: str, folder: Path) -> None:
        """Fit a law and export it into a folder."""
        if name == PUBLISHED:
            model = FrictionModel.read(model_file("uf850-table1"))
        else:
            [model] = models_of_registry([name])
        model = replace(model, provenance={})
        model.write(folder / "law.json")
        export_bare(model, folder / "F.fmu")

    @classmethod
    def read(cls, name: str, folder: Path) -> "Case":
        return cls(name, FrictionModel.read(folder / "law.json"), folder / "F.fmu")

    @property
    def joints(self) -> range:
        """Numbers of the joints."""
        return range(1, len(self.model.joints) + 1)


# --- FMUs, C and Python -------------------------------------------------------------------------


def run_fmu(fmu: Path, motion: Motion) -> Torques:
    """Run an FMU in co-simulation, initialised at rest and then with the inputs of `BEGINS`."""
    joints = range(1, motion.dq.shape[1] + 1)
    names = [f"{name}[{i}]" for name in INPUTS for i in joints]
    stepped, first = [], []
    with FmuInstance(fmu) as instance:
        inputs = instance.buffer(names)
        outputs = instance.buffer([f"tau[{i}]" for i in joints])
        instance.initialise()
        for time, dt, row in zip(motion.times, motion.dt, motion.rows, strict=True):
            inputs.values[:] = row
            inputs.write()
            instance.step(float(time), float(dt))
            stepped.append(outputs.read().copy())
        for k in BEGINS:
            instance.reset()
            inputs.values[:] = motion.rows[k]
            instance.initialise(inputs=inputs)
            first.append(outputs.read().copy())
    return Torques(np.array(stepped), np.array(first))


def _run_fmi2(case: Case, motion: Motion, _folder: Path) -> Torques:
    return run_fmu(case.fmu, motion)


def _run_fmi3(case: Case, motion: Motion, folder: Path) -> Torques:
    return run_fmu(export_bare(case.model, folder / "F3.fmu", fmi=3), motion)


def _run_sources(case: Case, motion: Motion, folder: Path) -> Torques:
    """Replace the binary of the FMU by its sources, compiled by GCC."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    with ZipFile(case.fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
        archive.extractall(folder / "unpacked")
    [binary] = (name for name in members if name.startswith("binaries/linux64/"))
    flags = ("-std=gnu99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")
    sources = folder / "unpacked" / "sources"
    command = ["gcc", *flags, "all.c", "-o", "compiled.so", "-lm"]
    subprocess.run(command, cwd=sources, check=True)
    members[binary] = (sources / "compiled.so").read_bytes()
    with ZipFile(folder / "F.fmu", "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return run_fmu(folder / "F.fmu", motion)


def _run_header(case: Case, motion: Motion, folder: Path) -> Torques:
    header = CompiledHeader(case.model, folder)
    rows = list(zip(motion.dq, motion.q, motion.tau_load, strict=True))
    state = header.state()
    stepped = [header.step(state, *row, dt) for row, dt in zip(rows, motion.dt, strict=True)]
    first = []
    for k in BEGINS:
        fresh = header.state()
        header.begin(fresh, *rows[k])
        first.append(header.step(fresh, *rows[k], 0.0))
    return Torques(np.array(stepped, float), np.array(first, float))


def _run_python(case: Case, motion: Motion, _folder: Path) -> Torques:
    stepped, first = [], []
    t = np.concatenate([[0.0], np.cumsum(motion.dt)])
    for j, law in enumerate(case.model.laws):
        columns = {name: getattr(motion, name)[:, j] for name in INPUTS}
        from_rest = {name: np.concatenate([[0.0], column]) for name, column in columns.items()}
        stepped.append(predict(law, t=t, **from_rest)[1:])
        begun = [
            predict(law, t=t[:1], **{name: column[k : k + 1] for name, column in columns.items()})
            for k in BEGINS
        ]
        first.append(np.concatenate(begun))
    return Torques(np.column_stack(stepped), np.column_stack(first))


# --- WebAssembly in Chromium ----------------------------------------------------------------------

# A separate importer that shares only the module with the page.
_IMPORTER = """async ([packed, rows, steps, begins, joints]) => {
  const bytes = Uint8Array.from(atob(packed), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const module = await WebAssembly.compile(await new Response(stream).arrayBuffer());
  if (WebAssembly.Module.imports(module).length) throw new Error("it imports something");
  const fmu = (await WebAssembly.instantiate(module)).exports;
  const check = (status) => { if (status) throw new Error(`status ${status}`); };
  const put = (row) => row.forEach((u, i) => check(fmu.live_set(i, u)));
  const read = () => Array.from({ length: joints }, (_, i) => fmu.live_get(3 * joints + i));
  check(fmu.live_reset());
  check(fmu.live_initialise());
  const stepped = [];
  let time = 0;
  rows.forEach((row, k) => {
    put(row);
    check(fmu.live_step(time, steps[k]));
    time += steps[k];
    stepped.push(read());
  });
  const first = begins.map((k) => {
    check(fmu.live_reset());
    put(rows[k]);
    check(fmu.live_initialise());
    return read();
  });
  return { stepped, first };
}"""


def _run_pages(cases: Sequence[Case], motions: Sequence[Motion], _folder: Path) -> list[Torques]:
    torques = []
    with start_chromium() as browser:
        page = browser.new_page()
        for case, motion in zip(cases, motions, strict=True):
            packed = live_of(case.model)["module"]
            rows, steps = motion.rows.tolist(), motion.dt.tolist()
            answer = page.evaluate(_IMPORTER, [packed, rows, steps, BEGINS, len(case.joints)])
            torques.append(Torques(np.array(answer["stepped"]), np.array(answer["first"])))
    return torques


# --- MuJoCo ---------------------------------------------------------------------------------------

_BODY = """<body><joint name="{name}" axis="0 1 0" armature="0.5"/>
<inertial pos="{arm} 0 {arm}" mass="{mass}" diaginertia="1 1 1"/></body>"""


def _run_plugin(case: Case, motion: Motion, folder: Path) -> Torques:
    import mujoco

    # Names of plug-ins are unique in a process.
    plugin = export_mujoco_plugin(case.model, folder / f"{case.name}_{len(motion.dt)}.so")
    mujoco.mj_loadPluginLibrary(str(plugin))
    joints = case.model.joints
    bodies = "".join(_BODY.format(name=name, arm=_ARM, mass=_MASS) for name in joints)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" gravity="0 0 {-_GRAVITY}"/>'
        f'<include file="{plugin.with_suffix(".xml")}"/><worldbody>{bodies}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    stepped, loads = np.empty_like(motion.dq), np.empty_like(motion.dq)
    for k, (q, dq) in enumerate(zip(motion.q, motion.dq, strict=True)):
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_step(model, data)
        stepped[k], loads[k] = -data.qfrc_passive, data.qfrc_bias
    np.testing.assert_allclose(loads, motion.tau_load, rtol=0.0, atol=1e-13)
    return Torques(stepped)


# --- tensors --------------------------------------------------------------------------------------


def _has_torch() -> bool:
    command = [_DEBIAN_PYTHON, "-c", "import torch"]
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def _run_torch(cases: Sequence[Case], motions: Sequence[Motion], folder: Path) -> list[Torques]:
    if not _has_torch():
        pytest.skip("Debian's python3-torch is not installed")
    return _run_tensors("torch", _DEBIAN_PYTHON, export_torch, cases, motions, folder)


def _run_jax(cases: Sequence[Case], motions: Sequence[Motion], folder: Path) -> list[Torques]:
    if find_spec("jax") is None:
        pytest.skip("JAX is not installed: run `make jax` first")
    return _run_tensors("jax", Path(sys.executable), export_jax, cases, motions, folder)


def _run_tensors(
    library: str,
    python: Path,
    export: Callable[[FrictionModel, Path], Path],
    cases: Sequence[Case],
    motions: Sequence[Motion],
    folder: Path,
) -> list[Torques]:
    """Run the files of all laws in one process, because the libraries take seconds to import."""
    folders = [folder / case.name for case in cases]
    for case, motion, place in zip(cases, motions, folders, strict=True):
        place.mkdir(parents=True)
        export(case.model, place / "law.py")
        inputs = {name: getattr(motion, name) for name in INPUTS}
        np.savez(place / "rows.npz", **inputs, step=STEP, begins=BEGINS)
    answer = subprocess.run(
        [python, _HERE / "tensor_host.py", library, *folders],
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    return [Torques.read(place / "torques.npz") for place in folders]


# --- continuous time ------------------------------------------------------------------------------


def _run_continuous_python(case: Case, _motion: Motion, _folder: Path) -> Torques:
    return Torques(np.column_stack([python_torque(law) for law in case.model.laws]))


def _run_model_exchange(case: Case, _motion: Motion, folder: Path) -> Torques:
    fmu = Binary(case.fmu, folder)
    laws = zip(case.joints, case.model.laws, strict=True)
    return Torques(np.column_stack([fmu_torque(fmu, joint, law) for joint, law in laws]))


def _run_modelica(case: Case, _motion: Motion, folder: Path) -> Torques:
    package = export_modelica(case.model, folder / "Law.mo").read_text(encoding="utf-8")
    columns = []
    with ExitStack() as stack:
        rumoca = stack.enter_context(open_compilers(folder))("rumoca")
        for joint in case.joints:
            text = package + MODELICA.format(block=f"Law.Joint{joint}")
            model = rumoca.Session().loads(text, model="Reference")
            columns.append(simulate(rumoca, model, TIMES)["law.tau"])
    return Torques(np.column_stack(columns))


# --- the table ------------------------------------------------------------------------------------

RunOne = Callable[[Case, Motion, Path], Torques]
RunAll = Callable[[Sequence[Case], Sequence[Motion], Path], list[Torques]]


@dataclass(frozen=True, kw_only=True)
class Lowering:
    """A form of a law, and what is promised of it.

    Attributes
    ----------
    tolerance
        Largest difference to `reference`, relative to the largest torque of the joint.
    classic_tolerance
        In its place for laws outside the default study, or None.
    reference
        Name of the lowering with which this one is compared; none for one that others refer to.
    run
        Gives the torques of a law, with a folder for its files.
    run_all
        In its place for programs that are slow to start: gives the torques of several laws.
    single_tolerance
        As `tolerance`, for single precision.
    is_cheap
        Whether the gate runs all laws, and not only samples of each form.
    has_even_steps
        Whether all steps have one size.
    long_rows
        Number of rows of the long motion.
    too_slow
        Whether a law takes minutes and is left to the soak tests.
    """

    tolerance: float = 0.0
    classic_tolerance: float | None = None
    reference: str | None = "fmi2"
    run: RunOne | None = None
    run_all: RunAll | None = None
    single_tolerance: float | None = None
    is_cheap: bool = False
    has_even_steps: bool = False
    long_rows: int = 20_000
    too_slow: Callable[[FrictionModel], bool] = lambda _: False

    def tolerance_of(self, law_name: str) -> float:
        """Return the tolerance for a law of the registry or the published one."""
        if self.classic_tolerance is None or law_name in (*STUDIED, PUBLISHED):
            return self.tolerance
        return self.classic_tolerance

    def compute(
        self, cases: Sequence[Case], motions: Sequence[Motion], folder: Path
    ) -> list[Torques]:
        """Return the torques of laws on their motions; the folder gets files."""
        if self.run_all is not None:
            return self.run_all(cases, motions, folder)
        assert self.run is not None
        torques = []
        for case, motion in zip(cases, motions, strict=True):
            place = folder / f"{case.name}_files"
            place.mkdir(parents=True)
            torques.append(self.run(case, motion, place))
        return torques

    def choose_motion(self, case: Case) -> Motion:
        """Return the reference motion, as far as the lowering can follow it."""
        motion = Motion.reference(len(case.joints))
        return motion.first_rows(EVEN_ROWS) if self.has_even_steps else motion

    def long_motion(self, case: Case) -> Motion:
        """Return a motion of many rows, of which each lowering can follow all."""
        return Motion.reference(len(case.joints), self.long_rows).with_even_steps()


def _has_stops(model: FrictionModel) -> bool:
    """Stops are stiff: nine digits take solvers minutes for half a second."""
    return any(law.form.stops for law in model.laws)


LOWERINGS: Mapping[str, Lowering] = {
    "fmi2": Lowering(run=_run_fmi2, reference="python", tolerance=1e-12, is_cheap=True),
    "python": Lowering(run=_run_python, reference=None),
    "fmi3": Lowering(run=_run_fmi3),
    "sources": Lowering(run=_run_sources),
    "c_header": Lowering(run=_run_header, is_cheap=True),
    "page": Lowering(run_all=_run_pages, tolerance=1e-12),
    "mujoco": Lowering(run=_run_plugin, tolerance=1e-12, has_even_steps=True, long_rows=1_000_000),
    "torch": Lowering(
        run_all=_run_torch,
        tolerance=1e-12,
        single_tolerance=1e-4,
        has_even_steps=True,
        long_rows=2_000,
    ),
    "jax": Lowering(
        run_all=_run_jax,
        tolerance=1e-12,
        single_tolerance=1e-4,
        has_even_steps=True,
        long_rows=2_000,
    ),
    "continuous": Lowering(run=_run_continuous_python, reference=None),
    "model_exchange": Lowering(
        run=_run_model_exchange, reference="continuous", tolerance=1e-9, too_slow=_has_stops
    ),
    # Some classic laws have rates of 2,500 1/s, which cost the compiler's solver two digits.
    "modelica": Lowering(
        run=_run_modelica,
        reference="continuous",
        tolerance=1e-9,
        classic_tolerance=1e-6,
        too_slow=_has_stops,
    ),
}
