"""Duration of the physics checks on all laws of a robot."""

from collections.abc import Callable
from dataclasses import replace

from pytest_benchmark.fixture import BenchmarkFixture
from registry_models import models_of_registry

from hesr.extras.properties.battery import Subject, run_battery

JOINTS = 3


def test_physics_checks_on_all_laws(
    benchmark: BenchmarkFixture, tell: Callable[[str], None]
) -> None:
    """Target: 60 s for all laws of the registry on three joints on two cores, FMUs built."""
    benchmark.group = "property battery"
    subjects = [
        Subject(
            name=model.law,
            model=replace(
                model,
                joints=tuple(f"j{k}" for k in range(1, JOINTS + 1)),
                laws=model.laws * JOINTS,
                trained=model.trained * JOINTS,
            ),
            inertia=(0.5,),
        )
        for model in models_of_registry()
    ]
    found = benchmark.pedantic(lambda: run_battery(subjects), rounds=1)
    assert len(found) == len(subjects)
    seconds = benchmark.stats.stats.min
    tell(f"{len(subjects)} laws of {JOINTS} joints through thirteen experiments in {seconds:.1f} s")
