"""Physics checks, a plug-in: expected properties with sources, subjects, results, their file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator

from hesr_model.errors import RuleError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json
from hesr_model.units import unit_of_joint

MAX_JUMP = 0.1  # largest jump at a reversal, of the loop's height
MAX_RATE_CHANGE = 0.2  # largest change of a loop at a tenth of the speed, of its area
MAX_CLOSING_ERROR = 0.02  # largest closing error of an inner loop, of the outer height
MAX_INNER_HEIGHT = 0.95  # largest height of an inner loop with memory, of the outer one
MAX_START_ERROR = 0.05  # largest deviation of the first torque, of friction
MIN_BREAKAWAY_FALL = 0.01  # smallest relative fall of the break-away torque
MIN_LAG_WIDTH = 0.01  # smallest width of the lag loop, of the friction level
MIN_WEAKENING = 0.05  # smallest fall of the steady torque that causes stick-slip
MAX_DRIFT = 10e-6  # [rad] in a minute: half the noise of an encoder
MAX_CHATTER = 0.1  # largest chatter at rest, of the friction level
ENERGY_ROUND_OFF = 1e-6  # [J] round-off per cycle
MIN_USEFUL_STEP = 1e-3  # [s] smallest useful explicit step: the period of a servo


@dataclass(frozen=True)
class Expectation:
    """A property of friction: experiment and expectation."""

    key: str
    title: str
    short: str  # heading
    shows: str  # figure in tables
    unit: str
    factor: float  # from SI to this unit
    measured: str  # the experiment
    expected: str  # condition for a pass
    sources: tuple[str, ...]  # authors (year): title


_ELASTOPLASTIC = (
    "Dupont, Hayward, Armstrong, Altpeter (2002): Single state elastoplastic friction models"
)
_HYSTERESIS = "Mayergoyz (1986): Mathematical models of hysteresis"
_LUGRE = (
    "Canudas de Wit, Olsson, Åström, Lischinsky (1995): A new model for control of systems with "
    "friction"
)
_PASSIVE_LUGRE = (
    "Barabanov, Ortega (2000): Necessary and sufficient conditions for passivity of the LuGre "
    "friction model"
)


def _expectation(
    names: tuple[str, str, str],
    figure: tuple[str, str, float],
    measured: str,
    expected: str,
    *sources: str,
) -> Expectation:
    return Expectation(*names, *figure, measured, expected, sources)


_ALL_EXPECTATIONS = (
    _expectation(
        ("presliding", "Pre-sliding loop", "loop"),
        ("stiffness after a reversal", "kN.m/rad", 1e-3),
        "The joint moves back and forth by the deflection that reverses its friction, in 4 s and "
        "in 40 s, until the loop repeats.",
        f"A loop in position that dissipates energy, jumps by at most {MAX_JUMP:.0%} of its height "
        f"at a reversal, and dissipates the same within {MAX_RATE_CHANGE:.0%} at a tenth of the "
        "speed.",
        "Al-Bender, Lampaert, Swevers (2005): The generalized Maxwell-slip model: a novel model "
        "for friction simulation and compensation",
    ),
    _expectation(
        ("memory", "Reversal points and non-local memory", "memory"),
        ("miss of the closed inner loop", "%", 100.0),
        "On the rising branch of the slow loop the joint moves back by half the amplitude, returns "
        "to the reversal point and continues.",
        "The inner loop closes and the outer curve continues, both within "
        f"{MAX_CLOSING_ERROR:.0%} of its height. A single first-order state cannot remember the "
        "reversal.",
        _HYSTERESIS,
        "Swevers, Al-Bender, Ganseman, Prajogo (2000): An integrated friction model structure "
        "with improved presliding behavior for accurate friction compensation",
    ),
    _expectation(
        ("nested", "Non-local memory under load", "nested"),
        ("miss of the closed inner loops", "%", 100.0),
        "As above, with a second loop inside the inner one, at half the largest trained load; "
        "between two reversals the load rises to the full value and returns.",
        "A load that rises and returns erases no reversal: both loops close, and the outer curve "
        f"continues, within {MAX_CLOSING_ERROR:.0%} of its height.",
        "Mindlin, Deresiewicz (1953): Elastic spheres in contact under varying oblique forces",
        _HYSTERESIS,
    ),
    _expectation(
        ("breakaway", "Break-away torque against torque rate", "break"),
        ("fall of the break-away torque", "%", 100.0),
        "From rest the torque on a JointDrive reaches the friction level in 10, 3, 1 and 0.3 s; "
        "break-away is the largest friction until the joint slides at a twentieth of the trained "
        "speed.",
        "The joint holds until break-away, and the break-away torque falls with the rate, by at "
        f"least {MIN_BREAKAWAY_FALL:.0%} from the slowest to the fastest.",
        "Johannes, Green, Brockley (1973): The role of the rate of application of the tangential "
        "force in determining the static friction coefficient",
        "Richardson, Nolle (1976): Surface friction under time-dependent loads",
        _LUGRE,
    ),
    _expectation(
        ("start", "Start in motion", "start"),
        ("largest difference of the first torque", "%", 100.0),
        "The joint slides when its FMU is initialised, in both directions at 5 to 100 % of the "
        "trained speed; the first torque is compared with that of continued sliding.",
        f"The first torque is the steady one, within {MAX_START_ERROR:.0%} of the friction: "
        "simulations may start while sliding.",
        _LUGRE,
        "Otter, Elmqvist, Mattsson (1999): Hybrid modeling in Modelica based on the synchronous "
        "data flow principle",
    ),
    _expectation(
        ("lag", "Frictional lag", "lag"),
        ("distance of the branches, + if acceleration is above", "N.m", 1.0),
        "The joint slides in one direction at 1 to 11 % of the trained speed, varied with periods "
        "of 1 and 50 s.",
        f"Torque lags velocity: the branches are {MIN_LAG_WIDTH:.0%} of the friction level apart, "
        "the accelerating one above a falling and below a rising steady curve, and further apart "
        "the faster the speed changes.",
        "Hess, Soom (1990): Friction at a lubricated line contact operating at oscillating "
        "sliding velocities",
        _LUGRE,
    ),
    _expectation(
        ("stick_slip", "Stick-slip under a moving spring", "stick"),
        ("amplitude of the limit cycle", "mrad", 1e3),
        "A soft spring pulls a JointDrive at the speed where the steady curve falls most steeply, "
        "or at 1 % of the trained speed if it does not fall.",
        "A limit cycle of stick and slip if the law's own steady curve falls with speed by at "
        f"least {MIN_WEAKENING:.0%} of the level, and steady sliding otherwise.",
        "Rabinowicz (1958): The intrinsic variables affecting the stick-slip process",
        "Armstrong-Hélouvry, Dupont, Canudas de Wit (1994): A survey of models, analysis tools "
        "and compensation methods for the control of machines with friction",
    ),
    _expectation(
        ("dither", "Drift under a load with dither", "dither"),
        ("drift in a minute", "mrad", 1e3),
        "A JointDrive carries half its friction in the slowest sliding, at most half its level, "
        "and a dither of a fifth of it at 5 Hz, for 60 s.",
        f"Below break-away it drifts by less than {1e6 * MAX_DRIFT:.0f} urad. Laws that are "
        "plastic from the first deflection, such as LuGre and Dahl, drift.",
        _ELASTOPLASTIC,
    ),
    _expectation(
        ("hold", "Hold against gravity", "hold"),
        ("drift in a minute", "mrad", 1e3),
        "A JointDrive carries half its friction level for 60 s; it is also the load of the law.",
        f"It drifts by less than {1e6 * MAX_DRIFT:.0f} urad after the first second.",
        "Courtney-Pratt, Eisner (1957): The effect of a tangential force on the contact of "
        "metallic bodies",
        _ELASTOPLASTIC,
    ),
    _expectation(
        ("chatter", "Chatter at rest", "noise"),
        ("standard deviation of the torque", "N.m", 1.0),
        "The joint rests; its velocity is the difference of encoder readings with 20 urad of "
        "noise, at the law's own sample time.",
        f"Less than {MAX_CHATTER:.0%} of the friction level.",
        "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky (1998): Friction models and friction "
        "compensation",
    ),
    _expectation(
        ("work", "Work over closed cycles", "work"),
        ("most energy given in a cycle", "J", 1.0),
        "Sines of 0.05 to 2 Hz and of 1 to 100 % of the trained speed, at the law's own sample "
        "time and trained loads; also sines of 10 urad to 1 mrad with a load at twice their rate.",
        "None generates energy: friction is passive.",
        _PASSIVE_LUGRE,
    ),
    _expectation(
        ("drive", "Dissipation in a drive", "drive"),
        ("most energy given in a cycle", "J", 1.0),
        "A JointDrive on a spring is pushed back and forth at 1 Hz, by 2 %, 50 % and 200 % of "
        "the friction level, in inner steps of 4 ms; the load moves at twice the rate between 0 "
        "and the largest trained one. The work of friction is summed over the last four of ten "
        "cycles.",
        "Friction generates no energy: a sampled drive of passive parts is passive.",
        "Willems (1972): Dissipative dynamical systems, part I: general theory",
        _PASSIVE_LUGRE,
    ),
    _expectation(
        ("coupling", "Largest explicit coupling step", "step"),
        ("largest step without chatter", "ms", 1e3),
        "The Friction FMU is coupled explicitly to the joint's inertia, which slides to a stop "
        "from a tenth of the trained speed.",
        f"{1e3 * MIN_USEFUL_STEP:.0f} ms or more, a robot servo's period. Below, use a JointDrive, "
        "which solves for the speed.",
        "Marques, Flores, Pimenta Claro, Lankarani (2016): A survey and comparison of several "
        "friction force models for dynamic analysis of multibody mechanical systems",
    ),
)

FEED_FORWARD = ("start", "chatter", "work")
"""Checks that a law must pass to be fed forward: measured velocity in, torque to the motors."""

EXPECTATIONS = {expectation.key: expectation for expectation in _ALL_EXPECTATIONS}


FORMAT = "hesr-friction-properties-1"
PropertyVerdict = Literal["pass", "fail", "not applicable", "not run"]  # n/a: not a defect
MARKS = {"pass": "✓", "fail": "✗", "not applicable": "n/a", "not run": "–"}


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A model or FMU to examine."""

    name: str  # display name without a model
    model: FrictionModel | None  # None if unknown
    fmu: Path | None = None  # exported from the model by default
    inertia: tuple[float, ...] | None = None  # [kg.m2]


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A measured value with its SI unit, if known."""

    name: str
    value: float | None
    unit: str


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A line of a plot."""

    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A small plot with the names and units of its axes."""

    x: str
    y: str
    curves: tuple[Curve, ...]
    units: tuple[str, str] = ("", "")

    @property
    def labels(self) -> tuple[str, str]:
        """Names of the axes with their units."""
        x, y = (f" [{unit}]" if unit else "" for unit in self.units)
        return self.x + x, self.y + y


@dataclass(frozen=True, kw_only=True)
class PropertyResult:
    """Result of one experiment on one joint."""

    verdict: PropertyVerdict
    figures: tuple[Figure, ...] = ()  # tables show the first one
    reason: str = ""
    plot: Plot | None = None

    def to_joint_units(self, *, is_prismatic: bool) -> "PropertyResult":
        """Return the result in the units of its joint, from those of a revolute one."""
        figures = (
            replace(figure, unit=unit_of_joint(figure.unit, is_prismatic=is_prismatic))
            for figure in self.figures
        )
        plot = self.plot
        if plot:
            x, y = (unit_of_joint(unit, is_prismatic=is_prismatic) for unit in plot.units)
            plot = replace(plot, units=(x, y))
        return replace(self, figures=tuple(figures), plot=plot)


_LATER_PROPERTIES = ("nested", "start", "drive")  # than version 1
_NOT_RUN = PropertyResult(
    verdict="not run", reason="Not run: the file is older than this experiment."
)


def _complete_findings(findings: Mapping[str, PropertyResult]) -> Mapping[str, PropertyResult]:
    completed = dict.fromkeys(_LATER_PROPERTIES, _NOT_RUN) | dict(findings)
    missing = EXPECTATIONS.keys() - completed.keys()
    if missing:
        raise RuleError(f"'{min(missing)}' is missing", code="properties.missing", key=min(missing))
    return {key: completed[key] for key in EXPECTATIONS}


@dataclass(frozen=True, kw_only=True)
class JointProperties:
    """Results of one joint, and the scales of the experiments."""

    joint: str
    speed: float  # [rad/s] largest trained one or its substitute
    level: float  # [N.m] half difference of the steady torques at a tenth of the speed
    deflection: float  # [rad] in pre-sliding
    inertia: float | None  # [kg.m2]
    findings: Annotated[Mapping[str, PropertyResult], AfterValidator(_complete_findings)]


@dataclass(frozen=True, kw_only=True)
class Properties:
    """Results of a friction model."""

    law: str  # or name of the FMU
    robot: str  # or empty
    tau_load: float  # [N.m] of every joint
    joints: tuple[JointProperties, ...]

    @property
    def failed(self) -> dict[str, list[int]]:
        """Numbers from 1 of the joints that fail, by title of the check."""
        failures: dict[str, list[int]] = {}
        for key, expectation in EXPECTATIONS.items():
            for number, joint in enumerate(self.joints, start=1):
                if joint.findings[key].verdict == "fail":
                    failures.setdefault(expectation.title, []).append(number)
        return failures

    @property
    def passed(self) -> int:
        """Number of properties that the law has on all joints."""
        count = 0
        for key in EXPECTATIONS:
            verdicts = {joint.findings[key].verdict for joint in self.joints}
            if verdicts <= {"pass", "not applicable"}:
                count += 1
        return count


def combine_results(
    name: str, properties_by_law: Mapping[str, Properties], laws: Sequence[str]
) -> Properties | None:
    """Return the results of a model that has the law `laws[k]` on joint k; None if unknown."""
    if not all(law_name in properties_by_law for law_name in laws):
        return None
    joint_properties = tuple(
        properties_by_law[law_name].joints[j] for j, law_name in enumerate(laws)
    )
    return replace(properties_by_law[laws[0]], law=name, joints=joint_properties)


@dataclass(frozen=True, kw_only=True)
class _PropertiesFile:
    IRRELEVANT_KEYS: ClassVar[Mapping[str, str]] = {
        "expectations": "for readers of the file; those of this version count"
    }
    laws: Mapping[str, Properties]


def write_properties(path: Path, properties_by_law: Mapping[str, Properties]) -> None:
    """Write the results of several laws by name, together with the expectations."""
    expectations = {key: to_json(expectation) for key, expectation in EXPECTATIONS.items()}
    laws = {name: to_json(properties) for name, properties in properties_by_law.items()}
    write_json(path, {"format": FORMAT, "expectations": expectations, "laws": laws})


def read_properties(path: Path) -> dict[str, Properties]:
    """Read a file of `write_properties`."""
    file = from_json(
        _PropertiesFile, read_json(path, FORMAT), path, "findings of the physics checks"
    )
    return dict(file.laws)
