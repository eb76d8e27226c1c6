"""Laws of known behaviour, and a friction FMU without a law, as test subjects."""

from pathlib import Path

from fmu_src.export.description import Description
from fmu_src.export.interface import Interface, Variable
from fmu_src.export.package import Content, write_fmu
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange

SLIP = Path(__file__).with_name("slip.c")
SPEED = 1.0
"""Trained speed of all laws here [rad/s]."""
INERTIA = 0.7
"""Inertia of every joint [kg.m2]."""


def law(name: str, **values: float) -> FrictionLaw:
    """A law of the registry; missing coefficients are zero."""
    form = estimator(name).form({})
    return FrictionLaw(
        name=name,
        form=form,
        values={c.name: values.get(c.name, 0.0) for c in form.coefficients},
    )


def model(*laws: FrictionLaw, robot: str = "bench", sample_time: float = 0.005) -> FrictionModel:
    """One joint per law."""
    trained = TrainedRange(
        sample_time=sample_time,
        dq=(-SPEED, SPEED),
        q=(-0.5, 0.5),
        tau_load=(-10.0, 20.0),
        tau=(-15.0, 15.0),
    )
    return FrictionModel(
        law=laws[0].name,
        robot=robot,
        joints=tuple(f"j{k}" for k in range(1, len(laws) + 1)),
        laws=laws,
        sample_time=sample_time,
        trained=(trained,) * len(laws),
    )


def bristle(*, static: float = 8.0, sigma_1: float = 0.0, sigma_2: float = 0.0) -> FrictionLaw:
    """LuGre with 8 N.m and 1 mrad."""
    return law(
        "lugre",
        F_c=8.0,
        F_s=static,
        sigma_0=8000.0,
        sigma_1=sigma_1,
        sigma_2=sigma_2,
        v_s=0.05,
    )


def slip(folder: Path, *, output: str = "tau[1]") -> Path:
    """A friction FMU of another tool: spring-sliders, without a law."""
    table = Interface(
        variables=(
            Variable(name="dq[1]", role="input", description="velocity", unit="rad/s"),
            Variable(name="q[1]", role="input", description="position", unit="rad"),
            Variable(name="tau_load[1]", role="input", description="load", unit="N.m"),
            Variable(
                name=output,
                role="output",
                description="friction",
                unit="N.m",
                dependencies=("dq[1]",),
            ),
        ),
        own=3,
        model_exchange=False,
        directional_derivatives=False,
    )
    about = Description(
        name="Slip",
        identifier="slip",
        text="Spring-sliders.",
        version="1",
        step=0.005,
        created="2000-01-01T00:00:00Z",
        sources=("all.c",),
    )
    sources = {"slip.c": SLIP.read_text(encoding="utf-8")}
    return write_fmu(
        Content(table=table, about=about, members={}, sources=sources), folder / "Slip.fmu"
    )
