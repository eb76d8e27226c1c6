"""FMUs of both versions, run by the names of their scalars while they are exported."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import chdir
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

Made = tuple[ET.Element, str, Path]
"""Root of the description, model identifier, and folder of an unpacked FMU."""


class _Recording:
    """What is the same in both versions."""

    _slave: Any

    def initialised(self) -> None:
        """End the initialisation."""
        self._slave.exitInitializationMode()

    def step(self, time: float, size: float) -> None:
        """Go on from a time [s] by a step [s]."""
        self._slave.doStep(currentCommunicationPoint=time, communicationStepSize=size)

    def end(self) -> None:
        """Terminate and free the instance."""
        self._slave.terminate()

    def free(self) -> None:
        """Free the instance, whatever has become of it."""
        self._slave.freeInstance()


class Recording2(_Recording):
    """An instance of FMI 2.0.

    Parameters
    ----------
    made : the FMU.
    """

    def __init__(self, made: Made) -> None:
        from fmpy import fmi2

        self._variables = {v.get("name", ""): v for v in made[0].iter("ScalarVariable")}
        self._slave = _loaded(fmi2.FMU2Slave, made, made[0].get("guid"))
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(lambda *_: None)
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        self._slave.instantiate(callbacks=callbacks)

    def begin(self, parameters: Mapping[str, float]) -> None:
        """Set parameters, an Integer as its number, and begin the initialisation."""
        for name, value in parameters.items():
            integer = self._variables[name].find("Integer") is not None
            put = self._slave.setInteger if integer else self._slave.setReal
            put(self._references([name]), [int(value) if integer else value])
        self._slave.setupExperiment(startTime=0.0)
        self._slave.enterInitializationMode()

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs that are numbers."""
        return [
            name for name, v in self._variables.items()
            if v.get("causality") == "output" and v.get("variability") != "discrete"
        ]  # fmt: skip

    def put(self, values: Mapping[str, float]) -> None:
        """Set Reals."""
        self._slave.setReal(self._references(list(values)), list(values.values()))

    def read(self, names: Sequence[str]) -> list[float]:
        """Return Reals."""
        found: list[float] = self._slave.getReal(self._references(names))
        return found

    def _references(self, names: Sequence[str]) -> list[int]:
        return [_reference(self._variables[name]) for name in names]


class Recording3(_Recording):
    """An instance of FMI 3.0, whose arrays are set whole: the rest of one stays what it was."""

    def __init__(self, made: Made) -> None:
        from fmpy.fmi3 import FMU3Slave

        variables = made[0].find("ModelVariables")
        assert variables is not None
        self._numbers = [v for v in variables if v.tag == "Float64"]
        self._choices = {v.get("name", ""): _reference(v) for v in variables if v.tag == "Int32"}
        self._places = {
            own: (_reference(v), k) for v in self._numbers for k, own in enumerate(_elements(v))
        }
        self._held = {_reference(v): _starts(v) for v in self._numbers}
        self._slave = _loaded(FMU3Slave, made, made[0].get("instantiationToken"))
        self._slave.instantiate(logMessage=lambda *_: None)

    def begin(self, parameters: Mapping[str, float]) -> None:
        """Set parameters, a choice as its number, and begin the initialisation."""
        for name in self._choices.keys() & parameters.keys():
            self._slave.setInt32([self._choices[name]], [int(parameters[name])])
        self.put({name: v for name, v in parameters.items() if name not in self._choices})
        self._slave.enterInitializationMode(startTime=0.0)

    @property
    def outputs(self) -> list[str]:
        """Names of the scalars of the outputs that are numbers."""
        own = [v for v in self._numbers if v.get("causality") == "output"]
        return [name for v in own for name in _elements(v)]

    def put(self, values: Mapping[str, float]) -> None:
        """Set numbers."""
        for name, value in values.items():
            reference, place = self._places[name]
            self._held[reference][place] = value
        for reference in dict.fromkeys(self._places[name][0] for name in values):
            self._slave.setFloat64([reference], self._held[reference])

    def read(self, names: Sequence[str]) -> list[float]:
        """Return numbers."""
        places = [self._places[name] for name in names]
        whole = {
            reference: self._slave.getFloat64([reference], nValues=len(self._held[reference]))
            for reference in dict.fromkeys(reference for reference, _ in places)
        }
        return [float(whole[reference][place]) for reference, place in places]


def _loaded(kind: Callable[..., Any], made: Made, token: str | None) -> Any:
    _, identifier, home = made
    with chdir(home):  # FMPy changes it, and leaves it so where loading fails
        return kind(
            guid=token,
            modelIdentifier=identifier,
            unzipDirectory=str(home),
            instanceName=identifier,
        )


def _reference(variable: ET.Element) -> int:
    return int(variable.get("valueReference", ""))


def _elements(variable: ET.Element) -> list[str]:
    """Return the names of a variable's scalars, as FMI 2.0 has them."""
    name = variable.get("name", "")
    shape = [int(d.get("start", "1")) for d in variable.iter("Dimension")]
    places = product(*(range(1, size + 1) for size in shape))
    return [f"{name}[{','.join(map(str, at))}]" for at in places] if shape else [name]


def _starts(variable: ET.Element) -> list[float]:
    given = [float(word) for word in variable.get("start", "").split()]
    return given or [0.0] * len(_elements(variable))
