"""Loader of FMUs in this process."""

from fmu_src.run.instance import Failure, Instance, Tell, UnpackedFmu


def load_instance(fmu: UnpackedFmu, tell: Tell, failure: Failure = lambda error: error) -> Instance:
    """Load an FMU into this process; one for model exchange comes with its solver."""
    if not fmu.exchange:
        return Instance(fmu, tell, failure)
    from fmu_src.run.exchange import ExchangeInstance  # loads the solver's libraries

    return ExchangeInstance(fmu, tell, failure)
