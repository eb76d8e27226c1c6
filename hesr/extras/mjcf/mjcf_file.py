"""MJCF export: friction as passive actuators."""

import json
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from importlib.metadata import version
from itertools import zip_longest
from pathlib import Path
from xml.sax.saxutils import quoteattr

from fmu_src.friction.validity import require_exportable
from hesr.extras.mjcf.parts import JointFriction, NoCounterpartError, parts_of
from hesr.extras.mjcf.projection import Misfit, projected, records
from hesr_model.errors import ExportError, HesrError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import written_whole
from hesr_model.support.progress import Progress, counted, silent
from hesr_model.units import unit_of_joint

_HEAD = """\
<!-- Friction of joints as passive actuators of MuJoCo (4.0 or later). Put
       <include file="FILE.xml"/>
     into the model of the robot, whose joints are named as here and which has no other friction
     (frictionloss, damping, friction actuators). MuJoCo relaxes a bristle exactly over a step in
     which the velocity is held, and applies its torque explicitly: take steps of about 1 ms. -->
<mujoco>
  <custom>
"""


@dataclass(frozen=True, kw_only=True)
class JointProjection:
    """Export of one joint; `missing` is the term without a counterpart (None: exact).

    `fitted` and `unseen` are errors on the fitted and on another motion.
    """

    joint: str
    missing: str | None = None
    fitted: Misfit | None = None
    unseen: Misfit | None = None
    unit: str = "N.m"

    def __str__(self) -> str:
        if self.fitted is None or self.unseen is None:
            return f"{self.joint}: exact"
        fitted, unseen = self.fitted, self.unseen
        return (
            f"{self.joint}: projected, since {self.missing}; RMSE {fitted.rmse:.3g} {self.unit} "
            f"where fitted and {unseen.rmse:.3g} {self.unit} on another motion, at most "
            f"{100.0 * fitted.relative:.3g} and {100.0 * unseen.relative:.3g} % of the largest "
            "torque"
        )


@dataclass(frozen=True, kw_only=True)
class Projection:
    """Export of a friction model."""

    joints: tuple[JointProjection, ...]

    @property
    def exact(self) -> bool:
        """Whether the MJCF equals the model except for round-off."""
        return all(joint.missing is None for joint in self.joints)

    def lines(self) -> list[str]:
        """Return a line per joint, which `hesr export` prints."""
        return [str(joint) for joint in self.joints]


def export_mjcf_law(
    model: FrictionModel, path: Path, *, project: bool = False, progress: Progress = silent
) -> Projection:
    """Write a friction model as passive dcmotors on the joints of the same names in an MJCF."""
    if path.suffix.lower() != ".xml":
        raise ExportError(f"{path}: the name of an MJCF ends in .xml.")
    require_exportable(model, "an MJCF of one actuator per joint", coupled=False)
    with written_whole(path) as temporary:
        joints = [
            _of_joint(model, index, project)
            for index in counted(range(len(model.joints)), progress)
        ]
        report = Projection(joints=tuple(found for _, found in joints))
        text = "".join(_document(model, [parts for parts, _ in joints], report))
        temporary.write_text(text, encoding="utf-8")
    return report


def _of_joint(
    model: FrictionModel, index: int, project: bool
) -> tuple[JointFriction, JointProjection]:
    law, joint = model.laws[index], model.joints[index]
    try:
        return parts_of(law), JointProjection(joint=joint)
    except NoCounterpartError as error:
        slides = model.slides[index]
        missing = error.at_joint(slides=slides)
        refused = f"law '{model.law}' of joint '{joint}' is not expressible in MJCF: {missing};"
        trained = model.trained[index] if model.trained else None
        try:
            if project:
                nearest, fitted, unseen = projected(law, trained, model.sample_time)
            else:
                records(law, trained, model.sample_time)  # refuse what --project would also refuse
        except HesrError as reason:
            raise ExportError(f"{refused} nor can it be projected: {reason}") from reason
        if not project:
            raise ExportError(
                f"{refused} --project writes the nearest bristles and their errors."
            ) from error
        found = JointProjection(
            joint=joint,
            missing=missing,
            fitted=fitted,
            unseen=unseen,
            unit=unit_of_joint("N.m", slides=slides),
        )
        return parts_of(nearest), found


def _document(
    model: FrictionModel, joints: list[JointFriction], report: Projection
) -> Iterator[str]:
    yield _HEAD
    texts = {
        "law": f"{model.law} of {model.robot}, made at {model.sample_time:g} s, by HESR "
        f"{version('hesr')}",
        "provenance": json.dumps(dict(model.provenance), sort_keys=True),
        "error": "; ".join(report.lines()),
    }
    for name, text in texts.items():
        name = quoteattr(f"{model.robot}_friction_{name}")
        yield f"    <text name={name} data={quoteattr(text)}/>\n"
    yield "  </custom>\n  <actuator>\n"
    for joint, parts in zip(model.joints, joints, strict=True):
        for number, attributes in enumerate(_actuators(parts), start=1):
            name = quoteattr(f"{joint}_{model.law}{number}")
            yield (
                f"    <dcmotor name={name} joint={quoteattr(joint)}"
                f' input="none" resistance="1" motorconst="0 0" gear="1"\n'
                f"      {attributes}/>\n"
            )
    yield "  </actuator>\n</mujoco>\n"


def _actuators(parts: JointFriction) -> Iterator[str]:
    pairs = list(zip_longest(parts.bristles, parts.waves)) or [(None, None)]
    for k, (bristle, wave) in enumerate(pairs):
        numbers = {
            "lugre": astuple(bristle) if bristle else (0.0,) * 5,
            "damping": (0.0 if k else parts.viscous,),
            "cogging": astuple(wave) if wave else (0.0,) * 3,
        }
        yield " ".join(
            f'{name}="{" ".join(f"{x:.17g}" for x in values)}"' for name, values in numbers.items()
        )
