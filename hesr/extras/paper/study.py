"""Files of the study: logs, laws and controllers, and the claims with what tests them."""

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from cosim.loop.closed_loop import PerJoint, Tracking
from cosim.study.study import Study, Twin
from hesr_model.support.config import Config

Limit = float | tuple[float, ...]  # for all values of a claim, or one for each


class Claim(Config):
    """A claim of the paper, and the measure and limits that decide on it."""

    number: int = Field(ge=1)
    text: str
    where: str  # section, table or figure
    printed: str  # figures of the paper
    test: str  # meaning of the values
    measure: str = ""  # function of `hesr.extras.paper.measures`; none if not testable
    options: Mapping[str, Any] = {}  # its arguments
    joint: str = ""  # the only one, such as J2
    at_least: Limit | None = None
    at_most: Limit | None = None


class PaperStudy(Study):
    """Study of a twin whose laws are trained on the sweep, and on a sine of one joint at a time."""

    claims: tuple[Claim, ...] = Field(min_length=1)
    sine: tuple[str, ...] = Field(min_length=1)  # log that trains each joint
    literal: str  # the paper's own law, a variant
    controllers: Mapping[str, Mapping[str, PerJoint | float]]  # changed gains by name
    twin: Twin
    tracking: Tracking
