"""The arm of a closed loop in a window, or without a screen in a video or an animation."""

import ctypes.util
import errno
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from cosim.workflow.answer import Written
from hesr.extras.view.stage import HEIGHT, WIDTH, Selection, Stage, ViewOptions, choose
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.support.extras import install_command
from hesr_model.support.files import written_whole
from hesr_model.support.progress import Progress, Stages, deferred, report_progress, silent


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
    options = ViewOptions(laws=law, scheme=scheme, magnify=magnify, speed=speed)
    selection = choose(results, options)
    if output is None:
        show(selection, options)
        return Written(lines=[f"Shown: {', '.join(selection.runs)}."])
    seconds = write_video(output, selection, options, progress=partial(progress, "drawing"))
    return Written(lines=[f"{seconds:.1f} s of video"], files=[output])


_CLOSING_TIME = 10.0  # [s] for the viewer to close
_REFRESH_RATE = 60.0  # [Hz], update rate of the viewer


def show(selection: Selection, options: ViewOptions, *, turns: int | None = None) -> None:
    """Show the motion until the viewer is closed, or `turns` times."""
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        raise ConfigError("no screen found; write a video (-o FILE.mp4).")
    from mujoco import viewer  # fails without a screen

    stage = Stage(selection, options)
    previous_threads = set(threading.enumerate())
    with ExitStack() as cleanup:
        with deferred():  # an interrupt while it opens would end Python before its drawing thread
            try:
                window = viewer.launch_passive(
                    stage.mj_model, stage.mj_data, show_left_ui=False, show_right_ui=False
                )
            except RuntimeError as error:  # macOS needs MuJoCo's own interpreter
                raise ConfigError(
                    f"the viewer cannot open ({str(error).rstrip('.')}); write a video "
                    "(-o FILE.mp4)."
                ) from error
            # Python must not end before that thread has noticed the end.
            for thread in set(threading.enumerate()) - previous_threads:
                cleanup.callback(thread.join, _CLOSING_TIME)
            cleanup.enter_context(window)
        camera = window.cam
        camera.lookat = stage.camera.lookat
        camera.distance = stage.camera.distance
        camera.azimuth = stage.camera.azimuth
        camera.elevation = stage.camera.elevation
        start = time.monotonic()
        while window.is_running():
            turn, t = divmod(options.speed * (time.monotonic() - start), stage.duration)
            if turns is not None and turn >= turns:
                break
            with window.lock():
                stage.set(t)
                if window.user_scn is not None:
                    window.user_scn.ngeom = 0
                    stage.annotate(window.user_scn, t)
            window.set_texts((None, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT, *stage.legend(t)))
            window.sync()
            time.sleep(1.0 / _REFRESH_RATE)


Image = NDArray[np.uint8]

RATE = 30  # frames per second
_ANIMATION_DIVISOR = 2  # of size and rate
_BACKENDS = {"egl": "EGL", "osmesa": "OSMesa"}
_MAX_GEOMS = 4000


def write_video(
    path: Path, selection: Selection, options: ViewOptions, *, progress: Progress = silent
) -> float:
    """Write a video (.mp4) or an animation (.webp); return its length [s]."""
    kind = path.suffix.lower()
    if kind not in (".mp4", ".webp"):
        raise ConfigError(f"{path}: a video ends in .mp4 or .webp.")
    rate = RATE if kind == ".mp4" else RATE / _ANIMATION_DIVISOR
    encoding = partial(_encode_video, _find_encoder()) if kind == ".mp4" else _write_animation
    stage = Stage(selection, options)
    frame_count = max(round(stage.duration / options.speed * rate), 1)
    with (
        written_whole(path) as temporary,
        open_renderer(stage) as draw,
        encoding(temporary, path) as write,
    ):
        for k in report_progress(range(frame_count), progress):
            write(draw(k * options.speed / rate))
    return frame_count / rate


@contextmanager
def open_renderer(stage: Stage) -> Iterator[Callable[[float], Image]]:
    """Yield a function that draws the scene at a time [s], as (HEIGHT, WIDTH, 3)."""
    with ExitStack() as cleanup:
        try:
            context = _load_gl_context()(WIDTH, HEIGHT)
            cleanup.callback(context.free)
            context.make_current()
            gl_target = mujoco.MjrContext(stage.mj_model, mujoco.mjtFontScale.mjFONTSCALE_150)
        except Exception as error:  # drivers raise their own types
            if isinstance(error, ConfigError):
                raise
            raise ConfigError(
                f"OpenGL is not available ({_take_first_line(error)}); try MUJOCO_GL=osmesa or "
                "MUJOCO_GL=egl."
            ) from error
        cleanup.callback(gl_target.free)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, gl_target)
        scene = mujoco.MjvScene(stage.mj_model, maxgeom=_MAX_GEOMS)
        scene_arguments = stage.mj_model, stage.mj_data, mujoco.MjvOption(), None, stage.camera
        text_style = mujoco.mjtFont.mjFONT_NORMAL, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT
        view = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        image: Image = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)

        def draw(t: float) -> Image:
            stage.set(t)
            mujoco.mjv_updateScene(*scene_arguments, mujoco.mjtCatBit.mjCAT_ALL, scene)
            stage.annotate(scene, t)
            mujoco.mjr_render(view, scene, gl_target)
            mujoco.mjr_overlay(*text_style, view, *stage.legend(t), gl_target)
            mujoco.mjr_readPixels(image, None, view, gl_target)
            return np.ascontiguousarray(image[::-1])

        yield draw


def _load_gl_context() -> Any:
    backend = os.environ.get("MUJOCO_GL", "").lower().strip()
    if sys.platform == "linux" and not backend:
        installed = [
            name for name, library in _BACKENDS.items() if ctypes.util.find_library(library)
        ]
        if not installed:
            raise ConfigError("videos need libEGL or libOSMesa (Debian: libegl1, libosmesa6).")
        backend = installed[0]
    module = backend if backend in _BACKENDS else "gl_context"
    return import_module(f"mujoco.{module}").GLContext


def _find_encoder() -> str:
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except ImportError as error:
        raise ConfigError(
            f"videos need the package imageio-ffmpeg: {install_command('video')}."
        ) from error
    except RuntimeError as error:
        raise ConfigError(f"ffmpeg is missing ({_take_first_line(error)}).") from error


@contextmanager
def _encode_video(encoder: str, file: Path, path: Path) -> Iterator[Callable[[Image], object]]:
    input_options = [
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        f"{WIDTH}x{HEIGHT}",
        "-r",
        str(RATE),
    ]
    output_options = [
        "-c:v",
        "libx264",
        "-crf",
        "20",
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
    ]
    command = [
        encoder,
        "-y",
        "-loglevel",
        "error",
        *input_options,
        "-i",
        "-",
        *output_options,
        str(file),
    ]
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=messages)
        pipe = process.stdin
        assert pipe is not None
        try:
            yield lambda image: pipe.write(image.tobytes())
            pipe.close()
        except BrokenPipeError:  # reported below
            pass
        except BaseException:
            process.kill()
            raise
        finally:
            with suppress(BrokenPipeError):
                pipe.close()
            process.wait()
        if process.returncode:
            messages.seek(0)
            lines = messages.read().decode(errors="replace").strip().splitlines()
            full_disk_text = os.strerror(errno.ENOSPC)
            if any(full_disk_text in line for line in lines):  # it may not be the last line
                raise OSError(errno.ENOSPC, full_disk_text, str(path))
            reason = lines[-1].rstrip(".") if lines else f"exit code {process.returncode}"
            raise ArtifactError(f"{path}: the video cannot be encoded ({reason}).")


@contextmanager
def _write_animation(file: Path, path: Path) -> Iterator[Callable[[Image], object]]:
    import PIL.Image

    del path
    frames: list[PIL.Image.Image] = []
    size = (WIDTH // _ANIMATION_DIVISOR, HEIGHT // _ANIMATION_DIVISOR)
    yield lambda image: frames.append(PIL.Image.fromarray(image).resize(size))
    options = {"save_all": True, "loop": 0, "quality": 60, "method": 4}
    options["duration"] = round(1000 * _ANIMATION_DIVISOR / RATE)
    frames[0].save(file, "WEBP", append_images=frames[1:], **options)


def _take_first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
