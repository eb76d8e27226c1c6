"""FMU files: their variables, embedded friction model, replay and instances."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.friction.replay import replay
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.trust import remember
from fmu_src.run.variables import model_description
from hesr_model.friction.model import FrictionModel
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.frames import html_table


@dataclass(frozen=True, kw_only=True)
class FmuVariable:
    """A scalar variable of an FMU, as declared; `unit`, `start` and `description` may be empty.

    Attributes
    ----------
    type : str
        Real, Integer, Boolean, String or Enumeration.
    causality, variability : str
        Terms of FMI, such as "input" and "continuous".
    """

    type: str
    causality: str
    variability: str
    unit: str
    start: str
    description: str


def _read_variable(variable: Any) -> FmuVariable:
    """Return a variable of FMPy, with the defaults of FMI for what is not declared."""
    unit = variable.unit
    if not unit and variable.declaredType:
        unit = variable.declaredType.unit
    return FmuVariable(
        type=variable.type,
        causality=variable.causality or "local",
        variability=variable.variability or "continuous",
        unit=unit or "",
        start=variable.start or "",
        description=variable.description or "",
    )


class Fmu:
    """An FMU file of any tool, of FMI 2.0 or 3.0; usable wherever a path is.

    Parameters
    ----------
    path : path
        The FMU.
    trust : bool
        Run this FMU without a sandbox, now and later: faster, but with all your
        rights.

    Attributes
    ----------
    path : Path
        The FMU.
    variables : mapping of str to FmuVariable
        Variables by name; arrays of FMI 3.0 have one for each element.

    Raises
    ------
    SimulationError
        If the FMU cannot be read.

    Examples
    --------
    >>> import hesr
    >>> fmu = hesr.Fmu("Friction.fmu")
    >>> fmu.variables["dq[1]"].unit
    'rad/s'
    >>> fmu.replay(t=[0.0, 0.01], dq=[[0.1, 0.0, 0.2], [0.1, 0.0, 0.2]]).shape
    (2, 3)
    >>> with fmu.instance() as friction:
    ...     friction.initialise(start={"dq[1]": 0.2})
    ...     friction.step(0.0, 0.005)
    ...     friction.get(["tau[1]"]).shape
    (1,)
    """

    def __init__(self, path: PathArg, trust: bool = False) -> None:
        self.path = to_path(path, "an FMU")
        about = model_description(self.path)
        self._fmi: str = about.fmiVersion
        self.variables: Mapping[str, FmuVariable] = {
            variable.name: _read_variable(variable) for variable in about.modelVariables
        }
        if trust:
            remember(self.path)

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"Fmu('{self.path}', FMI {self._fmi}, {len(self.variables)} variables)"

    def _repr_html_(self) -> str:
        head = ("variable", "causality", "unit", "start", "description")
        rows = (
            (name, v.causality, v.unit, v.start, v.description)
            for name, v in self.variables.items()
        )
        return html_table(repr(self), head, rows)

    @cached_property
    def model(self) -> FrictionModel | None:
        """Embedded friction model; None in FMUs of other tools.

        Raises
        ------
        ArtifactError
            If the FMU cannot be read, or its model is damaged.
        """
        return read_embedded_model(self.path)

    def replay(
        self,
        *,
        t: ArrayLike,
        dq: ArrayLike,
        q: ArrayLike | None = None,
        tau_load: ArrayLike | None = None,
    ) -> Array:
        """Run a friction FMU over a log; it steps from each sample to the next.

        Parameters
        ----------
        t : (N,) array, s
            Increasing time.
        dq : (N, n) array, rad/s
            Joint velocity.
        q : (N, n) array, rad, optional
            Joint position; zero by default.
        tau_load : (N, n) array, N.m, optional
            Load torque; zero by default.

        Returns
        -------
        (N, n) array, N.m
            Friction torque.

        Raises
        ------
        SimulationError
            If the log does not fit the FMU or the FMU fails.
        """
        return replay(self.path, t, dq, q, tau_load)

    def instance(self) -> FmuInstance:
        """Return an instance of the FMU: a context manager that frees it on every exit.

        Trusted FMUs run in this process, others in a sandbox.
        """
        return FmuInstance(self.path)
