"""The chosen rigid body of a twin whose model file has wrong masses, on another motion."""

import sys

import numpy as np
from body_draws import try_draw

from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder

DRAWS = 40
SHARE_OF_DRAWS = 0.9
MAX_RATIO = 1.02  # in that share of draws
WORST_RATIO = 1.15


def test_the_chosen_body_is_hardly_ever_worse_than_the_given_one() -> None:
    robot = Robot(models_folder() / "uf850" / "robot.toml")
    draws = [try_draw(robot, seed) for seed in range(DRAWS)]
    lines = []
    for draw in draws:
        kinds = ", ".join(f"{kind} {ratio:.2f}" for kind, ratio in draw.ratios.items())
        motion = f"{draw.seconds:.1f} s, {draw.harmonics} harmonics, {draw.amplitude:.2f} of reach"
        lines.append(f"{motion}: {draw.kind} {draw.ratio:.3f} ({kinds})")
    ratios = np.array([draw.ratio for draw in draws])
    share = float(np.mean(ratios <= MAX_RATIO))
    mean_ratio = np.exp(np.mean(np.log(ratios)))
    lines.append(f"at most {MAX_RATIO} in {share:.0%}; worst {ratios.max():.3f}; {mean_ratio:.3f}")
    sys.stdout.write("\n".join(["", *lines, ""]))
    assert share >= SHARE_OF_DRAWS
    assert ratios.max() <= WORST_RATIO
