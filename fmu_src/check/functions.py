"""Functions of FMI 2.0 and 3.0, and those required by capability flags of FMI 2.0."""

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


_TYPES_3 = """
Float32 Float64 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64 Boolean String Binary Clock
"""

_ALL_3 = """
GetVersion SetDebugLogging InstantiateModelExchange InstantiateCoSimulation
InstantiateScheduledExecution FreeInstance EnterInitializationMode ExitInitializationMode
EnterEventMode Terminate Reset GetNumberOfVariableDependencies GetVariableDependencies
GetFMUState SetFMUState FreeFMUState SerializedFMUStateSize SerializeFMUState DeserializeFMUState
GetDirectionalDerivative GetAdjointDerivative EnterConfigurationMode ExitConfigurationMode
GetIntervalDecimal GetIntervalFraction GetShiftDecimal GetShiftFraction SetIntervalDecimal
SetIntervalFraction SetShiftDecimal SetShiftFraction EvaluateDiscreteStates UpdateDiscreteStates
EnterContinuousTimeMode CompletedIntegratorStep SetTime SetContinuousStates
GetContinuousStateDerivatives GetEventIndicators GetContinuousStates
GetNominalsOfContinuousStates GetNumberOfEventIndicators GetNumberOfContinuousStates
EnterStepMode GetOutputDerivatives DoStep ActivateModelPartition
"""


def _functions(text: str, version: int = 2) -> tuple[str, ...]:
    return tuple(f"fmi{version}{name}" for name in text.split())


REQUIRED = {
    "ModelExchange": _functions(_COMMON + _EXCHANGE),
    "CoSimulation": _functions(_COMMON + _SIMULATION),
}
REQUIRED_3 = (
    *_functions(_ALL_3, 3),
    *(f"fmi3{verb}{name}" for name in _TYPES_3.split() for verb in ("Get", "Set")),
)
"""The standard requires all of them, even for unsupported features."""

KNOWN = frozenset((*_functions(_COMMON + _EXCHANGE + _SIMULATION), *REQUIRED_3))

PROMISED = {
    "canGetAndSetFMUstate": _functions("GetFMUstate SetFMUstate FreeFMUstate"),
    "canSerializeFMUstate": _functions(
        "SerializedFMUstateSize SerializeFMUstate DeSerializeFMUstate"
    ),
    "providesDirectionalDerivative": _functions("GetDirectionalDerivative"),
    "canInterpolateInputs": _functions("SetRealInputDerivatives"),
    "canRunAsynchronuously": _functions("CancelStep GetStatus"),
}
"""Functions that hosts call because of a flag."""
