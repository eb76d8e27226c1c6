"""Systems of FMUs read from their files and run."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from weakref import finalize

from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, opened_system
from hesr_model.support.files import PathArg, path_of
from hesr_model.support.progress import Progress, silent


@dataclass(frozen=True, repr=False)
class System:
    """A system of FMUs: components, start values, connections and steps.

    Parameters
    ----------
    spec : SystemSpec
        Content of the file.
    path : path
        File of the system, for messages.

    Examples
    --------
    >>> import hesr
    >>> system = hesr.System.read("loop.toml")
    >>> float(system.run().t[0])
    0.0
    """

    spec: SystemSpec
    path: Path

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a system from TOML or SSP; FMUs of an SSP stay unpacked while the system exists.

        Parameters
        ----------
        path : path
            System (.toml) or SSP (.ssp) of any tool.

        Raises
        ------
        ArtifactError
            If an SSP cannot be read, or is not safe to unpack.
        ConfigError
            If the system is invalid or not supported, naming the file and the key or element.
        SimulationError
            If an FMU in an SSP cannot be read and its units are needed.
        """
        file = path_of(path, "a system")
        with ExitStack() as opened:
            system = cls(opened.enter_context(opened_system(file)), file)
            finalize(system, opened.pop_all().close)
        return system

    def __repr__(self) -> str:
        spec = self.spec
        return (
            f"System('{spec.name}', {len(spec.components)} components, {spec.stop:g} s in steps of "
            f"{spec.step:g} s)"
        )

    def run(self, progress: Progress = silent) -> Signals:
        """Load the FMUs, run the system once and free them.

        Parameters
        ----------
        progress : callable, optional
            Called with steps done and steps in total.

        Returns
        -------
        Signals
            Observed signals over time [s].

        Raises
        ------
        ConfigError
            If the system does not fit its FMUs.
        SimulationError
            If an FMU cannot be loaded or fails.
        """
        with Master(self.spec, self.path) as master:
            return master.run(progress).require_success()
