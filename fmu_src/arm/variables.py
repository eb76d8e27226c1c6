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
        yield Variable(one.name, "input", "control", unit=one.unit)
    for out in signals.outputs:
        text = "sum of sensors"
        yield Variable(out.name, "output", text, unit=out.unit, dependencies=parameters)


def _parameters(signals: ArmSignals) -> Iterator[Variable]:
    scaled = any(scaled for o in signals.outputs for _, _, scaled in o.reads)
    if signals.friction or signals.losses or scaled:
        text = "factor on the friction of the elements that are named for it"
        yield Variable(SCALE, "fixed", text, unit="1", start=1.0)
    if signals.payload is not None:
        yield Variable(PAYLOAD, "fixed", "mass of a payload", unit="kg")
    if signals.delay is not None:
        text = "time until a command acts, in whole steps of the simulation"
        yield Variable(LATENCY, "fixed", text, unit="s", start=signals.delay.usual)
    noisy = [output for output in signals.outputs if output.noise is not None]
    halves = (signals.seed & 0xFFFFFFFF, signals.seed >> 32) if noisy else ()
    for k, half in enumerate(halves, start=1):
        text = f"{'low' if k == 1 else 'high'} 32 bits of the noise's seed"
        yield Variable(f"{SEED}[{k}]", "fixed", text, unit="1", start=float(half))
    for start in signals.starts:
        text = "position at the start"
        yield Variable(start.name, "fixed", text, unit=start.unit, start=start.value)
    for out in noisy:
        text = f"standard deviation of the noise of {out.name}"
        yield Variable(noise_name(out), "fixed", text, unit=out.unit, start=out.noise or 0.0)
