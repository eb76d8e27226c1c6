"""Reports, pages of Markdown, videos and views of results."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from cosim.workflow.answer import Answer, Written
from cosim.workflow.arguments import (
    list_names,
    list_paths,
    require_items,
    require_text,
    to_optional_output,
)
from hesr_model.errors import ArgumentError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg
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
    r"""Rebuild the report of a run, or show its closed loop.

    The suffix of the output decides: one page (.html), tables for a repository
    (.md), a video of the arm (.mp4) or an animated picture (.webp). The arm is
    drawn over a ghost of its commanded pose.

    Parameters
    ----------
    results : path or sequence of paths
        Folders that `run` has written; several for Markdown, which begins
        with a table over robots: recommended law against the strongest
        reference.
    output : path, optional
        File to write; by default RESULT/report.html.
    view : bool
        Show the closed loop in a window.
    law : str or sequence of str, optional
        View and video: laws to show side by side; by default the
        rigid body alone and the law that tracks best.
    scheme : str, optional
        View and video: control scheme, named as in the tables of the run;
        default: servo_inversion.
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
        $ hesr report results/uf850 --view --law stribeck --law parfam_h \
          --magnify 20
        $ hesr report results/uf850 --speed 0.5 -o arm.mp4

    >>> import hesr
    >>> hesr.report("results/my_arm").name
    'report.html'
    """
    from cosim.report.page import write_report

    folders = list_paths("results", results)
    require_items("results", folders)
    laws = list_names("law", law)
    require_text("scheme", scheme)
    path = to_optional_output("output", output)
    writers = plugins.load("hesr.reports")
    kind = _choose_kind(folders[0], path, writers, view=view)
    if kind in writers and kind != "md":
        if len(folders) > 1:
            raise ArgumentError("give one result; use 'law' to compare laws.")
        writers[kind].load()(
            folders[0],
            path,
            progress=progress,
            law=laws,
            scheme=scheme,
            magnify=magnify,
            speed=speed,
        )
        return path or folders[0]
    if laws or scheme is not None or magnify != 1.0 or speed != 1.0:
        raise ArgumentError(
            "'law', 'scheme', 'magnify' and 'speed' are for 'view' and videos (.mp4, .webp)."
        )
    if kind in writers and path is not None:
        return Path(writers[kind].load()(folders, path))
    _require_page(kind, path, writers)
    if len(folders) > 1:
        raise ArgumentError("a page (.html) shows one result; use Markdown (.md) for several.")
    return write_report(folders[0], path, progress=progress)


def _require_page(kind: str, path: Path | None, writers: Iterable[str]) -> None:
    """Refuse a kind of report that no package writes."""
    if kind not in ("html", "htm", ""):
        suffixes = [f".{name}" for name in ("html", *writers) if name not in ("view", "paper")]
        raise ArgumentError(f"{path}: reports are {', '.join(suffixes)}.")


def _choose_kind(
    results_folder: Path, path: Path | None, writers: Iterable[str], *, view: bool
) -> str:
    """Return the kind of a report: that of special results, a view, or that of the suffix."""
    for name in writers:
        if (results_folder / f"{name}.json").is_file():
            return name
    if view:
        return "view"
    return path.suffix.lower().lstrip(".") if path else "html"


def answer(path: Path, _: PathArg | None) -> Answer:
    """Return the answer of a report: its file."""
    if path.is_dir():
        return Written(format="hesr-report-1", lines=[f"Shown: {path}"])
    return Written(format="hesr-report-1", lines=[], data=str(path), files=[path])
