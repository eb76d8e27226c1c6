"""Expected properties of friction: experiments, limits and sources. No law needs all of them."""

from dataclasses import dataclass

SMOOTH = 0.1  # largest jump at a reversal, of the loop's height
RATE = 0.2  # largest change of a loop at a tenth of the speed, of its area
CLOSED = 0.02  # largest closing error of an inner loop, of the outer height
INNER = 0.95  # largest height of an inner loop with memory, of the outer one
BEGINS = 0.05  # largest deviation of the first torque, of friction
FALLS = 0.01  # smallest relative fall of the break-away torque
WIDTH = 0.01  # smallest width of the lag loop, of the friction level
WEAKENING = 0.05  # smallest fall of the steady torque that causes stick-slip
HELD = 10e-6  # [rad] in a minute: half the noise of an encoder
QUIET = 0.1  # largest chatter at rest, of the friction level
PASSIVE = 1e-6  # [J] round-off per cycle
STEP = 1e-3  # [s] smallest useful explicit step: the period of a servo


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


_ALL = (
    _expectation(
        ("presliding", "Pre-sliding loop", "loop"),
        ("stiffness after a reversal", "kN.m/rad", 1e-3),
        "The joint moves back and forth by the deflection that reverses its friction, in 4 s and "
        "in 40 s, until the loop repeats.",
        f"A loop in position that dissipates energy, jumps by at most {SMOOTH:.0%} of its height "
        f"at a reversal, and dissipates the same within {RATE:.0%} at a tenth of the speed.",
        "Al-Bender, Lampaert, Swevers (2005): The generalized Maxwell-slip model: a novel model "
        "for friction simulation and compensation",
    ),
    _expectation(
        ("memory", "Reversal points and non-local memory", "memory"),
        ("miss of the closed inner loop", "%", 100.0),
        "On the rising branch of the slow loop the joint moves back by half the amplitude, returns "
        "to the reversal point and continues.",
        f"The inner loop closes and the outer curve continues, both within {CLOSED:.0%} of its "
        "height. A single first-order state cannot remember the reversal.",
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
        f"continues, within {CLOSED:.0%} of its height.",
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
        f"least {FALLS:.0%} from the slowest to the fastest.",
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
        f"The first torque is the steady one, within {BEGINS:.0%} of the friction: simulations may "
        "start while sliding.",
        _LUGRE,
        "Otter, Elmqvist, Mattsson (1999): Hybrid modeling in Modelica based on the synchronous "
        "data flow principle",
    ),
    _expectation(
        ("lag", "Frictional lag", "lag"),
        ("distance of the branches, + if acceleration is above", "N.m", 1.0),
        "The joint slides in one direction at 1 to 11 % of the trained speed, varied with periods "
        "of 1 and 50 s.",
        f"Torque lags velocity: the branches are {WIDTH:.0%} of the friction level apart, the "
        "accelerating one above a falling and below a rising steady curve, and further apart the "
        "faster the speed changes.",
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
        f"least {WEAKENING:.0%} of the level, and steady sliding otherwise.",
        "Rabinowicz (1958): The intrinsic variables affecting the stick-slip process",
        "Armstrong-Hélouvry, Dupont, Canudas de Wit (1994): A survey of models, analysis tools "
        "and compensation methods for the control of machines with friction",
    ),
    _expectation(
        ("dither", "Drift under a load with dither", "dither"),
        ("drift in a minute", "mrad", 1e3),
        "A JointDrive carries half its friction in the slowest sliding, at most half its level, "
        "and a dither of a fifth of it at 5 Hz, for 60 s.",
        f"Below break-away it drifts by less than {1e6 * HELD:.0f} urad. Laws that are plastic "
        "from the first deflection, such as LuGre and Dahl, drift.",
        _ELASTOPLASTIC,
    ),
    _expectation(
        ("hold", "Hold against gravity", "hold"),
        ("drift in a minute", "mrad", 1e3),
        "A JointDrive carries half its friction level for 60 s; it is also the load of the law.",
        f"It drifts by less than {1e6 * HELD:.0f} urad after the first second.",
        "Courtney-Pratt, Eisner (1957): The effect of a tangential force on the contact of "
        "metallic bodies",
        _ELASTOPLASTIC,
    ),
    _expectation(
        ("chatter", "Chatter at rest", "noise"),
        ("standard deviation of the torque", "N.m", 1.0),
        "The joint rests; its velocity is the difference of encoder readings with 20 urad of "
        "noise, at the law's own sample time.",
        f"Less than {QUIET:.0%} of the friction level.",
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
        f"{1e3 * STEP:.0f} ms or more, a robot servo's period. Below, use a JointDrive, which "
        "solves for the speed.",
        "Marques, Flores, Pimenta Claro, Lankarani (2016): A survey and comparison of several "
        "friction force models for dynamic analysis of multibody mechanical systems",
    ),
)

EXPECTATIONS = {expectation.key: expectation for expectation in _ALL}
