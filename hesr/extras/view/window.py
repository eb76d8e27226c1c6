"""The scene in MuJoCo's viewer, on a screen."""

import os
import sys
import threading
import time
from contextlib import ExitStack

import mujoco

from hesr.extras.view.runs import Shown, ViewOptions
from hesr.extras.view.stage import Stage
from hesr_model.errors import ConfigError

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
