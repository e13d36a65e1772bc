/* An FMU (FMI 2.0) of a damped oscillator m x'' = force - c x' - k x: co-simulation by
   Runge-Kutta steps of a millisecond, and model exchange. Negative k or c is an error, k above 1e6
   a fatal one, after which no function may be called, and c below -100 is discarded, for ever. */
#include <stdlib.h>
#include "fmi2Functions.h"

enum { K, C, M, X_START, FORCE, X, V, DER_V, COUNT };
static const fmi2Real START[COUNT] = {8, 0.9, 2, 0, 0, 0, 0, 0};

typedef struct {
    fmi2Real value[COUNT];
    int fatal;
} Oscillator;

static fmi2Real acceleration(const Oscillator *o, fmi2Real x, fmi2Real v, fmi2Real force) {
    return (force - o->value[C] * v - o->value[K] * x) / o->value[M];
}

fmi2Status fmi2Reset(fmi2Component c) {
    Oscillator *o = c;
    if (o->fatal) abort();
    for (int i = 0; i < COUNT; i++) o->value[i] = START[i];
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String place,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
    Oscillator *o = calloc(1, sizeof *o);
    fmi2Reset(o);
    return o;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Oscillator *o = c;
    o->value[X] = o->value[X_START];
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n,
                       const fmi2Real value[]) {
    for (size_t i = 0; i < n; i++) ((Oscillator *)c)->value[vr[i]] = value[i];
    return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Oscillator *o = c;
    o->value[DER_V] = acceleration(o, o->value[X], o->value[V], o->value[FORCE]);
    for (size_t i = 0; i < n; i++) value[i] = o->value[vr[i]];
    return fmi2OK;
}

static fmi2Status judged(Oscillator *o) {
    if (o->value[C] < -100) return fmi2Discard;
    o->fatal = o->value[K] > 1e6;
    return o->fatal ? fmi2Fatal : o->value[K] < 0 || o->value[C] < 0 ? fmi2Error : fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real step, fmi2Boolean keep) {
    Oscillator *o = c;
    fmi2Status status = judged(o);
    int steps = (int)(step / 1e-3) + 1;
    fmi2Real h = step / steps, *x = &o->value[X], *v = &o->value[V];
    for (int i = 0; status == fmi2OK && i < steps; i++) {
        fmi2Real f = o->value[FORCE];
        fmi2Real a1 = acceleration(o, *x, *v, f), v2 = *v + h / 2 * a1;
        fmi2Real a2 = acceleration(o, *x + h / 2 * *v, v2, f), v3 = *v + h / 2 * a2;
        fmi2Real a3 = acceleration(o, *x + h / 2 * v2, v3, f), v4 = *v + h * a3;
        fmi2Real a4 = acceleration(o, *x + h * v3, v4, f);
        *x += h / 6 * (*v + 2 * v2 + 2 * v3 + v4);
        *v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
    }
    return status;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    info->newDiscreteStatesNeeded = info->terminateSimulation = fmi2False;
    info->nominalsOfContinuousStatesChanged = info->valuesOfContinuousStatesChanged = fmi2False;
    info->nextEventTimeDefined = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    ((Oscillator *)c)->value[X] = x[0];
    ((Oscillator *)c)->value[V] = x[1];
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = ((Oscillator *)c)->value[X];
    x[1] = ((Oscillator *)c)->value[V];
    return fmi2OK;
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    x[0] = x[1] = 1;
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real d[], size_t n) {
    Oscillator *o = c;
    d[0] = o->value[V];
    d[1] = acceleration(o, o->value[X], o->value[V], o->value[FORCE]);
    return judged(o);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean keep, fmi2Boolean *event,
                                       fmi2Boolean *end) {
    *event = *end = fmi2False;
    return fmi2OK;
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

/* What the standard demands besides, and nobody calls here. */
#define SILENT(name, ...) \
    fmi2Status name(fmi2Component c, ##__VA_ARGS__) { return fmi2OK; }
SILENT(fmi2SetDebugLogging, fmi2Boolean on, size_t n, const fmi2String categories[])
SILENT(fmi2SetupExperiment, fmi2Boolean given, fmi2Real tolerance, fmi2Real start,
       fmi2Boolean ends, fmi2Real stop)
SILENT(fmi2EnterInitializationMode)
SILENT(fmi2Terminate)
SILENT(fmi2EnterEventMode)
SILENT(fmi2EnterContinuousTimeMode)
SILENT(fmi2SetTime, fmi2Real t)
SILENT(fmi2GetEventIndicators, fmi2Real z[], size_t n)
SILENT(fmi2CancelStep)
#define VALUES(name, type) \
    SILENT(name, const fmi2ValueReference vr[], size_t n, type value[])
VALUES(fmi2GetInteger, fmi2Integer)
VALUES(fmi2GetBoolean, fmi2Boolean)
VALUES(fmi2GetString, fmi2String)
VALUES(fmi2SetInteger, const fmi2Integer)
VALUES(fmi2SetBoolean, const fmi2Boolean)
VALUES(fmi2SetString, const fmi2String)
SILENT(fmi2GetFMUstate, fmi2FMUstate *state)
SILENT(fmi2SetFMUstate, fmi2FMUstate state)
SILENT(fmi2FreeFMUstate, fmi2FMUstate *state)
SILENT(fmi2SerializedFMUstateSize, fmi2FMUstate state, size_t *size)
SILENT(fmi2SerializeFMUstate, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
SILENT(fmi2DeSerializeFMUstate, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
SILENT(fmi2GetDirectionalDerivative, const fmi2ValueReference u[], size_t nu,
       const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[])
SILENT(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n,
       const fmi2Integer order[], const fmi2Real value[])
SILENT(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n,
       const fmi2Integer order[], fmi2Real value[])
SILENT(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
SILENT(fmi2GetRealStatus, const fmi2StatusKind kind, fmi2Real *value)
SILENT(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
SILENT(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
