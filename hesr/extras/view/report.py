"""The arm of a closed loop in a window, a video or an animation."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from cosim.workflow.answer import Written
from hesr_model.support.progress import Stages, silent


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
    from hesr.extras.view.runs import ViewOptions, choose

    choice = ViewOptions(laws=law, scheme=scheme, magnify=magnify, speed=speed)
    shown = choose(results, choice)
    if output is None:
        from hesr.extras.view.window import show

        show(shown, choice)
        return Written(lines=[f"Shown: {', '.join(shown.runs)}."])
    from hesr.extras.view.video import write_video

    seconds = write_video(output, shown, choice, progress=partial(progress, "drawing"))
    return Written(lines=[f"{seconds:.1f} s of video"], files=[output])
