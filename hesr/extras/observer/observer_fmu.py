"""Observer FMU: motion and motor torque in; external torque, 95 % limits and threshold out."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import astuple, dataclass, fields, replace
from pathlib import Path

import numpy as np
import sympy

from fmu_src.blocks.block import vector
from fmu_src.equations.c_printer import function
from fmu_src.equations.header import SOLVER, Joint, equations_header
from fmu_src.export import package
from fmu_src.export.interface import ArrayVariable, Interface, Variable, literal
from fmu_src.friction import friction_component
from fmu_src.friction.embedded_model import embed_model
from fmu_src.friction.friction_fmu import describe_fmu
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.block_page import variable_groups
from fmu_src.pages.friction_page import holding_torque, law_entries, model_title, title
from fmu_src.pages.html import TEMPLATES, render_template
from fmu_src.plant.dynamics import dynamics_header, jacobian_header
from fmu_src.plant.plant_fmu import PlantBody, adapt_to_joint, inertial_parameters, require_fitting
from fmu_src.run.reference_results import Stimuli, waves
from hesr_model.equations.functions import larger
from hesr_model.errors import ArgumentError, ExportError
from hesr_model.friction.band import (
    LEVEL,
    NUMBERS,
    REST,
    REST_SPEED,
    SLOW_SPEED,
    VARIANCE,
    variance_steps,
)
from hesr_model.friction.inputs import DQ, TAU_LOAD, TORQUE
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.thermal import (
    TEMPERATURE,
    Thermal,
    friction_factors,
    thermal_parameters,
    thermal_symbol,
)
from hesr_model.robots.robot import Robot

HOUR = 3600.0  # time in which one false alarm is allowed [s]
NAMES = NUMBERS[:6]


@dataclass(frozen=True, kw_only=True)
class ObserverLimits:
    """Limits of the external torque, from a calibration or from a law's bands."""

    numbers: tuple[tuple[float, ...], ...]  # of the half-widths (6, n), in the order of `NAMES`
    factor: float  # threshold over half-width
    duration: float = 0.0  # of the calibration [s]; 0 for a law's bands
    logs: Sequence[str] = ()

    @property
    def text(self) -> str:
        """Statement on the origin of the limits."""
        if self.logs:
            return (
                f"Limits contain {100 * LEVEL:g} % of the errors in {self.duration / 60.0:.1f} min "
                "of free motion; the stated rate of false alarms is 1 per hour, from their maxima."
            )
        return "Limits are those of the bands of the law; the rate of false alarms is unknown."


def law_limits(model: FrictionModel) -> ObserverLimits:
    """Return the limits that follow from the bands of a law; ArgumentError if it has none."""
    half_width_numbers = []
    factors = []
    sample_count = HOUR / model.sample_time * len(model.laws)
    for law in model.laws:
        if model.coupling:
            raise ArgumentError(
                f"friction model '{model.law}': its bands are those of coupled motors, not of "
                "joints; give 'calibration'."
            )
        if law.band is None:
            raise ArgumentError(f"friction model '{model.law}' has no band; give 'calibration'.")
        band_numbers = list(astuple(law.band)[: len(NAMES)])
        if law.band.envelope:  # without measured rests friction is anywhere between both directions
            band_numbers[3] = max(band_numbers[3], 2.0 * holding_torque(law))
        half_width_numbers.append(band_numbers)
        factors.append((-np.log(sample_count) / np.log(1.0 - LEVEL)) ** law.band.tail)
    return ObserverLimits(
        numbers=tuple(zip(*half_width_numbers, strict=True)), factor=float(max(factors))
    )


_MIN_SPEED = 1e-9  # [rad/s] divisor that a host may set to 0
_THERMAL_COUNT = 5  # parameters of a thermal model with measured temperatures, the leading ones
BANDWIDTH = 15.0  # default cut-off of the observer [Hz]
HERE = Path(__file__).parent
_INPUTS = (
    ("q", "rad", "position"),
    ("dq", "rad/s", "speed"),
    ("tau_motor", "N.m", "torque of the motor on the joint"),
)
_OUTPUTS = (
    ("tau_ext", "N.m", "external torque, positive if it drives towards positive positions"),
    ("tau_ext_lower", "N.m", "lower limit of the external torque at 95 %"),
    ("tau_ext_upper", "N.m", "upper limit of the external torque at 95 %"),
    ("contact_threshold", "N.m", "absolute external torque that counts as contact"),
    ("tau_friction", "N.m", "friction torque of the law"),
    (TAU_LOAD.name, "N.m", "torque that the rigid bodies need"),
)
_WRENCH = (
    ("force", "N", (3,), "external force on the flange, in axes of the base"),
    ("moment", "N.m", (3,), "external moment about the origin of the last joint, in base axes"),
    ("force_covariance", "N2", (3, 3), "covariance of the force"),
    ("moment_covariance", "N2.m2", (3, 3), "covariance of the moment"),
    ("force_moment_covariance", "N2.m", (3, 3), "covariance of force (row) and moment (column)"),
)


def has_wrench(robot: Robot) -> bool:
    """Whether a robot is a chain whose joints can show all of force and moment."""
    parents = [joint.parent for joint in robot.tree]
    return robot.n >= 6 and parents == list(range(-1, robot.n - 1))


def _build_parameters(
    model: FrictionModel,
    limits: ObserverLimits,
    bandwidth: float,
    constants: Sequence[float] | None,
) -> Iterator[Variable]:
    """Yield the tunable parameters of the observer itself."""
    text = "cut-off of the observer; limits and threshold hold for its start value"
    bandwidth_variable = Variable("bandwidth", "tunable", text, unit="1/s", start=bandwidth)
    yield replace(bandwidth_variable, least=1e-3, limited=True)
    text = "contact threshold over the half-width of the limits"
    yield Variable("contact_factor", "tunable", text, unit="1", start=limits.factor, least=0.0)
    text = "factor on tau_motor"
    unit = "1"
    torque_constants = constants or np.ones(len(model.joints))
    if constants:
        text = "torque per current"
        unit = "N.m/A"
    yield from vector("torque_constant", "tunable", unit, text, torque_constants)
    for quantity, values in zip(NAMES, limits.numbers, strict=True):
        for number, value in enumerate(values, start=1):
            yield friction_component.build_joint_variable(
                model, quantity, number, "tunable", start=value, least=0.0
            )
    joint_quantities = [thermal_parameters(thermal)[:_THERMAL_COUNT] for thermal in model.thermal]
    for thermal_quantities in zip(*joint_quantities, strict=True):
        for number, thermal_quantity in enumerate(thermal_quantities, start=1):
            yield friction_component.build_joint_variable(
                model, thermal_quantity, number, "tunable", start=thermal_quantity.start
            )


def _build_inputs(model: FrictionModel, *, are_currents: bool) -> list[Variable]:
    """Return position, speed and motor torque or current of all joints, and temperatures."""
    motor = _INPUTS[2]
    if are_currents:
        motor = ("tau_motor", "A", "current of the motor")
    zeros = (0.0,) * len(model.laws)
    inputs: list[Variable] = []
    for name, unit, text in (*_INPUTS[:2], motor):
        inputs += vector(name, "input", unit, text, zeros)
    for number, thermal in enumerate(model.thermal, start=1):
        temperature = friction_component.build_joint_variable(model, TEMPERATURE, number, "input")
        inputs.append(replace(temperature, start=thermal.reference))
    return inputs


def _build_law_variables(model: FrictionModel, joints: Sequence[Joint]) -> list[Variable]:
    """Return states and parameters of the laws of all joints."""
    law_variables: list[Variable] = []
    for number, (law, joint) in enumerate(zip(model.laws, joints, strict=True), start=1):
        law_inputs = {}
        for name in ("dq", "q"):
            law_inputs[name] = friction_component.find_joint_signals(name, number, model.coupling)
        law_inputs[TAU_LOAD.name] = ()  # computed by the observer
        law_variables += friction_component.law_variables(law, number, joint, law_inputs)
    return law_variables


def _build_outputs(
    plant_body: PlantBody, count: int, dependencies: tuple[str, ...]
) -> list[Variable]:
    """Return the torques of `count` joints, the contact, and the wrench if the arm shows it."""
    outputs: list[Variable] = []
    for name, unit, text in _OUTPUTS:
        outputs += vector(name, "output", unit, text, (0.0,) * count, dependencies)
    text = "whether the external torque of a joint is beyond its threshold"
    outputs.append(Variable("contact", "output", text, boolean=True, dependencies=dependencies))
    if has_wrench(plant_body.robot):
        for name, unit, shape, text in _WRENCH:
            outputs += _build_elements(name, unit, shape, text, dependencies)
    return outputs


def _build_elements(
    name: str, unit: str, shape: tuple[int, ...], text: str, dependencies: tuple[str, ...]
) -> Iterator[Variable]:
    """Yield the elements of an output array, row by row."""
    for element in np.ndindex(*shape):
        index = ",".join(str(k + 1) for k in element)
        yield Variable(f"{name}[{index}]", "output", text, unit=unit, dependencies=dependencies)


def _build_interface(
    model: FrictionModel,
    plant_body: PlantBody,
    observer_parameters: Sequence[Variable],
    *,
    are_currents: bool,
) -> Interface:
    """Return the variables of the observer: inputs, outputs, parameters and states."""
    joints = friction_component.build_joints(model, names={TORQUE: "tau_friction"})
    inputs = _build_inputs(model, are_currents=are_currents)
    parameters = [
        *observer_parameters,
        *inertial_parameters(plant_body),
        *friction_component.scales(model),
    ]
    law_variables = _build_law_variables(model, joints)
    # Each output depends on all joints: the rigid body couples them.
    input_names = tuple(variable.name for variable in inputs)
    parameter_names = tuple(variable.name for variable in parameters)
    states = tuple(variable.name for variable in law_variables if not variable.derivative_of)
    dependencies = (*input_names, *parameter_names, *states)
    variables = [
        *inputs,
        *_build_outputs(plant_body, len(joints), dependencies),
        *parameters,
        friction_component.discretisation(model, "how the states of friction are relaxed"),
        friction_component.start_mode(),
        *law_variables,
    ]
    initial_variables = []
    for variable in variables:
        joint_variable = adapt_to_joint(variable, model.slides)
        initial_variables.append(
            friction_component.make_inputs_initial(joint_variable, input_names)
        )
    return Interface(
        variables=tuple(initial_variables),
        own=1 + len(joints) * (len(joints) + 4) + 10 * plant_body.robot.links,
        model_exchange=False,
        directional_derivatives=False,
    )


def list_outputs(interface: Interface) -> list[ArrayVariable]:
    """Return the outputs other than the contact."""
    return [
        array
        for array in interface.arrays
        if array.elements[0].role == "output" and array.name != "contact"
    ]


def _place_symbols(symbols: Iterable[sympy.Symbol]) -> dict[sympy.Symbol, tuple[str, str]]:
    """Return names and C expressions of variables of joint i."""
    return {symbol: (symbol.name, f"v[{symbol.name.upper()} + i]") for symbol in symbols}


def band_header() -> str:
    """Return band.h, with the square of the half-width at 95 % of a torque."""
    steps = variance_steps(larger(SLOW_SPEED, _MIN_SPEED))
    places = _place_symbols([DQ, TAU_LOAD, *(number.symbol for number in NAMES)])
    places[REST_SPEED] = (REST_SPEED.name, literal(REST))
    text = function(
        "find_half_squared(IN(v), int i, OUT(half_squared))",
        steps,
        {"*half_squared": VARIANCE},
        places,
    )
    return _compose_header("BAND", "Square of the half-width at 95 % of a torque of joint i.", text)


def warmth_header() -> str:
    """Return warmth.h, with the factors on Coulomb and viscous friction at a temperature."""
    over, coulomb, viscous = sympy.symbols("over coulomb_factor viscous_factor", real=True)
    reference = thermal_symbol("reference")
    scales = [thermal_symbol(f"{kind}_scale") for kind in ("coulomb", "viscous")]
    factors = friction_factors(over, *scales)
    steps = {over: TEMPERATURE.symbol - reference, coulomb: factors[0], viscous: factors[1]}
    inputs = sympy.Tuple(*steps.values()).free_symbols - {over}
    text = function(
        "find_warmth(IN(v), int i, OUT(factors))",
        steps,
        {"factors[0]": coulomb, "factors[1]": viscous},
        _place_symbols(sorted(inputs, key=str)),
        library=True,
    )
    return _compose_header("WARMTH", "Factors on Coulomb and viscous friction of joint i.", text)


def _compose_header(name: str, purpose: str, text: str) -> str:
    return (
        f"/* Generated. */\n#ifndef {name}_H\n#define {name}_H\n\n/* {purpose} */\n{text}\n#endif\n"
    )


def content(
    model: FrictionModel,
    plant_body: PlantBody,
    limits: ObserverLimits,
    *,
    bandwidth: float = BANDWIDTH,
    constants: Sequence[float] | None = None,
    bare: bool = False,
) -> package.Content:
    """Return the FMU of an observer before compilation; with `constants` [N.m/A] for currents."""
    require_exportable(model, "an observer", thermal=True)
    if not all(thermal.measured for thermal in model.thermal):
        raise ExportError(
            f"law '{model.law}' takes the temperature from the heat of friction, which an observer "
            "does not support; fit it to logs with temperatures."
        )
    require_fitting(model, plant_body.robot)
    if not 0.0 < bandwidth < np.inf:
        raise ExportError(f"observer: 'bandwidth' is {bandwidth:g} Hz; it must be positive.")
    observer_parameters = list(_build_parameters(model, limits, bandwidth, constants))
    interface = _build_interface(
        model, plant_body, observer_parameters, are_currents=bool(constants)
    )
    sources = _write_sources(model, plant_body, interface)
    about = describe_fmu(
        model,
        name=f"Observer of {plant_body.robot.name} with {model_title(model)}",
        identifier=f"observer_{model.law}",
        text=(
            f"External torque of {len(model.laws)} joints from their motion and motors. "
            f"{limits.text}"
        ),
        step_size=model.sample_time,
    )
    if bare:
        return package.Content(table=interface, about=about, sources=sources, members={})
    joints, refusal = law_entries(model)
    page = render_template(
        "observer.html.j2",
        folders=(HERE / "templates", TEMPLATES),
        about=about,
        model=model,
        titles=list(dict.fromkeys(map(title, model.laws))),
        joints=joints,
        limits=limits,
        refused=refusal,
        bandwidth=bandwidth,
        constants=constants,
        names=[number.name for number in NAMES],
        wrench=has_wrench(plant_body.robot),
        groups=variable_groups(interface),
    )
    inputs = [variable.name for variable in interface.variables if variable.role == "input"]
    return package.Content(
        table=interface,
        about=about,
        sources=sources,
        members={"documentation/index.html": page.encode(), **embed_model(model)},
        stimuli=Stimuli(step=model.sample_time, inputs=waves(dict.fromkeys(inputs, 1.0))),
    )


def _write_sources(
    model: FrictionModel, plant_body: PlantBody, interface: Interface
) -> dict[str, str]:
    """Return the C files of the observer by name."""
    joints = friction_component.build_joints(model, names={TORQUE: "tau_friction"})
    sources = {}
    for name in ("coupling.h", "law_math.h", "regroup.h"):
        sources[name] = package.read_c_source(name)
    sources["observer.c"] = (HERE / "observer.c").read_text(encoding="utf-8")
    sources["dynamics.h"] = dynamics_header(plant_body.robot, of_joints=True)
    sources["jacobian.h"] = jacobian_header(plant_body.robot)
    sources["band.h"] = band_header()
    sources["warmth.h"] = warmth_header()
    sources["equations.h"] = equations_header(
        joints, interface, _place_macros(interface), calls=SOLVER, coupling=model.coupling
    )
    return sources


def _place_macros(interface: Interface) -> dict[str, str]:
    """Return the first variable of each array by the macro that stands for its place in C."""
    thermal_fields = fields(Thermal)[:_THERMAL_COUNT]
    optional_names = [name for name, *_ in _WRENCH]
    optional_names.append(TEMPERATURE.name)
    optional_names += [f"thermal_{thermal_field.name}" for thermal_field in thermal_fields]
    # An observer without these still has to compile.
    macros = {name.upper(): "contact" for name in optional_names}
    for array in interface.arrays:
        first = array.elements[0]
        if array.name.isidentifier() and first.role != "state":
            macros[array.name.upper()] = first.name
    macros["PARAMETERS"] = "link[1].m"
    macros["ROTORS"] = "rotor[1]"
    macros["PAYLOAD_M"] = "payload.m"
    macros["PAYLOAD_COM"] = "payload.com[1]"
    macros["PAYLOAD_INERTIA"] = "payload.Ixx"
    springs = [name for name in interface.places if name.startswith("spring[")]
    macros["SPRINGS"] = next(iter(springs), "gravity[1]")
    return macros
