"""One FMU as a co-simulation slave: values by name, always freed."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from fmpy.model_description import ModelDescription

from fmu_src.run import trust as exported
from fmu_src.run.archive import Archive
from fmu_src.run.batch import WARNING, Buffer
from fmu_src.run.instance import BINARIES, SUFFIX, Binary, DiedError, Instance, LoadError
from fmu_src.run.instance3 import instance_of
from fmu_src.run.variables import Declared, Variables, description_in
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

if TYPE_CHECKING:
    from fmu_src.run.sandbox import Remote

SECONDS = 60.0
"""Longest call of a foreign FMU, where not said otherwise."""


class Component:
    """A slave; a context manager that frees the instance and its files on every way out.

    An FMU that was exported here runs in this process; any other one is foreign code and runs in a
    process of its own, with limits on time, memory and files.

    Parameters
    ----------
    fmu : the FMU, FMI 2.0 or 3.0 for co-simulation; the variables of 3.0 are named as those of 2.0.
    name : name of the instance; the file's stem where not given.
    seconds : longest call of a foreign FMU [s].

    Attributes
    ----------
    description : the FMU's own, once it is loaded.
    variables : look-up in it.
    declared : of FMI 3.0, its variables as they are declared; see `fmu_src.run.variables`.
    time : that the FMU has reached, or at which the call began that failed [s].
    messages : what the FMU has told its host.
    used : whether an initialisation has begun, so that a reset is needed before another one.
    failed : whether a call has failed.

    Raises
    ------
    SimulationError
        By every method: naming the FMU, the time, and the variable where it is one's fault.

    Examples
    --------
    >>> with Component(Path("Friction.fmu")) as friction:
    ...     friction.initialise(start={"dq[1]": 0.2})
    ...     friction.step(0.0, 0.005)
    ...     friction.get(["tau[1]"])
    """

    description: ModelDescription
    variables: Variables
    declared: list[Declared]

    def __init__(self, fmu: Path, *, name: str | None = None, seconds: float = SECONDS) -> None:
        self.fmu = fmu
        self.name = name or fmu.stem
        self.time = 0.0
        self.messages: list[str] = []
        self.used = self.failed = False
        self._seconds = seconds
        self._complaint: str | None = None
        self._stepping = False
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        """Unpack, load and instantiate."""
        with ExitStack() as cleanup:
            folder = cleanup.enter_context(scratch_folder())
            try:
                known = self._unpack(folder)
            except ArtifactError as error:
                raise SimulationError(f"{error}") from error
            self.variables = Variables(self.fmu, self.description)
            self._instance = self._loaded(folder, known=known)
            cleanup.push(self._free)
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *ended: Any) -> None:
        """Free the instance, unload the library and remove the unpacked files."""
        self._cleanup.__exit__(*ended)

    def _unpack(self, folder: Path) -> bool:
        """Unpack what is needed here; return whether the FMU is known as one of ours."""
        with Archive(self.fmu) as archive:
            self.description, self.declared = description_in(archive)
            own = (*BINARIES.values(), "resources/")
            archive.unpack(folder, lambda name: name.startswith(own))
            return exported.is_known(archive.digest())

    def _loaded(self, folder: Path, *, known: bool) -> "Instance | Remote":
        about = self.description
        fmi = {"2.0": 2, "3.0": 3}.get(about.fmiVersion)
        if fmi is None or about.coSimulation is None:
            raise SimulationError(f"{self.fmu}: not an FMU of FMI 2.0 or 3.0 for co-simulation.")
        identifier = about.coSimulation.modelIdentifier
        library = f"{BINARIES[fmi]}{identifier}{SUFFIX}"
        if not (folder / library).is_file():
            raise SimulationError(
                f"{self.fmu}: has no binary for this platform; needed is {library}."
            )
        binary = Binary(
            folder=str(folder), guid=about.guid, identifier=identifier, name=self.name, fmi=fmi,
            variables=self.declared,
        )  # fmt: skip
        try:
            if known:
                return instance_of(binary, self._log, self._failure)
            from fmu_src.run.sandbox import Remote  # slow to import

            own = folder / "process"  # no folder of an FMU's archive, of which two are unpacked
            own.mkdir()
            return Remote(binary, self._log, self._failure, own, self._seconds)
        except LoadError as error:
            raise SimulationError(f"{self.fmu}: its binary cannot be loaded ({error}).") from error

    def _free(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or issubclass(kind, Exception):
            self._instance.close(stepping=self._stepping)
        else:  # an interrupt waits for nobody
            self._instance.kill()

    def _log(self, status: int, text: str) -> None:
        self.messages.append(text)
        if status > WARNING:
            self._complaint = text

    def _failure(self, error: Exception) -> SimulationError:
        self._stepping, self.failed = False, True
        # A message of a call that went well says nothing about this one.
        reason, self._complaint = self._complaint or str(error), None
        if isinstance(error, DiedError):  # whatever it said before
            reason = f"{error}."
        return SimulationError(
            f"{self.fmu.name} ('{self.name}') at t = {self.time:.9g} s: {reason}"
        )

    def initialise(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Mapping[str, float | str] | None = None,
        inputs: Buffer | None = None,
    ) -> None:
        """Set parameters, start values and inputs, and go through the initialisation.

        Parameters
        ----------
        time, stop : start and end of the experiment [s].
        start : values of parameters, states and inputs by name.
        inputs : batch that is written while the FMU is being initialised.
        """
        self.enter_initialisation(time=time, stop=stop, start=start)
        if inputs is not None:
            inputs.write()
        self.exit_initialisation()

    def enter_initialisation(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Mapping[str, float | str] | None = None,
    ) -> None:
        """Do the first half of `initialise`; inputs may be set and outputs read after it."""
        self.time = time
        self.used = True
        defined = stop is not None
        call = self._instance.call
        call("fmi2SetupExperiment", False, 0.0, time, defined, stop or 0.0)
        self.set(start or {})
        call("fmi2EnterInitializationMode")

    def exit_initialisation(self) -> None:
        """Do the second half of `initialise`; steps may follow."""
        self._instance.call("fmi2ExitInitializationMode")
        self._stepping = True

    def step(self, time: float, step: float) -> None:
        """Go from `time` to `time + step` [s]."""
        self.time = time
        self._instance.step(time, step)
        self.time = time + step

    def reset(self) -> None:
        """Go back to before the initialisation, with all start values."""
        self._stepping = False
        self._instance.call("fmi2Reset")
        self.used = False

    def set(self, values: Mapping[str, float | str]) -> None:
        """Set variables of any type by name; text for those of type String only."""
        kinds: dict[str, list[str]] = {}
        for name in values:
            kinds.setdefault(self.variables[name].type, []).append(name)
        for kind, names in kinds.items():
            chosen = [values[name] for name in names]
            if kind == "Real":
                batch = self.batch(names)
                batch.values[:] = chosen
                batch.write()
            else:
                own = kind if kind in ("Boolean", "String") else "Integer"
                given = chosen if own == "String" else [int(value) for value in chosen]
                references = self.variables.references(names, kind)
                self._instance.put(own, references, given)

    def get(self, names: Iterable[str]) -> Array:
        """Return Real variables, (n,) in their units, in the order of their names."""
        return self.batch(list(names)).read()

    def batch(self, names: Sequence[str], values: Array | None = None) -> Buffer:
        """Return a buffer by which the same Real variables are set or read again and again.

        Parameters
        ----------
        names : of the variables.
        values : (n,) contiguous memory to be that buffer, in the variables' units; its own where
            not given.
        """
        return self._instance.batch(self.variables.references(names, "Real"), values)

    def slopes(self, names: Sequence[str]) -> Callable[[Array], None]:
        """Return a function that sets the slopes of inputs, (n,) [unit/s], for the next step."""
        references = self.variables.references(names, "Real")

        def set_slopes(slopes: Array) -> None:
            self._instance.slope(references, slopes.tolist())

        return set_slopes
