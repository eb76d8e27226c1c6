/* Functions of FMI 3.0, declared by importers as in the standard. */
#ifndef FMI3_FUNCTIONS_H
#define FMI3_FUNCTIONS_H

#include "fmi3.h"

/* Functions with another name in FMI 2.0. */
#define fmi3GetFMUstate fmi3GetFMUState
#define fmi3SetFMUstate fmi3SetFMUState
#define fmi3FreeFMUstate fmi3FreeFMUState
#define fmi3SerializedFMUstateSize fmi3SerializedFMUStateSize
#define fmi3SerializeFMUstate fmi3SerializeFMUState
#define fmi3DeSerializeFMUstate fmi3DeserializeFMUState
#define fmi3GetDerivatives fmi3GetContinuousStateDerivatives

#define OF_STATE fmi3FMUState state
#define REFS const fmi3ValueReference vr[], size_t n
#define DECLARED(name, ...) fmi3Status fmi3##name(fmi3Instance c, __VA_ARGS__);
#define PLAIN(name) fmi3Status fmi3##name(fmi3Instance c);

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path,
                                          fmi3Boolean visible, fmi3Boolean logging,
                                          fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log);
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path,
                                         fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference intermediate[],
                                         size_t n_intermediate, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3Callback update);
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String path,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment,
                                               fmi3LogMessageCallback log, fmi3Callback update,
                                               fmi3Callback lock, fmi3Callback unlock);
void fmi3FreeInstance(fmi3Instance c);
const char *fmi3GetVersion(void);

DECLARED(SetDebugLogging, fmi3Boolean on, size_t n, const fmi3String category[])
DECLARED(EnterInitializationMode, fmi3Boolean tolerance_defined, fmi3Float64 tolerance,
         fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
PLAIN(ExitInitializationMode)
PLAIN(Terminate)
PLAIN(Reset)
PLAIN(EnterEventMode)
PLAIN(EnterStepMode)
PLAIN(EnterContinuousTimeMode)
PLAIN(EnterConfigurationMode)
PLAIN(ExitConfigurationMode)
PLAIN(EvaluateDiscreteStates)

DECLARED(GetFMUState, fmi3FMUState *state)
DECLARED(SetFMUState, OF_STATE)
DECLARED(FreeFMUState, fmi3FMUState *state)
DECLARED(SerializedFMUStateSize, OF_STATE, size_t *size)
DECLARED(SerializeFMUState, OF_STATE, fmi3Byte bytes[], size_t size)
DECLARED(DeserializeFMUState, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)

DECLARED(GetFloat64, REFS, fmi3Float64 value[], size_t n_values)
DECLARED(SetFloat64, REFS, const fmi3Float64 value[], size_t n_values)
DECLARED(GetInt32, REFS, fmi3Int32 value[], size_t n_values)
DECLARED(SetInt32, REFS, const fmi3Int32 value[], size_t n_values)
DECLARED(GetDirectionalDerivative, REFS, const fmi3ValueReference knowns[], size_t n_knowns,
         const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity)

DECLARED(DoStep, fmi3Float64 time, fmi3Float64 step, fmi3Boolean no_set_state_before,
         fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
DECLARED(UpdateDiscreteStates, fmi3Boolean *update, fmi3Boolean *terminate, fmi3Boolean *nominals,
         fmi3Boolean *values, fmi3Boolean *next_defined, fmi3Float64 *next)
DECLARED(CompletedIntegratorStep, fmi3Boolean no_set_state_before, fmi3Boolean *event,
         fmi3Boolean *terminate)
DECLARED(SetTime, fmi3Float64 time)
DECLARED(SetContinuousStates, const fmi3Float64 x[], size_t n)
DECLARED(GetContinuousStates, fmi3Float64 x[], size_t n)
DECLARED(GetContinuousStateDerivatives, fmi3Float64 dx[], size_t n)
DECLARED(GetNominalsOfContinuousStates, fmi3Float64 nominal[], size_t n)
DECLARED(GetEventIndicators, fmi3Float64 indicator[], size_t n)
DECLARED(GetNumberOfEventIndicators, size_t *n)
DECLARED(GetNumberOfContinuousStates, size_t *n)

/* Not in our FMUs: other types, binaries, clocks. */
#define TYPES(DO)                                                                                  \
    DO(Float32)                                                                                    \
    DO(Int8) DO(UInt8) DO(Int16) DO(UInt16) DO(UInt32) DO(Int64) DO(UInt64) DO(Boolean) DO(String)
#define CLOCKS(DO)                                                                                 \
    DO(GetClock)                                                                                   \
    DO(SetClock)                                                                                   \
    DO(GetIntervalDecimal)                                                                         \
    DO(GetIntervalFraction)                                                                        \
    DO(GetShiftDecimal)                                                                            \
    DO(GetShiftFraction)                                                                           \
    DO(SetIntervalDecimal)                                                                         \
    DO(SetIntervalFraction)                                                                        \
    DO(SetShiftDecimal)                                                                            \
    DO(SetShiftFraction)
#define OF_TYPE(name)                                                                              \
    DECLARED(Get##name, REFS, void *value, size_t n_values)                                        \
    DECLARED(Set##name, REFS, const void *value, size_t n_values)
#define OF_CLOCK(name) DECLARED(name, REFS, const void *a, const void *b, const void *d)

TYPES(OF_TYPE)
CLOCKS(OF_CLOCK)
DECLARED(GetBinary, REFS, const size_t size[], const void *value, size_t n_values)
DECLARED(SetBinary, REFS, const size_t size[], const void *value, size_t n_values)
DECLARED(GetNumberOfVariableDependencies, fmi3ValueReference v, size_t *n)
DECLARED(GetVariableDependencies, fmi3ValueReference v, size_t element[],
         fmi3ValueReference other[], size_t element_of_other[], fmi3DependencyKind kind[], size_t n)
DECLARED(GetAdjointDerivative, REFS, const fmi3ValueReference knowns[], size_t n_knowns,
         const fmi3Float64 seed[], size_t n_seed, fmi3Float64 sensitivity[], size_t n_sensitivity)
DECLARED(GetOutputDerivatives, REFS, const fmi3Int32 order[], fmi3Float64 value[], size_t n_values)
DECLARED(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

#endif
