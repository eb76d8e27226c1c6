"""Reports, pages of Markdown, videos and views of results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cosim.workflow.answer import Answer, Written
from cosim.workflow.arguments import list_names, list_paths, require_items
from hesr_model.errors import ArgumentError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, path_of
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.workflow.arguments import Names, Paths


def report(
    results: Paths,
    *,
    output: PathArg | None = None,
    view: bool = False,
    law: Names = (),
    scheme: str | None = None,
    magnify: float = 1.0,
    speed: float = 1.0,
    progress: Stages = silent,
) -> Path:
    """Rebuild the report of a run, or show its closed loop.

    The suffix of the output decides: one page (.html), tables for a repository (.md), a video of
    the arm (.mp4) or an animated picture (.webp). The arm is drawn over a ghost of its commanded
    pose.

    Parameters
    ----------
    results : path or sequence of paths
        Folders that 'hesr run' has written; several for Markdown, which begins with a table over
        robots: recommended law against the strongest reference.
    output : path, optional
        File to write; by default RESULT/report.html.
    view : bool
        Show the closed loop in a window.
    law : str or sequence of str, optional
        View and video: laws to show side by side, repeatable; by default the rigid body alone and
        the law that tracks best.
    scheme : str, optional
        View and video: control scheme, named as in the tables of the run; default: servo_inversion.
    magnify : float
        View and video: magnification of the deviations from the commanded pose.
    speed : float
        View and video: speed of the motion relative to real time.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    Path
        The file, or the folder of a view.

    Raises
    ------
    HesrError
        If results are missing or damaged, or the output has another suffix.

    Examples
    --------
    On the command line::

        $ hesr report results/uf850 -o uf850.html
        $ hesr report results/uf850 results/ur10e -o docs/results.md
        $ hesr report results/uf850 --view --law stribeck --law parfam_h --magnify 20
        $ hesr report results/uf850 --speed 0.5 -o arm.mp4

    >>> import hesr
    >>> hesr.report("results/uf850").name
    'report.html'
    """
    from cosim.report.page import write_report

    folders = list_paths("results", results)
    require_items("results", folders)
    laws = list_names("law", law)
    path = None if output is None else path_of(output, "'output'")
    drawn = {"law": laws, "scheme": scheme, "magnify": magnify, "speed": speed}
    given = laws or scheme is not None or (magnify, speed) != (1.0, 1.0)
    suffix = path.suffix.lower().lstrip(".") if path else "html"
    writers = plugins.load("hesr.reports")
    kind = "view" if view else suffix
    kind = next((name for name in writers if (folders[0] / f"{name}.json").is_file()), kind)
    if kind in writers and kind != "md":
        if len(folders) > 1:
            raise ArgumentError("give one result; use 'law' to compare laws.")
        writers[kind].load()(folders[0], path, progress=progress, **drawn)
        return path or folders[0]
    if given:
        raise ArgumentError(
            "'law', 'scheme', 'magnify' and 'speed' are for 'view' and videos (.mp4, .webp)."
        )
    if kind in writers and path is not None:
        return Path(writers[kind].load()(folders, path))
    if view or kind not in ("html", "htm", ""):
        known = ", ".join(f".{one}" for one in ("html", *writers) if one not in ("view", "paper"))
        raise ArgumentError(f"{path}: reports are {known}.")
    if len(folders) > 1:
        raise ArgumentError("a page (.html) shows one result; use Markdown (.md) for several.")
    return write_report(folders[0], path, progress=progress)


def answer(path: Path, _: PathArg | None) -> Answer:
    """Return the answer of a report: its file."""
    if path.is_dir():
        return Written(format="hesr-report-1", lines=[f"Shown: {path}"])
    return Written(format="hesr-report-1", lines=[], data=str(path), files=[path])
