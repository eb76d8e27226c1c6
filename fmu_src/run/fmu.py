"""FMUs as co-simulation slaves: variables by name, trusted or not, pooled, freed on every exit."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from fmpy.model_description import ModelDescription

from fmu_src.run.archive import Archive
from fmu_src.run.instance import (
    SUFFIX,
    VERSIONS,
    WARNING,
    Buffer,
    Instance,
    LoadError,
    UnpackedFmu,
)
from fmu_src.run.loader import load_instance
from fmu_src.run.trust import is_known
from fmu_src.run.variables import (
    DESCRIPTION,
    Declared,
    Variables,
    read_packed_description,
    read_unpacked_description,
)
from fmu_src.run.vocabulary import judge_description
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.findings import log_findings
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import DiedError

if TYPE_CHECKING:
    from fmu_src.run.sandbox import Sandbox, SandboxedInstance, SystemSandbox

Starts = Mapping[str, float | str]
SECONDS = 60.0  # for a call of an untrusted FMU


class FmuInstance:
    """A co-simulation slave; a context manager that frees instance and files on every exit.

    Trusted FMUs run in this process, others in a sandbox with `seconds` [s] for each call, or in
    that of a system; `unpacked` is the folder of a trusted one. With `exchange`, an FMU for model
    exchange alone becomes a slave with a solver. Methods raise SimulationError.
    """

    description: ModelDescription
    variables: Variables
    declared: list[Declared]

    def __init__(
        self,
        fmu: Path,
        *,
        name: str | None = None,
        seconds: float = SECONDS,
        unpacked: Path | None = None,
        system: "SystemSandbox | None" = None,
        exchange: bool = False,
    ) -> None:
        self.fmu = fmu
        self._exchange = exchange
        self.name = name or fmu.stem
        self.time = 0.0  # time reached, or start of the step that failed [s]
        self.messages: list[str] = []
        self.used = self.failed = False  # reset before the next initialisation; a call has failed
        self._seconds = seconds
        self._unpacked = unpacked
        self._system = system
        self.trusted = True
        self._complaint: str | None = None
        self._stepping = False
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as cleanup:
            sandbox = None
            if self._unpacked:
                folder = self._unpacked
                self.description, self.declared = read_unpacked_description(folder, self.fmu)
            else:
                folder, sandbox = self._unpack(cleanup)
            self.variables = Variables(self.fmu, self.description, self.declared)
            self._instance = self._load_instance(folder, sandbox)
            cleanup.push(self._free)
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *ended: Any) -> None:
        self._cleanup.__exit__(*ended)

    def _unpack(self, cleanup: ExitStack) -> "tuple[Path, Sandbox | None]":
        needed_folders = (*(fmi.folder for fmi in VERSIONS.values()), "resources/")
        sandbox_folder = sandbox = None
        try:
            with Archive(self.fmu) as archive:
                self.trusted = is_known(archive.digest())
                if not self.trusted:
                    from fmu_src.run.sandbox import SystemSandbox  # slow to import

                    system = self._system or cleanup.enter_context(SystemSandbox(self._seconds))
                    sandbox_folder = system.folder
                    sandbox = system.sandbox  # starts meanwhile
                folder = cleanup.enter_context(scratch_folder(sandbox_folder))
                self.description, self.declared = read_packed_description(archive)
                if not self.trusted:
                    log_findings(judge_description(archive.read(DESCRIPTION), self.fmu.name))
                archive.unpack(folder, lambda name: name.startswith(needed_folders))
                return folder, sandbox
        except ArtifactError as error:
            raise SimulationError(f"{error}") from error
        except DiedError as error:
            raise self._failure(error) from error

    def _load_instance(
        self, folder: Path, sandbox: "Sandbox | None"
    ) -> "Instance | SandboxedInstance":
        model_description = self.description
        fmi = {"2.0": 2, "3.0": 3}.get(model_description.fmiVersion)
        kind = model_description.coSimulation
        if kind is None and self._exchange:
            kind = model_description.modelExchange
        if fmi is None or kind is None:
            raise SimulationError(f"{self.fmu}: not an FMU of FMI 2.0 or 3.0 for co-simulation.")
        identifier = kind.modelIdentifier
        library = f"{VERSIONS[fmi].folder}{identifier}{SUFFIX}"
        if not (folder / library).is_file():
            raise SimulationError(
                f"{self.fmu}: has no binary for this platform; expected {library}."
            )
        solver_options: dict[str, Any] = {}
        if model_description.coSimulation is None:
            solver_options = _solver_options(model_description)
        unpacked = UnpackedFmu(
            folder=str(folder),
            guid=model_description.guid,
            identifier=identifier,
            name=self.name,
            fmi=fmi,
            variables=self.declared,
            **solver_options,
        )
        try:
            if sandbox is None:
                return load_instance(unpacked, self._log, self._failure)
            from fmu_src.run.sandbox import SandboxedInstance

            return SandboxedInstance(unpacked, self._log, self._failure, sandbox)
        except LoadError as error:
            raise SimulationError(f"{self.fmu}: its binary cannot be loaded ({error}).") from error

    def _free(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or issubclass(kind, Exception):
            self._instance.close(stepping=self._stepping)
        else:  # an interrupt must not wait
            self._instance.kill()

    def _log(self, status: int, text: str) -> None:
        self.messages.append(text)
        if status > WARNING:
            self._complaint = text

    def _failure(self, error: Exception) -> SimulationError:
        self._stepping = False
        self.failed = True
        if isinstance(error, DiedError):  # messages do not explain it
            reason = f"{error}."
        elif self._complaint is not None:
            reason = " ".join(self._complaint.split())
        elif self.messages:  # some tools log reasons without the status of an error
            message = " ".join(self.messages[-1].split())
            reason = f"{str(error).rstrip('.')}; its last message is: {message}"
        else:
            reason = str(error)
        self._complaint = None
        return SimulationError(
            f"{self.fmu.name} ('{self.name}') at t = {self.time:.9g} s: {reason}"
        )

    def initialise(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Starts | None = None,
        inputs: Buffer | None = None,
    ) -> None:
        """Set `start` by name and, in initialisation mode, `inputs`; initialise [s]."""
        self.enter_initialisation(time=time, stop=stop, start=start)
        if inputs is not None:
            inputs.write()
        self.exit_initialisation()

    def enter_initialisation(
        self, *, time: float = 0.0, stop: float | None = None, start: Starts | None = None
    ) -> None:
        """Set `start` by name and enter the initialisation of an experiment [s]."""
        self.time = time
        self.used = True
        self._instance.setup(time, stop)
        self.set(start or {})
        self._instance.enter_initialisation()

    def exit_initialisation(self) -> None:
        """Exit the initialisation."""
        self._instance.exit_initialisation()
        self._stepping = True

    def step(self, time: float, step_size: float) -> None:
        """Step from a time [s] by a step [s]."""
        self.time = time
        self._instance.step(time, step_size)
        self.time = time + step_size

    def reset(self) -> None:
        """Return to the state before the initialisation."""
        self._stepping = False
        self._instance.reset()
        self.used = False

    def set(self, values: Starts) -> None:
        """Set variables of any type by name."""
        kinds: dict[str, list[str]] = {}
        for name in values:
            kinds.setdefault(self.variables[name].type, []).append(name)
        for kind, names in kinds.items():
            chosen = [values[name] for name in names]
            if kind == "Real":
                buffer = self.buffer(names)
                buffer.values[:] = [float(value) for value in chosen]
                buffer.write()
            else:
                setter = _setter(kind)
                to_value = {"String": str, "Float32": float}.get(setter, int)
                references = self.variables.references(names, kind)
                self._instance.set(setter, references, [to_value(value) for value in chosen])

    def get(self, names: Iterable[str]) -> Array:
        """Return Real variables (n,) in their units."""
        return self.buffer(list(names)).read()

    def buffer(self, names: Sequence[str], values: Array | None = None) -> Buffer:
        """Return a buffer of Real variables in `values` (n,), contiguous and new by default."""
        return self._instance.buffer(self.variables.references(names, "Real"), values)

    def slopes(self, names: Sequence[str]) -> Callable[[Array], None]:
        """Return a function that sets the slopes (n,) of inputs [unit/s] for the next step."""
        references = self.variables.references(names, "Real")

        def set_slopes(slopes: Array) -> None:
            self._instance.set_slopes(references, slopes.tolist())

        return set_slopes


def _solver_options(model_description: ModelDescription) -> dict[str, Any]:
    """Return the fields of `UnpackedFmu` that the solver of a model needs."""
    exchange = model_description.modelExchange
    experiment = model_description.defaultExperiment
    options: dict[str, Any] = {
        "exchange": True,
        "states": int(model_description.numberOfContinuousStates or 0),
        "indicators": int(model_description.numberOfEventIndicators or 0),
        "completes_steps": bool(exchange.needsCompletedIntegratorStep),
    }
    if experiment is not None and experiment.tolerance is not None:
        options["tolerance"] = float(experiment.tolerance)
    return options


_TEXTS: list[str] = []


def number_from_text(text: str) -> float:
    """Return the number of a text in a `MixedBuffer`."""
    if text not in _TEXTS:
        _TEXTS.append(text)
    return float(_TEXTS.index(text))


def text_from_number(number: float) -> str:
    """Return the text of a number."""
    return _TEXTS[int(number)]


def build_mixed_buffer(
    instance: FmuInstance, names: Sequence[str], values: Array | None = None
) -> Buffer:
    """Return a buffer of variables of any type; see `MixedBuffer`."""
    if all(instance.variables[name].type == "Real" for name in names):
        return instance.buffer(names, values)
    if values is None:
        values = np.zeros(len(names))
    return MixedBuffer(instance, names, values)


def _setter(kind: str) -> str:
    """Return the type under which `Instance` sets and gets a type of variable but Real."""
    return kind if kind in ("Boolean", "String", "Float32") else "Integer"


def _require_exact(instance: FmuInstance, names: Sequence[str], values: Iterable[float]) -> None:
    """Raise SimulationError for an integer that its floating-point number would change."""
    for name, value in zip(names, values, strict=True):
        if abs(value) > _LARGEST_EXACT:
            raise SimulationError(
                f"{instance.fmu.name} ('{instance.name}') at t = {instance.time:.9g} s: '{name}' "
                f"is {value:.0f}; integers of a run are at most 2^53 in magnitude."
            )


_LARGEST_EXACT = 2**53
_FROM_NUMBER: Mapping[str, Callable[[Any], Any]] = {"String": text_from_number, "Float32": float}
"""Value of a number in a `MixedBuffer`, by type; others are integers."""


class MixedBuffer:
    """Values (n,) of variables of any type as numbers; texts are numbered."""

    def __init__(self, instance: FmuInstance, names: Sequence[str], values: Array) -> None:
        self.values = values
        self._slave = instance
        self._instance = instance._instance
        self._names = list(names)
        self._groups = []
        kinds = [instance.variables[name].type for name in names]
        for kind in dict.fromkeys(kinds):
            indices = [i for i, variable_kind in enumerate(kinds) if variable_kind == kind]
            chosen = [names[i] for i in indices]
            real = instance.buffer(chosen) if kind == "Real" else None
            references = instance.variables.references(chosen, kind)
            self._groups.append((indices, _setter(kind), references, real))

    def write(self) -> None:
        """Set the variables."""
        for indices, kind, references, real in self._groups:
            numbers = self.values[indices]
            if real:
                real.values[:] = numbers
                real.write()
            else:
                to_value = _FROM_NUMBER.get(kind, int)
                self._instance.set(kind, references, [to_value(value) for value in numbers])

    def read(self) -> Array:
        """Read and return the variables."""
        for indices, kind, references, real in self._groups:
            read_values = real.read() if real else self._instance.get(kind, references)
            if kind == "String":
                read_values = list(map(number_from_text, read_values))
            elif kind == "Integer":
                _require_exact(self._slave, [self._names[i] for i in indices], read_values)
            self.values[indices] = read_values
        return self.values


_Key = tuple[Path, int, int, int, str]  # identity of a file and name of the instance


class FmuPool:
    """Instances kept for their next use, because loading is slow."""

    def __init__(self, max_idle: int = 48) -> None:
        self._max_idle = max_idle
        self._idle: dict[_Key, FmuInstance] = {}

    @contextmanager
    def lend(
        self, fmu: Path, *, name: str, system: "SystemSandbox | None" = None
    ) -> Iterator[FmuInstance]:
        """Yield a new or kept instance; keep it unless a call failed or it ends with `system`."""
        key = _key(fmu, name)
        instance = None
        if key is not None:
            instance = self._idle.pop(key, None)
        if instance is None:
            instance = FmuInstance(fmu, name=name, system=system).__enter__()
        try:
            yield instance
        except BaseException as error:
            instance.__exit__(type(error), error, error.__traceback__)
            raise
        if (
            key
            and key not in self._idle
            and (instance.trusted or not system)
            and _make_ready(instance)
        ):
            self._idle[key] = instance
            while len(self._idle) > self._max_idle:
                self._idle.pop(next(iter(self._idle))).__exit__(None, None, None)
        else:
            instance.__exit__(None, None, None)

    def clear(self) -> None:
        """Free all instances."""
        while self._idle:
            self._idle.popitem()[1].__exit__(None, None, None)


POOL = FmuPool()


def _key(fmu: Path, name: str) -> _Key | None:
    try:
        file_status = fmu.stat()
    except OSError:  # reported when the FMU is loaded
        return None
    return fmu.resolve(), file_status.st_ino, file_status.st_size, file_status.st_mtime_ns, name


def _make_ready(instance: FmuInstance) -> bool:
    if instance.failed:
        return False
    try:
        if instance.used:
            instance.reset()
    except SimulationError:
        return False
    instance.time = 0.0
    instance.messages.clear()
    return True
