"""Expected properties of friction: experiments, limits and sources. No law needs all of them."""

from dataclasses import dataclass

SMOOTH = 0.1  # largest jump at a reversal, relative to the height of the loop
RATE = 0.2  # largest change of a loop at a tenth of the speed, relative to its area
CLOSED = 0.02  # largest closing error of an inner loop, relative to the height of the outer one
INNER = 0.95  # largest height of an inner loop with memory, relative to the outer one
BEGINS = 0.05  # largest deviation of the first torque from the steady one, relative to friction
FALLS = 0.01  # smallest relative fall of the break-away torque from slowest to fastest ramp
WIDTH = 0.01  # smallest width of the loop of frictional lag, relative to the friction level
WEAKENING = 0.05  # smallest relative fall of the steady torque with speed that causes stick-slip
HELD = 10e-6  # [rad] largest drift within a minute: half the noise of an encoder
QUIET = 0.1  # largest chatter at rest, relative to the friction level
PASSIVE = 1e-6  # [J] round-off of the energy per closed cycle
STEP = 1e-3  # [s] smallest useful step of explicit coupling: the period of a robot's servo


@dataclass(frozen=True, kw_only=True)
class Source:
    """Source of an expectation."""

    who: str
    year: int
    title: str


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """A property of friction: experiment and expectation."""

    key: str
    title: str
    short: str  # heading of its column
    shows: str  # name of the figure in tables
    unit: str  # of the figure
    factor: float = 1.0  # from the SI value to this unit
    measured: str  # the experiment
    expected: str  # condition for a pass
    sources: tuple[Source, ...]


def _by(who: str, year: int, title: str) -> Source:
    return Source(who=who, year=year, title=title)


_SURVEY = _by(
    "Armstrong-Hélouvry, Dupont, Canudas de Wit",
    1994,
    "A survey of models, analysis tools and compensation methods for the control of machines with "
    "friction",
)
_LUGRE = _by(
    "Canudas de Wit, Olsson, Åström, Lischinsky",
    1995,
    "A new model for control of systems with friction",
)
_ELASTOPLASTIC = _by(
    "Dupont, Hayward, Armstrong, Altpeter", 2002, "Single state elastoplastic friction models"
)

_PASSIVE_LUGRE = _by(
    "Barabanov, Ortega",
    2000,
    "Necessary and sufficient conditions for passivity of the LuGre friction model",
)

_ALL = (
    Expectation(
        key="presliding",
        title="Pre-sliding loop",
        short="loop",
        shows="stiffness after a reversal",
        unit="kN.m/rad",
        factor=1e-3,
        measured="The joint is moved to and fro by the deflection over which its friction turns "
        "around, in 4 s and in 40 s, until the loop repeats.",
        expected=f"A loop in position: it takes energy, jumps by at most {SMOOTH:.0%} of its "
        f"height at a reversal, and takes the same within {RATE:.0%} at a tenth of the speed.",
        sources=(
            _by(
                "Al-Bender, Lampaert, Swevers",
                2005,
                "The generalized Maxwell-slip model: a novel model for friction simulation and "
                "compensation",
            ),
        ),
    ),
    Expectation(
        key="memory",
        title="Reversal points and non-local memory",
        short="memory",
        shows="miss of the closed inner loop",
        unit="%",
        factor=100.0,
        measured="On the rising branch of the slow loop the joint turns back by half the "
        "amplitude, returns to where it turned and goes on.",
        expected=f"The inner loop closes where it began, and the outer curve goes on as if nothing "
        f"had been, both within {CLOSED:.0%} of its height. A single first-order state cannot do "
        "that: it remembers where it is, not where it turned.",
        sources=(
            _by("Mayergoyz", 1986, "Mathematical models of hysteresis"),
            _by(
                "Swevers, Al-Bender, Ganseman, Prajogo",
                2000,
                "An integrated friction model structure with improved presliding behavior for "
                "accurate friction compensation",
            ),
        ),
    ),
    Expectation(
        key="nested",
        title="Non-local memory under load",
        short="nested",
        shows="miss of the closed inner loops",
        unit="%",
        factor=100.0,
        measured="As before, with a loop inside the inner one, at half the largest trained load; "
        "on each way between two turns the load rises to the whole and returns.",
        expected="A load that rises and returns erases no reversal: both loops close, and the "
        f"outer curve goes on, within {CLOSED:.0%} of its height.",
        sources=(
            _by(
                "Mindlin, Deresiewicz",
                1953,
                "Elastic spheres in contact under varying oblique forces",
            ),
            _by("Mayergoyz", 1986, "Mathematical models of hysteresis"),
        ),
    ),
    Expectation(
        key="breakaway",
        title="Break-away torque against torque rate",
        short="break",
        shows="fall of the break-away torque",
        unit="%",
        factor=100.0,
        measured="From rest the torque on a JointDrive is raised at rates that reach the friction "
        "level in 10, 3, 1 and 0.3 s; break-away is the largest friction until the joint slides at "
        "a twentieth of the trained speed.",
        expected="The joint holds before, and the torque that breaks it away falls with the rate, "
        f"by {FALLS:.0%} at least from the slowest to the fastest.",
        sources=(
            _by(
                "Johannes, Green, Brockley",
                1973,
                "The role of the rate of application of the tangential force in determining the "
                "static friction coefficient",
            ),
            _by("Richardson, Nolle", 1976, "Surface friction under time-dependent loads"),
            _LUGRE,
        ),
    ),
    Expectation(
        key="start",
        title="Start in motion",
        short="start",
        shows="largest difference of the first torque",
        unit="%",
        factor=100.0,
        measured="The joint slides already when its FMU is initialised, both ways at 5 to 100 % of "
        "the trained speed; the first torque is compared with that of sliding on.",
        expected=f"The first torque is the steady one, within {BEGINS:.0%} of the friction: a "
        "simulation may begin in any mode, and what slides is in its steady state.",
        sources=(
            _LUGRE,
            _by(
                "Otter, Elmqvist, Mattsson",
                1999,
                "Hybrid modeling in Modelica based on the synchronous data flow principle",
            ),
        ),
    ),
    Expectation(
        key="lag",
        title="Frictional lag",
        short="lag",
        shows="distance of the branches, + if acceleration is above",
        unit="N.m",
        measured="The joint slides one way at 1 to 11 % of the trained speed, to and fro in speed "
        "once a second and once in fifty.",
        expected=f"Torque lags velocity: the branches are {WIDTH:.0%} of the friction level apart, "
        "the accelerating one above where the steady curve falls and below where it rises, and "
        "further apart the faster the speed changes.",
        sources=(
            _by(
                "Hess, Soom",
                1990,
                "Friction at a lubricated line contact operating at oscillating sliding velocities",
            ),
            _LUGRE,
        ),
    ),
    Expectation(
        key="stick_slip",
        title="Stick-slip under a moving spring",
        short="stick",
        shows="amplitude of the limit cycle",
        unit="mrad",
        factor=1e3,
        measured="A JointDrive is pulled by a soft spring whose far end moves at the speed where "
        "the steady curve falls most steeply, at 1 % of the trained speed where it does not fall.",
        expected="As the law's own steady curve says: a limit cycle of stick and slip where that "
        f"falls with speed, by {WEAKENING:.0%} of the level or more, and steady sliding where it "
        "does not.",
        sources=(
            _by("Rabinowicz", 1958, "The intrinsic variables affecting the stick-slip process"),
            _SURVEY,
        ),
    ),
    Expectation(
        key="dither",
        title="Drift under a load with dither",
        short="dither",
        shows="drift in a minute",
        unit="mrad",
        factor=1e3,
        measured="A JointDrive bears half of what its friction bears in the slowest sliding, its "
        "level at most, and on top of it a fifth to and fro at 5 Hz, for 60 s.",
        expected=f"Below break-away it stays: less than {1e6 * HELD:.0f} urad. Laws that are "
        "plastic from the first deflection on, as LuGre and Dahl, walk.",
        sources=(_ELASTOPLASTIC,),
    ),
    Expectation(
        key="hold",
        title="Hold against gravity",
        short="hold",
        shows="drift in a minute",
        unit="mrad",
        factor=1e3,
        measured="A JointDrive bears half its friction level for 60 s; laws that use the load get "
        "it as theirs.",
        expected=f"It stays: less than {1e6 * HELD:.0f} urad after the first second.",
        sources=(
            _by(
                "Courtney-Pratt, Eisner",
                1957,
                "The effect of a tangential force on the contact of metallic bodies",
            ),
            _ELASTOPLASTIC,
        ),
    ),
    Expectation(
        key="chatter",
        title="Chatter at rest",
        short="noise",
        shows="standard deviation of the torque",
        unit="N.m",
        measured="The joint rests; its velocity is the difference of an encoder's readings with "
        "20 urad of noise, at the law's own sample time.",
        expected=f"Less than {QUIET:.0%} of the friction level.",
        sources=(
            _by(
                "Olsson, Åström, Canudas de Wit, Gäfvert, Lischinsky",
                1998,
                "Friction models and friction compensation",
            ),
        ),
    ),
    Expectation(
        key="work",
        title="Work over closed cycles",
        short="work",
        shows="most energy given in a cycle",
        unit="J",
        measured="Sines of 0.05 to 2 Hz and of 1 to 100 % of the trained speed, at the law's own "
        "sample time and, where it uses it, at the trained loads; also sines of 10 urad to 1 mrad "
        "while the load moves at twice their rate.",
        expected="None gives energy: friction is passive.",
        sources=(_PASSIVE_LUGRE,),
    ),
    Expectation(
        key="drive",
        title="Dissipation in a drive",
        short="drive",
        shows="most energy given in a cycle",
        unit="J",
        measured="A JointDrive held by a spring is pushed to and fro once a second, by 2 %, 50 % "
        "and 200 % of the friction level, in inner steps of 4 ms; where the law uses the load, "
        "that moves at twice the rate between 0 and the largest trained one. The work of friction "
        "is summed up over the last four of ten cycles.",
        expected="Friction gives no energy to what moves it: a drive of passive parts is passive, "
        "sampled as it is.",
        sources=(
            _by("Willems", 1972, "Dissipative dynamical systems, part I: general theory"),
            _PASSIVE_LUGRE,
        ),
    ),
    Expectation(
        key="coupling",
        title="Largest explicit coupling step",
        short="step",
        shows="largest step without chatter",
        unit="ms",
        factor=1e3,
        measured="The Friction FMU is coupled explicitly to the joint's inertia, which slides to a "
        "stop from a tenth of the trained speed.",
        expected=f"{1e3 * STEP:.0f} ms or more, a robot servo's period. Below, use a JointDrive, "
        "which solves for the speed.",
        sources=(
            _by(
                "Marques, Flores, Pimenta Claro, Lankarani",
                2016,
                "A survey and comparison of several friction force models for dynamic analysis of "
                "multibody mechanical systems",
            ),
        ),
    ),
)

EXPECTATIONS = {expectation.key: expectation for expectation in _ALL}  # in the order of tables
