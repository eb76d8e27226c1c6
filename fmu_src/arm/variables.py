"""The FMI variables of a model, common to all its FMUs."""

from collections.abc import Iterator

from fmu_src.arm.parts import ArmOutput, ArmSignals
from fmu_src.export.interface import Variable

SCALE, PAYLOAD, LATENCY, SEED = "friction_scale", "payload", "latency", "noise_seed"


def variables(signals: ArmSignals) -> tuple[Variable, ...]:
    """Return inputs, outputs and the parameters that apply to the model."""
    parameters = tuple(_parameters(signals))
    return (*_connectors(signals, tuple(p.name for p in parameters)), *parameters)


def noise_name(output: ArmOutput) -> str:
    """Return the name of an output's noise level, such as `q_noise[1]` for `q[1]`."""
    stem, bracket, index = output.name.partition("[")
    return f"{stem}_noise{bracket}{index}"


def _connectors(signals: ArmSignals, parameters: tuple[str, ...]) -> Iterator[Variable]:
    for one in signals.inputs:
        yield Variable(name=one.name, role="input", unit=one.unit, description="control")
    for output in signals.outputs:
        yield Variable(
            name=output.name,
            role="output",
            unit=output.unit,
            description="sum of sensors",
            dependencies=parameters,
        )


def _parameters(signals: ArmSignals) -> Iterator[Variable]:
    scaled = any(scaled for o in signals.outputs for _, _, scaled in o.reads)
    if signals.friction or signals.losses or scaled:
        yield _fixed(
            SCALE, "1", 1.0, "factor on the friction of the elements that are named for it"
        )
    if signals.payload is not None:
        yield _fixed(PAYLOAD, "kg", 0.0, "mass of a payload")
    if signals.delay is not None:
        yield _fixed(
            LATENCY,
            "s",
            signals.delay.usual,
            "time until a command acts, in whole steps of the simulation",
        )
    noisy = [output for output in signals.outputs if output.noise is not None]
    halves = (signals.seed & 0xFFFFFFFF, signals.seed >> 32) if noisy else ()
    for k, half in enumerate(halves, start=1):
        end = "low" if k == 1 else "high"
        yield _fixed(f"{SEED}[{k}]", "1", float(half), f"{end} 32 bits of the noise's seed")
    for start in signals.starts:
        yield _fixed(start.name, start.unit, start.value, "position at the start")
    for output in noisy:
        text = f"standard deviation of the noise of {output.name}"
        yield _fixed(noise_name(output), output.unit, output.noise or 0.0, text)


def _fixed(name: str, unit: str, start: float, text: str) -> Variable:
    return Variable(name=name, role="fixed", unit=unit, start=start, description=text)
