/* A small FMU by hand after FMI 2.0, without code of this project: y = gain u, and a clock.
 *
 * In co-simulation, outputs belong to the last communication point and do not follow new inputs.
 */

#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

enum { U, Y, GAIN, CLOCK, COUNT };

typedef struct {
    fmi2Real values[COUNT];
    fmi2Type type;
} Control;

static void update(Control *control, fmi2Real time)
{
    control->values[Y] = control->values[GAIN] * control->values[U];
    control->values[CLOCK] = time;
}

static void start(Control *control)
{
    memset(control->values, 0, sizeof control->values);
    control->values[GAIN] = 2.0;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String folder,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging)
{
    Control *control = calloc(1, sizeof *control);
    (void)name, (void)guid, (void)folder, (void)functions, (void)visible, (void)logging;
    if (control) {
        control->type = type;
        start(control);
    }
    return control;
}

void fmi2FreeInstance(fmi2Component c)
{
    free(c);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[])
{
    (void)c, (void)on, (void)n, (void)names;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
                               fmi2Real time, fmi2Boolean stops, fmi2Real stop)
{
    (void)tolerant, (void)tolerance, (void)stops, (void)stop;
    ((Control *)c)->values[CLOCK] = time;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    update(c, ((Control *)c)->values[CLOCK]);
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    start(c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    Control *control = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= COUNT) {
            return fmi2Error;
        }
        if (vr[i] == Y && control->type == fmi2ModelExchange) {
            update(control, control->values[CLOCK]);
        }
        value[i] = control->values[vr[i]];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                       const fmi2Real value[])
{
    for (size_t i = 0; i < n; i++) {
        if (vr[i] != U && vr[i] != GAIN) {
            return fmi2Error;
        }
        ((Control *)c)->values[vr[i]] = value[i];
    }
    return fmi2OK;
}

#define NO_VARIABLES(way, kind, more)                                                              \
    fmi2Status fmi2##way##kind(fmi2Component c, const fmi2ValueReference vr[], size_t n,           \
                               more fmi2##kind value[])                                            \
    {                                                                                              \
        (void)c, (void)vr, (void)value;                                                            \
        return n ? fmi2Error : fmi2OK;                                                             \
    }

NO_VARIABLES(Get, Integer, )
NO_VARIABLES(Get, Boolean, )
NO_VARIABLES(Get, String, )
NO_VARIABLES(Set, Integer, const)
NO_VARIABLES(Set, Boolean, const)
NO_VARIABLES(Set, String, const)

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep)
{
    (void)keep;
    update(c, time + step);
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    ((Control *)c)->values[CLOCK] = time;
    return fmi2OK;
}

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    (void)c;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    (void)c;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean last, fmi2Boolean *event,
                                       fmi2Boolean *end)
{
    (void)c, (void)last;
    *event = *end = fmi2False;
    return fmi2OK;
}

#define NO_STATES(name, more)                                                                      \
    fmi2Status fmi2##name(fmi2Component c, more fmi2Real x[], size_t n)                            \
    {                                                                                              \
        (void)c, (void)x;                                                                          \
        return n ? fmi2Error : fmi2OK;                                                             \
    }

NO_STATES(SetContinuousStates, const)
NO_STATES(GetDerivatives, )
NO_STATES(GetEventIndicators, )
NO_STATES(GetContinuousStates, )
NO_STATES(GetNominalsOfContinuousStates, )

/* Optional capabilities that the description does not declare. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c, (void)state;
    return fmi2Error;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    (void)c, (void)state;
    return fmi2Error;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    (void)c, (void)state;
    return fmi2Error;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state, (void)size;
    return fmi2Error;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t n)
{
    (void)c, (void)state, (void)bytes, (void)n;
    return fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t n,
                                   fmi2FMUstate *state)
{
    (void)c, (void)bytes, (void)n, (void)state;
    return fmi2Error;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                        size_t n, const fmi2ValueReference known[], size_t m,
                                        const fmi2Real dk[], fmi2Real du[])
{
    (void)c, (void)unknown, (void)n, (void)known, (void)m, (void)dk, (void)du;
    return fmi2Error;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)c, (void)vr, (void)order, (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)c, (void)vr, (void)order, (void)value;
    return n ? fmi2Error : fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    (void)c;
    return fmi2Error;
}

#define NO_STATUS(name, type)                                                                      \
    fmi2Status fmi2Get##name(fmi2Component c, const fmi2StatusKind kind, type *value)              \
    {                                                                                              \
        (void)c, (void)kind, (void)value;                                                          \
        return fmi2Discard;                                                                        \
    }

NO_STATUS(Status, fmi2Status)
NO_STATUS(RealStatus, fmi2Real)
NO_STATUS(IntegerStatus, fmi2Integer)
NO_STATUS(BooleanStatus, fmi2Boolean)
NO_STATUS(StringStatus, fmi2String)
