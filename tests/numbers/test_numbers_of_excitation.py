"""Motions to the last digit, inputs of the search, and refused settings."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError
from unchanged import Unchanged

from hesr_model.errors import ConfigError, RobotError
from hesr_model.motions import excitation
from hesr_model.motions.excitation import (
    ExcitationSettings,
    FourierSearch,
    _find_null_space,
    condition,
    design,
    random_motions,
)
from hesr_model.motions.limits import Limits, MotionLimits
from hesr_model.motions.trajectories import (
    Fourier,
    Reversed,
    Sine,
    Sweep,
    chirp,
    random_fourier,
    sample_one_period,
)
from hesr_model.robots.robot import Robot, RobotDescription

START, AMPLITUDE = np.array([0.1, -0.2]), np.array([0.5, 0.4])
SWEEP = Sweep(
    start=START,
    amplitude=AMPLITUDE,
    swing=np.array([0.2, -0.1]),
    swing_phase=np.array([0.3, 1.2]),
    swing_period=2.7,
    first=0.3,
    last=1.4,
    length=5.0,
)
DRAWN = random_fourier(
    seed=7, harmonics=4, period=3.0, peak_velocity=np.array([1.0, 0.5]), offset=START, periods=2
)

SLOW = MotionLimits(velocity=(2.0, 2.0, 2.0))  # an MJCF has no speed limits


def test_motions_to_the_last_digit(unchanged: Unchanged) -> None:
    motions = {
        "sweep": SWEEP,
        "chirp": chirp(start=START, amplitude=AMPLITUDE, first=0.2, last=1.5, length=6.0),
        "sine": Sine(offset=START, amplitude=AMPLITUDE, frequency=0.7, periods=3),
        "drawn": DRAWN,
        "back": Reversed(forward=SWEEP),
        "drawn back": DRAWN.reverse_time(),
        "twice back": SWEEP.reverse_time().reverse_time(),
    }
    ends = np.array([-1e-8, -5e-10, 0.0, 5.0, 5.0 + 5e-10, 5.0 + 1e-8, 7.0])
    unchanged(
        {
            **{
                name: [motion.duration, *motion.sample(np.linspace(-0.3, 7.0, 24))]
                for name, motion in motions.items()
            },
            "ends": SWEEP.sample(ends),
            "coefficients": [DRAWN.a, DRAWN.b],
            "one period": sample_one_period(DRAWN),
            "one period's rows": len(sample_one_period(DRAWN)[0]),
        },
        rtol=1e-8,
        atol=1e-11,
    )


def fourier(*a: float, b: tuple[float, ...] = (0.0, 0.0)) -> Callable[[], object]:
    """A motion of two joints; the second coefficients decide whether it starts at rest."""
    first = np.array([[1.0, -1.0], a])
    return lambda: Fourier(offset=START, a=first, b=np.array([[0.0, 0.0], b]), period=1.0)


def drawn(harmonics: int) -> Callable[[], object]:
    return lambda: random_fourier(
        seed=0, harmonics=harmonics, period=1.0, peak_velocity=AMPLITUDE, offset=START
    )


MOTIONS: dict[str, tuple[Callable[[], object], Callable[[], object], str]] = {
    "sum of a": (fourier(0.5, -0.5 + 9e-10), fourier(0.5, -0.5 + 1.1e-9), "joint 2"),
    "sum of b": (fourier(0.5, -0.5, b=(0.2, -0.1)), fourier(0.5, -0.5, b=(0.2, 0.1)), "0.4 rad/s"),
    "sum relative to b": (
        fourier(0.5, -0.5 + 1.9e-9, b=(2.0, -1.0)), fourier(0.5, -0.5 + 2.1e-9, b=(2.0, -1.0)),
        "joint 2",
    ),
    "harmonics": (drawn(2), drawn(1), "1 harmonics"),
    "frequencies": (
        lambda: replace(SWEEP, last=0.31), lambda: replace(SWEEP, last=0.3), "0.3 to 0.3 Hz",
    ),
}  # fmt: skip


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_motion_is_refused_beyond_its_limit(motion: str) -> None:
    valid, wrong, value = MOTIONS[motion]
    valid()
    with pytest.raises(ConfigError, match=re.escape(value)):
        wrong()


INSIDE = ((-1.0, 1.0), (-1.0, 1.0))


@pytest.mark.parametrize(
    ("valid", "wrong"),
    [
        ({"position": (*INSIDE, (-2.0, 2.0))}, {"position": (*INSIDE, (-2.5, 1.0))}),
        ({"position": (*INSIDE, (-2.0, 2.0))}, {"position": (*INSIDE, (-1.0, 2.5))}),
        ({"position": (*INSIDE, (0.0, 1.0))}, {"position": (*INSIDE, (1.0, 1.0))}),
        ({"velocity": (1.0, 1.0, 1.0)}, {"velocity": (1.0, 0.0, 1.0)}),
        ({"velocity": (1.0, 1.0, 1.0)}, {"velocity": (1.0, 1.0)}),
        ({"position": (*INSIDE, (0.0, 1.0))}, {"position": INSIDE}),
    ],
)
def test_limits_are_refused_beyond_those_of_the_model(
    valid: dict[str, object], wrong: dict[str, object], arm_model: Robot
) -> None:
    def limits(changes: dict[str, object]) -> Limits:
        data = {"velocity": SLOW.velocity} | changes
        return Limits.from_settings(arm_model, MotionLimits.model_validate(data))

    limits(valid)
    with pytest.raises((RobotError, ValidationError)):
        limits(wrong)


@pytest.mark.parametrize(
    ("key", "wrong", "valid"),
    [
        ("harmonics", 1, 2),
        ("periods", 0, 1),
        ("starts", 0, 1),
        ("seed", -1, 0),
        ("sample_rate", 0.0, 1e-3),
        ("period", (2.0, 1.0), (2.0, 2.0)),
    ],
)
def test_settings_are_refused_beyond_their_bounds(key: str, wrong: object, valid: object) -> None:
    ExcitationSettings.model_validate({key: valid})
    with pytest.raises(ValidationError):
        ExcitationSettings.model_validate({key: wrong})


def test_limits_of_a_model(tmp_path: Path, unchanged: Unchanged, arm_model: Robot) -> None:
    path = tmp_path / "odd.urdf"
    joint = '<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{n}"/>'
    joint += (
        '<axis xyz="0 0 1"/><limit lower="-1" upper="{u}" effort="{e}" velocity="{v}"/></joint>'
    )
    odd = ((1.0, 30.0, 0.5), (3.0, 0.0, 2.5), (2.0, 0.5, 0.0))
    parts = ['<link name="l0"/>']
    for k, (u, e, v) in enumerate(odd):
        parts += [joint.format(k=k, n=k + 1, u=u, e=e, v=v), f'<link name="l{k + 1}"/>']
    path.write_text(f'<robot name="odd">{"".join(parts)}</robot>', encoding="utf-8")
    model = Robot(RobotDescription(name="odd", model=path, joints=("j0", "j1", "j2")))
    given = MotionLimits(position=((-0.4, 0.6), (-1.0, 0.3), (-0.2, 1.0)), velocity=(9.0, 0.5, 1.0))
    narrow = replace(Limits.from_settings(arm_model, given), torque=np.array([1.0, 40.0, 9.0]))
    rest, still = narrow.find_rest_position(arm_model)[None, :], np.zeros((1, 3))
    held = arm_model.torque(arm_model.nominal_parameters, rest, still, still)
    unchanged(
        {
            "of the model": Limits.from_settings(model, MotionLimits(velocity=(0.5, 2.5, 2.0))),
            "finite": np.isfinite(
                Limits.from_settings(model, MotionLimits(velocity=(0.5, 2.5, 2.0))).torque
            ),
            "given": Limits.from_settings(arm_model, given),
            "rest": np.max(np.abs(held) / narrow.torque),
        },
        rtol=1e-4,
    )


def test_inputs_of_a_search(
    arm_model: Robot, unchanged: Unchanged, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = replace(Limits.from_settings(arm_model, SLOW), torque=np.array([3.0, 8.0, 1.0]))
    search = FourierSearch(robot=arm_model, limits=limits, harmonics=3, period=(3.0, 9.0))
    x = np.random.default_rng(3).normal(0.0, 0.5, 16)
    x[-1] = np.log(4.0)
    unpacked = search.unpack(x)
    given: list[list[float]] = []

    def minimize(objective: object, x0: np.ndarray, **more: object) -> SimpleNamespace:
        """Stub that records the search and skips it."""
        bounds = [y for pair in more["bounds"] for y in pair if y is not None]
        given.append([*more["args"], more["options"]["maxiter"], more["jac"], *x0, *bounds])
        return SimpleNamespace(x=x0)

    monkeypatch.setattr(excitation, "minimize", minimize)
    settings = ExcitationSettings(
        harmonics=3, period=(2.0, 6.0), periods=2, starts=3, seed=4, limits=SLOW
    )
    found = design(arm_model, settings)
    slow = design(arm_model, settings.model_copy(update={"sample_rate": 0.7}))
    unchanged(
        {
            "objective": [search.value_and_gradient(x, weight) for weight in (0.0, 7.0)],
            "unpacked": unpacked,
            "packed": search.pack(unpacked) - x,
            "spaces": [
                space @ space.T
                for space in (_find_null_space(np.arange(1.0, 5.0)), search._at_rest[1])
            ],
            "drawn": random_motions(arm_model, settings, 2, 5),
            "given": given,
            "found": found.motion,
            "condition": found.condition,
            "of another": condition(arm_model, search.base[:4], found.motion),
            "rate": [found.sample_rate, slow.sample_rate, slow.motion.period],
            "peak": found.peak_torque,
            "setpoints": found.setpoints(),
            "rows": len(found.setpoints()[0]),
        },
        rtol=1e-4,
        atol=1e-7,
    )
