"""Strokes at one speed are found, and laws are not told apart by them."""

import logging
from pathlib import Path

import numpy as np
import pytest
from rotor import describe_rotor

import hesr
from hesr_model.logs.robot_log import Log
from hesr_model.logs.strokes import find_single_speeds

T = np.arange(0.0, 40.0, 0.005)
STROKES = np.where(T // 10 % 2 < 1, 0.4, -0.4)


@pytest.mark.parametrize(
    ("speed", "expected"),
    [
        (STROKES, (0.4,)),
        (np.where(STROKES > 0.0, 0.4, -0.8), (0.4, 0.8)),
        (STROKES * (1.0 + T // 20), ()),
        (0.4 * np.sin(T), ()),
        (np.zeros_like(T), ()),
    ],
)
def test_a_single_speed_is_found(speed: np.ndarray, expected: tuple[float, ...]) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.02, T.size)
    speeds = find_single_speeds([T], [speed + noise * (speed != 0.0)], 0.02)
    assert speeds == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("speed", "check"), [(STROKES, "one-speed"), (0.5 + 0.3 * np.sin(T), "one-way")]
)
def test_such_motion_chooses_no_law(
    speed: np.ndarray, check: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A law of speed would be free where the joint never is, at 2 N.m instead of 0.3 N.m."""
    rng = np.random.default_rng(0)
    q = np.cumsum(speed) * 0.005 + 5e-4 * rng.standard_normal(T.size)
    velocity = speed + 0.06 * np.convolve(rng.standard_normal(T.size), np.ones(4) / 4, "same")
    tau = 0.3 * np.sign(speed) + 0.1 * speed + 0.02 * rng.standard_normal(T.size)
    robot = describe_rotor(tmp_path)
    log = Log(name="run", t=T, q=q[:, None], dq=velocity[:, None], tau=tau[:, None], robot=robot)
    with caplog.at_level(logging.WARNING):
        law = hesr.fit(log, law="choose")
    assert f"[{check}]" in caplog.text
    assert law.law == "coulomb_viscous"
    slow = law.predict(t=np.array([0.0, 0.01]), dq=np.full((2, 1), 0.03))
    assert np.abs(slow).max() < 0.4
