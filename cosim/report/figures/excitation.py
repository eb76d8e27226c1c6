"""Picture of a designed motion."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hesr_model.motions.excitation import Excitation
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole

_ROW_HEIGHT = 1.8
_WIDTH = 9.0
_DPI = 120


def excitation(path: Path, designed: Excitation, joints: Sequence[str]) -> None:
    """Draw position and velocity of a designed motion over time, with their limits.

    Parameters
    ----------
    path : picture to write, in the format of its suffix.
    joints : names, from base to tip.

    Raises
    ------
    ArtifactError
        If the picture cannot be written.
    """
    t, q, dq, _ = designed.setpoints()
    limits = designed.limits
    figure = Figure(figsize=(_WIDTH, _ROW_HEIGHT * len(joints)), layout="constrained")
    axes = figure.subplots(len(joints), 2, sharex=True, squeeze=False)
    for k, (joint, (position, velocity)) in enumerate(zip(joints, axes, strict=True)):
        _draw(position, t, q[:, k], (limits.lower[k], limits.upper[k]))
        _draw(velocity, t, dq[:, k], (-limits.velocity[k], limits.velocity[k]))
        position.set_ylabel(joint)
    axes[0, 0].set_title("position [rad; m where prismatic]")
    axes[0, 1].set_title("velocity [rad/s; m/s where prismatic]")
    for axis in axes[-1]:
        axis.set_xlabel("t [s]")
    with written_whole(path) as temporary:
        # Without the version of the drawing library the same motion gives the same bytes.
        figure.savefig(temporary, dpi=_DPI, metadata={"Software": None})


def _draw(axis: Axes, t: Array, values: Array, limits: tuple[float, float]) -> None:
    axis.plot(t, values, linewidth=1.0)
    for limit in limits:
        axis.axhline(limit, color="C3", linestyle="--", linewidth=0.8)
    axis.margins(x=0.0)
