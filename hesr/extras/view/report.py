"""The arm of a closed loop in a window, a video or an animation."""

import os
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import mujoco

from cosim.workflow.answer import Written
from hesr.extras.view.stage import Shown, Stage, ViewOptions, choose
from hesr_model.errors import ConfigError
from hesr_model.support.progress import Stages, silent

_PATIENCE = 10.0  # [s] for the viewer to close
_RATE = 60.0  # [Hz], update rate of the viewer


def show(shown: Shown, choice: ViewOptions, *, turns: int | None = None) -> None:
    """Show the motion until the viewer is closed, or `turns` times."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise ConfigError("no screen found; write a video (-o FILE.mp4).")
    from mujoco import viewer  # fails without a screen

    stage = Stage(shown, choice)
    before = set(threading.enumerate())
    try:
        window = viewer.launch_passive(
            stage.model, stage.data, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # macOS needs MuJoCo's own interpreter
        raise ConfigError(
            f"the viewer cannot open ({str(error).rstrip('.')}); write a video (-o FILE.mp4)."
        ) from error
    with ExitStack() as cleanup:
        # Python must not end before its drawing thread has noticed the end.
        for thread in set(threading.enumerate()) - before:
            cleanup.callback(thread.join, _PATIENCE)
        cleanup.enter_context(window)
        camera = window.cam
        camera.lookat, camera.distance = stage.camera.lookat, stage.camera.distance
        camera.azimuth, camera.elevation = stage.camera.azimuth, stage.camera.elevation
        start = time.monotonic()
        while window.is_running():
            turn, t = divmod(choice.speed * (time.monotonic() - start), stage.duration)
            if turns is not None and turn >= turns:
                break
            with window.lock():
                stage.set(t)
                if window.user_scn is not None:
                    window.user_scn.ngeom = 0
                    stage.annotate(window.user_scn, t)
            window.set_texts((None, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT, *stage.legend(t)))
            window.sync()
            time.sleep(1.0 / _RATE)


def show_arm(
    results: Path,
    output: Path | None = None,
    *,
    law: Sequence[str] = (),
    scheme: str | None = None,
    magnify: float = 1.0,
    speed: float = 1.0,
    progress: Stages = silent,
) -> Written:
    """Show the arm of a closed loop next to its commanded pose.

    `output` is a .mp4, a .webp, or None for a window; by default it shows the rigid body alone and
    the best law. `magnify` scales deviations.
    """
    choice = ViewOptions(laws=law, scheme=scheme, magnify=magnify, speed=speed)
    shown = choose(results, choice)
    if output is None:
        show(shown, choice)
        return Written(lines=[f"Shown: {', '.join(shown.runs)}."])
    from hesr.extras.view.video import write_video

    seconds = write_video(output, shown, choice, progress=partial(progress, "drawing"))
    return Written(lines=[f"{seconds:.1f} s of video"], files=[output])
