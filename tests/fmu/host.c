/* A host that calls every function of an FMU in random order, mostly with right arguments.
 * It fails if the FMU crashes, which a sanitizer makes of every error of memory. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2.h"
#include "interface.h"

enum { INSTANCES = 4, CALLS = 300000, MOST = 5 };

typedef struct {
    fmi2Component c;
    fmi2FMUstate state;
    double time;
} Slave;

static uint64_t seed = 88172645463325252u;
static size_t messages, steps, size_of_state;
static fmi2Byte bytes[1 << 16];

static unsigned below(unsigned n) {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return (unsigned)(seed % n);
}

static double number(void) {
    static const double odd[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 5e-324, 0.0};
    return below(200) ? (below(2001) - 1000.0) / 500.0 : odd[below(7)];
}

static fmi2ValueReference reference(void) {
    fmi2ValueReference vr = below(VARIABLES);
    while (below(200) && variables[vr].role != INPUT) {
        vr = below(VARIABLES);
    }
    return below(500) ? vr : vr + VARIABLES;
}

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status,
                   fmi2String category, fmi2String message, ...) {
    (void)environment, (void)instance, (void)status, (void)category;
    messages += message[0] != 0;
}

static fmi2Component instantiate(void) {
    static const fmi2CallbackFunctions host = {logger, NULL, NULL, NULL, NULL};
    return fmi2Instantiate(below(9) ? "host" : NULL,
                           below(9) ? fmi2CoSimulation : fmi2ModelExchange,
                           below(9) ? MODEL_GUID : "{}", NULL, below(2) ? &host : NULL, 0, 0);
}

static void release(Slave *slave) {
    fmi2FreeFMUstate(slave->c, &slave->state);
    fmi2FreeInstance(slave->c);
    slave->c = NULL;
}

/* Calls that a slave in good order survives. */
static void use(Slave *slave, const fmi2ValueReference *vr, size_t n, fmi2Real *real) {
    fmi2Integer order[MOST];
    fmi2Component c = slave->c;
    for (int k = 0; k < MOST; k++) {
        order[k] = below(100) ? 1 : 2;
    }
    switch (below(10)) {
    case 0:
        fmi2GetReal(c, below(100) ? vr : NULL, n, real);
        break;
    case 1:
        fmi2SetRealInputDerivatives(c, vr, n, below(50) ? order : NULL, real);
        break;
    case 2:
        fmi2GetFMUstate(c, &slave->state);
        break;
    case 3:
        fmi2SetFMUstate(c, slave->state);
        break;
    case 4:
    case 5:
        fmi2SetReal(c, vr, n, real);
        break;
    default:
        steps += fmi2DoStep(c, below(50) ? slave->time : real[0], below(50) ? 1e-3 : real[1],
                            fmi2True) == fmi2OK;
        slave->time += 1e-3;
    }
}

/* The others, some of which end the simulation of a slave. */
static void disturb(Slave *slave, const fmi2ValueReference *vr, size_t n, fmi2Real *real) {
    fmi2Component c = slave->c;
    fmi2Integer integer[MOST] = {1, 2, -1, 0, 3};
    fmi2String string[MOST] = {"logStatusError", "", NULL, "x", "y"};
    fmi2Status status;
    const size_t few = below(5) ? 0 : n;
    switch (below(30)) {
    case 0:
        fmi2SetupExperiment(c, 1, real[0], real[1], below(2), real[2]);
        break;
    case 1:
        fmi2EnterInitializationMode(c);
        break;
    case 2:
        fmi2ExitInitializationMode(c);
        break;
    case 3:
        fmi2Terminate(c);
        break;
    case 4:
        fmi2GetInteger(c, vr, few, integer);
        break;
    case 5:
        fmi2GetBoolean(c, vr, few, integer);
        break;
    case 6:
        fmi2GetString(c, vr, few, string);
        break;
    case 7:
        fmi2SetInteger(c, vr, few, integer);
        break;
    case 8:
        fmi2SetBoolean(c, vr, few, integer);
        break;
    case 9:
        fmi2SetString(c, vr, few, string);
        break;
    case 10:
        fmi2FreeFMUstate(c, &slave->state);
        break;
    case 11:
        fmi2SerializedFMUstateSize(c, slave->state, &size_of_state);
        break;
    case 12:
        fmi2SerializeFMUstate(c, slave->state, bytes,
                              size_of_state <= sizeof bytes ? size_of_state : 0);
        break;
    case 13:
        fmi2DeSerializeFMUstate(c, bytes, below(9) ? size_of_state : 3, &slave->state);
        break;
    case 14:
        fmi2GetDirectionalDerivative(c, vr, few, vr, n, real, real);
        break;
    case 15:
        fmi2GetRealOutputDerivatives(c, vr, few, integer, real);
        break;
    case 16:
        fmi2CancelStep(c);
        break;
    case 17:
        fmi2GetStatus(c, fmi2DoStepStatus, &status);
        break;
    case 18:
        fmi2GetRealStatus(c, fmi2LastSuccessfulTime, below(3) ? real : NULL);
        break;
    case 19:
        fmi2GetIntegerStatus(c, fmi2DoStepStatus, integer);
        break;
    case 20:
        fmi2GetBooleanStatus(c, fmi2Terminated, integer);
        break;
    case 21:
        fmi2GetStringStatus(c, fmi2PendingStatus, string);
        break;
    case 22:
        fmi2SetDebugLogging(c, fmi2True, n, string);
        break;
    case 23:
        fmi2GetVersion(), fmi2GetTypesPlatform();
        break;
    case 24:
        release(slave);
        break;
    default:
        fmi2Reset(c);
        fmi2EnterInitializationMode(c);
        fmi2ExitInitializationMode(c);
    }
}

int main(void) {
    static Slave slaves[INSTANCES];
    for (int call = 0; call < CALLS; call++) {
        Slave *slave = &slaves[below(INSTANCES)];
        fmi2ValueReference vr[MOST];
        fmi2Real real[MOST];
        for (int k = 0; k < MOST; k++) {
            vr[k] = reference();
            real[k] = number();
        }
        if (!slave->c && below(9)) {
            slave->c = instantiate();
        }
        (below(4) ? use : disturb)(slave, vr, below(MOST + 1), real);
    }
    for (int i = 0; i < INSTANCES; i++) {
        release(&slaves[i]);
    }
    /* The walk has been through both working and failing states. */
    printf("%lu steps, %lu messages\n", (unsigned long)steps, (unsigned long)messages);
    return steps < CALLS / 30 || messages < CALLS / 30;
}
