"""The closed loop on the generated plant instead of MuJoCo's arm."""

from collections.abc import Mapping
from pathlib import Path

from cosim.loop.closed_loop import Gains
from cosim.systems.system import ComponentSpec, SystemSpec
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot

PLANT = "Plant.fmu"

# Signals of the plant by those of the twin's arm.
_SIGNALS = {"arm.q_true": "arm.q", "arm.tau_meas": "arm.tau_motor"}


def build_plant(
    path: Path,
    models: Mapping[str, FrictionModel],
    robot: Robot,
    body: RigidBody,
    gains: Gains,
) -> Path:
    """Write the generated plant with the assumed servo and the first law with memory, if any.

    Raises ExportError if the identified masses give no positive definite mass matrix.
    """
    known = list(models.values())
    law = next((one for one in known if one.laws[0].form.memory), known[0])
    return export_plant(law, path, body=PlantBody.of(robot, body), kv=gains.Kv, ki=gains.Ki)


def on_plant(spec: SystemSpec, plant: Path, gains: Gains) -> SystemSpec:
    """Return a loop with the generated plant instead of the arm."""

    def moved(component: ComponentSpec) -> ComponentSpec:
        if component.name != "arm":
            return component
        start = {"q_start": component.start["q0"], "latency": gains.latency, "tau": 0.0}
        return component.model_copy(update={"fmu": plant, "start": start})

    def named(signal: str) -> str:
        return _SIGNALS.get(signal, signal)

    return spec.model_copy(
        update={
            "components": tuple(map(moved, spec.components)),
            "connections": {into: named(out) for into, out in spec.connections.items()},
            "observe": tuple(map(named, spec.observe)),
            "limits": {named(signal): bounds for signal, bounds in spec.limits.items()},
        }
    )
