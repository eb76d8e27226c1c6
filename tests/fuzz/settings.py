"""User files: TOML of robots, plants, studies, systems and fleets."""

from pathlib import Path

from reader import UF850, Reader, copy_of, text, toml

from hesr_model.support.files import models_folder

STUDIES = models_folder() / "studies"

SYSTEM = """
name = "loop"
step = 0.005
stop = 20.0
observe = ["arm.q", "controller.tau[1]"]
[[components]]
name = "arm"
fmu = "arm.fmu"
start = { q0 = [0.0, 0.3, -1.9], noise = 1e-5, seed = 3 }
[[components]]
name = "controller"
fmu = "controller.fmu"
step = 0.01
[connections]
"arm.u" = "controller.tau"
[limits]
"arm.q" = [-3.0, 3.0]
"""

SWEEP = """
name = "payload"
system = "loop.toml"
design = "sobol"
runs = 64
seed = 1
[[inputs]]
variables = ["arm.payload"]
low = 0.0
high = 5.0
[[inputs]]
variables = ["controller.Kp", "controller.Kd"]
factor = true
mean = 1.0
std = 0.1
[[correlated]]
variables = ["friction.F_c[1]", "friction.F_s[1]"]
mean = [12.1, 14.0]
covariance = [[0.04, 0.01], [0.01, 0.09]]
[[outputs]]
name = "tracking"
signal = "arm.q_true"
reference = "trajectory.q"
measure = "rms"
"""

ROBOT = """
[log]
sample_rate = 200.0
filter_cutoff = 15.0
missing = "drop"
[log.columns]
t = "time"
q = "q{name}"
temperature = ["T1", "T2", "T3"]
[log.units]
q = "deg"
tau = ["N.m", "-N.m", 0.01]
temperature = "K"
[owner]
author = "A Company"
license = "Apache-2.0"
[transmission]
matrix = [[101, 0, 0], [0, 101, -50.5], [0, 0, 101]]
logs = "motor"
friction = ["motor", "motor", "joint"]
"""
"""Settings missing in the twin's own file."""

FLEET = """
name = "line"
seed = 3
laws = ["lugre", "stribeck"]
rows = 5000
level = 0.05
least_change = 0.1
platforms = ["linux64", "win64"]
[options.lugre]
starts = 4
[types.welder]
robot = "welder.toml"
logs = "logs/robot=W*/day=*"
accept = ["limits"]
[types.picker]
robot = "picker.toml"
logs = "logs/P[0-9]"
"""

EXCITATION = """
harmonics = 5
period = [10.0, 20.0]
periods = 2
starts = 4
seed = 1
sample_rate = 100.0
[limits]
position = [[-1.0, 1.0], [-0.5, 0.5], [-2.0, -1.0]]
velocity = [1.0, 1.0, 1.2]
torque = [300.0, 300.0, 100.0]
"""


def _write_robot(path: Path) -> None:
    own, _, _ = (UF850 / "robot.toml").read_text(encoding="utf-8").partition("[log]")
    path.write_text(own.replace("gear_ratio", "# gear_ratio") + ROBOT, encoding="utf-8")


def _fleet(path: Path) -> object:
    """Read a fleet and find its robots in its folder."""
    from hesr.extras.fleet.study import FleetStudy, find_members

    return find_members(FleetStudy.read(path), path)


def _write_fleet(path: Path) -> None:
    path.write_text(FLEET, encoding="utf-8")
    for part in ("robot=W1/day=2026-01-02", "robot=W2/day=2026-02-30", "P1"):
        folder = path.parent / "logs" / part
        folder.mkdir(parents=True)
        (folder / "part.csv").touch()


def _excitation(path: Path) -> object:
    from hesr_model.motions.excitation import ExcitationSettings

    return ExcitationSettings.read(path)


SETTINGS = {
    "robot": Reader(
        suffix=".toml",
        write=_write_robot,
        read=toml("hesr_model.robots.robot", "RobotDescription"),
    ),
    "plant": Reader(
        suffix=".toml",
        write=copy_of(UF850 / "plant.toml"),
        read=toml("fmu_src.arm.plant", "Plant"),
    ),
    "study": Reader(
        suffix=".toml",
        write=copy_of(STUDIES / "default.toml"),
        read=toml("cosim.study.study", "Study"),
    ),
    "motions": Reader(
        suffix=".toml",
        write=copy_of(STUDIES / "uf850_motions.toml"),
        read=toml("cosim.loop.motions", "Motions"),
    ),
    "excitation": Reader(suffix=".toml", write=text(EXCITATION), read=_excitation),
    "system": Reader(
        suffix=".toml", write=text(SYSTEM), read=toml("cosim.systems.system", "SystemSpec")
    ),
    "sweep": Reader(
        suffix=".toml", write=text(SWEEP), read=toml("hesr.extras.sweep.study", "SweepStudy")
    ),
    "fleet": Reader(suffix=".toml", write=_write_fleet, read=_fleet),
    "signals": Reader(
        suffix=".toml",
        write=copy_of(UF850 / "arm.toml"),
        read=toml("fmu_src.arm.table", "SignalTable"),
    ),
}
