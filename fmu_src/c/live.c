/* The FMU for a page in a browser: an importer with one instance and a numerical interface,
 * compiled to WebAssembly without imports. */
#include "all.c"

#define EXPORTED(name) __attribute__((export_name(#name))) name

static fmi2Component fmu;
static char heard[512];

/* Keep a message of the FMU. */
static void listen(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment;
    (void)instance;
    (void)status;
    (void)category;
    snprintf(heard, sizeof heard, "%s", message);
}

/* Last message of the FMU since the last reset, or an empty string. */
const char *EXPORTED(live_heard)(void) {
    return heard;
}

/* Return to the state before initialisation, with all start values. */
int EXPORTED(live_reset)(void) {
    static const fmi2CallbackFunctions host = {.logger = listen};
    heard[0] = '\0';
    if (!fmu) {
        char guid[sizeof numbers.guid];
        copy_guid(guid);
        fmu = fmi2Instantiate("live", fmi2CoSimulation, guid, NULL, &host, fmi2False, fmi2False);
    }
    return fmi2Reset(fmu);
}

/* Initialise; return the status, as the functions below. */
int EXPORTED(live_initialise)(void) {
    const fmi2Status status = fmi2EnterInitializationMode(fmu);
    if (status != fmi2OK) {
        return status;
    }
    return fmi2ExitInitializationMode(fmu);
}

/* Set a variable. */
int EXPORTED(live_set)(fmi2ValueReference reference, double value) {
    return fmi2SetReal(fmu, &reference, 1, &value);
}

/* Return a variable, NaN if it cannot be read. */
double EXPORTED(live_get)(fmi2ValueReference reference) {
    double value = NAN;
    fmi2GetReal(fmu, &reference, 1, &value);
    return value;
}

/* Step from a time [s] by a step [s]. */
int EXPORTED(live_step)(double time, double step) {
    return fmi2DoStep(fmu, time, step, fmi2True);
}
