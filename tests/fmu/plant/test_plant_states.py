"""Steps of 10 ms from random states, for each law: every one has a solution."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from c_hosts import LINUX
from plant_robots import ur_like
from plant_runs import content_of, stribeck
from registry_models import everyday, sampled

from fmu_src.export.package import translation_unit
from hesr_model.friction.law import FrictionLaw
from hesr_model.robots.robot import Robot
from hesr_model.support.compiler import compile_c

HOST = Path(__file__).with_name("plant_states.c")
STEP = 0.01  # s
MOMENTS = [f"link[6].{n}=0" for n in ("mx", "my", "mz", "Ixy", "Ixz", "Iyz")]
LIGHT = ["link[6].m=0.05", *MOMENTS, *(f"link[6].{n}=2e-4" for n in ("Ixx", "Iyy", "Izz"))]
HUNDREDFOLD = [f"viscous_scale[{i}]=100" for i in range(1, 7)]
FINE = "substep=0.0005"
FASTER = 1.2  # highest speed of a light wrist over that of short steps
WITHOUT_BOUND = ("parfam_h",)
"""Laws whose friction falls exponentially at the high speeds of a light wrist: it runs away."""

WIDTHS = """
#include "plant.c"
#include <stdio.h>
#include <stdlib.h>

static double k[MAX_PARAMETERS][LANES], u[MAX_INPUTS][LANES], x[MAX_STATES][LANES];
static double c[PREPARED][LANES], found[2][4][MAX_STATES + MAX_OUTPUTS][LANES];

static void fill(double *to, size_t bytes, double low, double high) {
    for (size_t i = 0; i < bytes / sizeof *to; i++) {
        to[i] = low + (high - low) * rand() / RAND_MAX;
    }
}

int main(void) {
    int differ = 0;
    if (!has_wide_vectors()) {
        return 77;
    }
    for (int n = 0; n < 10000; n++) {
        fill(k[0], sizeof k, 0.1, 1e4);
        fill(u[0], sizeof u, -5.0, 5.0);
        fill(x[0], sizeof x, -1e-3, 1e-3);
        for (int l = 0; l < LANES; l++) {
            double own[MAX_PARAMETERS], prepared[PREPARED];
            for (int i = 0; i < MAX_PARAMETERS; i++) {
                own[i] = k[i][l];
            }
            law_1_prepare(own, u[0], prepared);
            for (int i = 0; i < PREPARED; i++) {
                c[i][l] = prepared[i];
            }
        }
        law_1_attempts_wide(c, u, x, 1e-3, 0.0, found[0][0], found[0][1], found[0][2],
                            found[0][3]);
        law_1_attempts_inlined(c, u, x, 1e-3, 0.0, found[1][0], found[1][1], found[1][2],
                               found[1][3]);
        differ += memcmp(found[0], found[1], sizeof found[0]) != 0;
    }
    return differ > 0;
}
"""

HELD = """
#include "plant.c"
#include <stdio.h>
#include <stdlib.h>

static double uniform(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }

int main(void) {
    static Solver solver;
    double lower[JOINTS][JOINTS], more[JOINTS], right[JOINTS], change[JOINTS], largest = 0.0;
    for (int n = 0; n < 1000; n++) {
        solver.holding = n % 2;
        for (int i = 0; i < JOINTS; i++) {
            solver.held[i] = solver.holding && rand() % 2;
            more[i] = uniform(0.0, 2.0);
            right[i] = change[i] = uniform(-1.0, 1.0);
            for (int j = 0; j < JOINTS; j++) {
                lower[i][j] = j < i ? uniform(-1.0, 1.0) : j == i;
            }
        }
        for (int i = 0; i < JOINTS; i++) {
            for (int j = 0; j < JOINTS; j++) {
                solver.mass[i][j] = 0.0;
                for (int k = 0; k < JOINTS; k++) {
                    solver.mass[i][j] += lower[i][k] * lower[j][k];
                }
            }
        }
        if (!solve_linear(&solver, more, change)) {
            return 1;
        }
        for (int i = 0; i < JOINTS; i++) {
            double left = more[i] * change[i] - right[i];
            for (int j = 0; j < JOINTS; j++) {
                left += solver.mass[i][j] * change[j];
            }
            largest = fmax(largest, fabs(solver.held[i] ? change[i] : left));
        }
    }
    printf("%g", largest);
    return 0;
}
"""

Host = Callable[..., tuple[int, float, str]]


@pytest.fixture
def host(tmp_path: Path) -> Callable[[FrictionLaw], Host]:
    """Compile the sources of six joints under a law with the host in C."""

    def make(law: FrictionLaw) -> Host:
        robot = Robot(ur_like(tmp_path))
        sources = translation_unit(content_of(robot, [law] * robot.n))[1]
        for name, text in {**sources, HOST.name: HOST.read_text(encoding="utf-8")}.items():
            (tmp_path / name).write_text(text, encoding="utf-8")
        program = tmp_path / "host"
        flags = (*LINUX, "-std=gnu99", "-w", "-ffp-contract=off")
        compile_c(tmp_path / HOST.name, flags, program, ("-lm",))

        def run(starts: int, steps: int, *parameters: str) -> tuple[int, float, str]:
            command = [program, starts, steps, STEP, 1, *parameters]
            found = subprocess.run(
                list(map(str, command)), check=True, capture_output=True, text=True
            ).stdout.split(maxsplit=2)
            return int(found[0]), float(found[1]), " ".join(found[2:])

        return run

    return make


@pytest.mark.parametrize("name", sampled(everyday()))
def test_every_random_state_has_a_solution(name: str, fitted, host) -> None:
    assert host(fitted[name])(1000, 10)[::2] == (0, "")


@pytest.mark.ci
@pytest.mark.parametrize("name", sampled(n for n in everyday() if n not in WITHOUT_BOUND))
def test_a_light_wrist_is_no_faster_than_with_short_steps(name: str, fitted, host) -> None:
    """Nor is it with a hundredfold viscous friction."""
    run = host(fitted[name])
    bound = FASTER * run(300, 10, *LIGHT, FINE)[1]
    for more in ([], HUNDREDFOLD):
        failed, fastest, why = run(300, 10, *LIGHT, *more)
        assert (failed, why) == (0, "")
        assert fastest < bound


@pytest.mark.soak
@pytest.mark.parametrize("name", list(everyday()))
def test_a_million_random_states_have_a_solution(name: str, fitted, host) -> None:
    assert host(fitted[name])(100_000, 10)[::2] == (0, "")


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[[FrictionLaw, str], Path]:
    """Compile a program with the sources of six joints under a law."""

    def make(law: FrictionLaw, program: str) -> Path:
        robot = Robot(ur_like(tmp_path))
        sources = translation_unit(content_of(robot, [law] * robot.n))[1]
        for file, text in {**sources, "program.c": program}.items():
            (tmp_path / file).write_text(text, encoding="utf-8")
        flags = (*LINUX, "-std=gnu99", "-w", "-ffp-contract=off")
        compile_c(tmp_path / "program.c", flags, tmp_path / "program", ("-lm",))
        return tmp_path / "program"

    return make


@pytest.mark.parametrize("name", ["lugre", "parfam_s"])
def test_wide_vectors_give_the_same_bits(name: str, fitted, compiled) -> None:
    code = subprocess.run([compiled(fitted[name], WIDTHS)], check=False).returncode
    if code == 77:
        pytest.skip("this processor has no vectors of four doubles")
    assert code == 0


def test_held_axes_keep_their_speed_in_a_newton_step(compiled) -> None:
    """The others balance as if these were fixed; a wrong step is repaired by slower ones."""
    printed = subprocess.run(
        [compiled(stribeck(), HELD)], check=True, capture_output=True, text=True
    ).stdout
    assert float(printed) < 1e-12
