"""The functions of FMI 2.0 and which capability promises which of them."""

_COMMON = """
GetTypesPlatform GetVersion SetDebugLogging Instantiate FreeInstance SetupExperiment
EnterInitializationMode ExitInitializationMode Terminate Reset
GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString
GetFMUstate SetFMUstate FreeFMUstate
SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate GetDirectionalDerivative
"""

_EXCHANGE = """
EnterEventMode NewDiscreteStates EnterContinuousTimeMode CompletedIntegratorStep
SetTime SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates
GetNominalsOfContinuousStates
"""

_SIMULATION = """
SetRealInputDerivatives GetRealOutputDerivatives DoStep CancelStep
GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus
"""


def _functions(text: str) -> tuple[str, ...]:
    return tuple(f"fmi2{name}" for name in text.split())


REQUIRED = {
    "ModelExchange": _functions(_COMMON + _EXCHANGE),
    "CoSimulation": _functions(_COMMON + _SIMULATION),
}
"""The standard demands all of them, whether the FMU supports what they do or not."""

KNOWN = frozenset(_functions(_COMMON + _EXCHANGE + _SIMULATION))

PROMISED = {
    "canGetAndSetFMUstate": _functions("GetFMUstate SetFMUstate FreeFMUstate"),
    "canSerializeFMUstate": _functions(
        "SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate"
    ),
    "providesDirectionalDerivative": _functions("GetDirectionalDerivative"),
    "canInterpolateInputs": _functions("SetRealInputDerivatives"),
    "canRunAsynchronuously": _functions("CancelStep GetStatus"),
}
"""Functions that hosts call because of a flag in the XML."""
