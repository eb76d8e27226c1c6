/* Types and functions of FMI 2.0. */
#ifndef FMI2_H
#define FMI2_H

#include <stddef.h>

/* Defined differently by the glue of FMI 3.0. */
#if defined FMI2_EXPORT
#elif defined _WIN32
#define FMI2_EXPORT __declspec(dllexport)
#elif defined __GNUC__
#define FMI2_EXPORT __attribute__((visibility("default")))
#else
#define FMI2_EXPORT
#endif

/* A prefix separates the functions of FMUs linked into one program. */
#ifdef FMI2_FUNCTION_PREFIX
#define FMI2_JOIN(prefix, name) prefix##name
#define FMI2_PREFIXED(prefix, name) FMI2_JOIN(prefix, name)
#define FMI2_NAME(name) FMI2_PREFIXED(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI2_NAME(name) name
#endif

#define FMI2_TEXT(name) FMI2_EXPORT const char *FMI2_NAME(name)
#define FMI2_STATUS(name) FMI2_EXPORT fmi2Status FMI2_NAME(name)

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Byte;
typedef const char *fmi2String;

enum { fmi2False = 0, fmi2True = 1 };

typedef enum {
    fmi2OK,
    fmi2Warning,
    fmi2Discard,
    fmi2Error,
    fmi2Fatal,
    fmi2Pending,
} fmi2Status;

typedef enum {
    fmi2ModelExchange,
    fmi2CoSimulation,
} fmi2Type;

typedef enum {
    fmi2DoStepStatus,
    fmi2PendingStatus,
    fmi2LastSuccessfulTime,
    fmi2Terminated,
} fmi2StatusKind;

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

typedef struct {
    void (*logger)(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...);
    void *(*allocateMemory)(size_t count, size_t size);
    void (*freeMemory)(void *memory);
    void (*stepFinished)(fmi2ComponentEnvironment environment, fmi2Status status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

FMI2_TEXT(fmi2GetTypesPlatform)(void);
FMI2_TEXT(fmi2GetVersion)(void);
FMI2_STATUS(fmi2SetDebugLogging)(fmi2Component c, fmi2Boolean on, size_t n,
                                 const fmi2String category[]);

FMI2_EXPORT fmi2Component FMI2_NAME(fmi2Instantiate)(fmi2String name, fmi2Type type,
                                                     fmi2String guid, fmi2String resources,
                                                     const fmi2CallbackFunctions *functions,
                                                     fmi2Boolean visible, fmi2Boolean logging);
FMI2_EXPORT void FMI2_NAME(fmi2FreeInstance)(fmi2Component c);

FMI2_STATUS(fmi2SetupExperiment)(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance,
                                 fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop);
FMI2_STATUS(fmi2EnterInitializationMode)(fmi2Component c);
FMI2_STATUS(fmi2ExitInitializationMode)(fmi2Component c);
FMI2_STATUS(fmi2Terminate)(fmi2Component c);
FMI2_STATUS(fmi2Reset)(fmi2Component c);

FMI2_STATUS(fmi2GetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         fmi2Real value[]);
FMI2_STATUS(fmi2GetInteger)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                            fmi2Integer value[]);
FMI2_STATUS(fmi2GetBoolean)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                            fmi2Boolean value[]);
FMI2_STATUS(fmi2GetString)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                           fmi2String value[]);
FMI2_STATUS(fmi2SetReal)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                         const fmi2Real value[]);
FMI2_STATUS(fmi2SetInteger)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                            const fmi2Integer value[]);
FMI2_STATUS(fmi2SetBoolean)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                            const fmi2Boolean value[]);
FMI2_STATUS(fmi2SetString)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                           const fmi2String value[]);

FMI2_STATUS(fmi2GetFMUstate)(fmi2Component c, fmi2FMUstate *state);
FMI2_STATUS(fmi2SetFMUstate)(fmi2Component c, fmi2FMUstate state);
FMI2_STATUS(fmi2FreeFMUstate)(fmi2Component c, fmi2FMUstate *state);
FMI2_STATUS(fmi2SerializedFMUstateSize)(fmi2Component c, fmi2FMUstate state, size_t *size);
FMI2_STATUS(fmi2SerializeFMUstate)(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
                                   size_t size);
FMI2_STATUS(fmi2DeSerializeFMUstate)(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                     fmi2FMUstate *state);

FMI2_STATUS(fmi2GetDirectionalDerivative)(fmi2Component c, const fmi2ValueReference unknown[],
                                          size_t n_unknown, const fmi2ValueReference known[],
                                          size_t n_known, const fmi2Real d_known[],
                                          fmi2Real d_unknown[]);

/* Model exchange. */
FMI2_STATUS(fmi2EnterEventMode)(fmi2Component c);
FMI2_STATUS(fmi2NewDiscreteStates)(fmi2Component c, fmi2EventInfo *info);
FMI2_STATUS(fmi2EnterContinuousTimeMode)(fmi2Component c);
FMI2_STATUS(fmi2CompletedIntegratorStep)(fmi2Component c, fmi2Boolean no_set_state_before,
                                         fmi2Boolean *event, fmi2Boolean *terminate);
FMI2_STATUS(fmi2SetTime)(fmi2Component c, fmi2Real time);
FMI2_STATUS(fmi2SetContinuousStates)(fmi2Component c, const fmi2Real x[], size_t n);
FMI2_STATUS(fmi2GetDerivatives)(fmi2Component c, fmi2Real dx[], size_t n);
FMI2_STATUS(fmi2GetEventIndicators)(fmi2Component c, fmi2Real indicator[], size_t n);
FMI2_STATUS(fmi2GetContinuousStates)(fmi2Component c, fmi2Real x[], size_t n);
FMI2_STATUS(fmi2GetNominalsOfContinuousStates)(fmi2Component c, fmi2Real nominal[], size_t n);

/* Co-simulation. */
FMI2_STATUS(fmi2SetRealInputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                         const fmi2Integer order[], const fmi2Real value[]);
FMI2_STATUS(fmi2GetRealOutputDerivatives)(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                          const fmi2Integer order[], fmi2Real value[]);
FMI2_STATUS(fmi2DoStep)(fmi2Component c, fmi2Real time, fmi2Real step,
                        fmi2Boolean no_set_state_before);
FMI2_STATUS(fmi2CancelStep)(fmi2Component c);
FMI2_STATUS(fmi2GetStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value);
FMI2_STATUS(fmi2GetRealStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value);
FMI2_STATUS(fmi2GetIntegerStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value);
FMI2_STATUS(fmi2GetBooleanStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value);
FMI2_STATUS(fmi2GetStringStatus)(fmi2Component c, const fmi2StatusKind kind, fmi2String *value);

#endif
