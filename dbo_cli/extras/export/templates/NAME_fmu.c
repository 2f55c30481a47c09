/*? timed */
/* FMI 2.0 co-simulation of NAME: one step of the model a communication step (or a whole number of them).
/*: timed */
/*? !timed */
/* FMI 2.0 co-simulation of NAME: time plays no part, one step of the model a communication step of any length.
/*: timed */
 * The types are those of the standard's fmi2TypesPlatform.h, "default". */
#include "NAME.h"

#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT
#endif

typedef unsigned int reference;
typedef int boolean;
typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } status;

typedef struct {
    NAME_state model;
    double input;
    double output;
    double initial_drive;
    boolean settled;
} unit;

enum { INPUT = 1, OUTPUT = 2, INITIAL_DRIVE = 3, SETTLED = 4 };

static void fresh(unit *u) {
    memset(u, 0, sizeof *u);
    NAME_init(&u->model);
    u->output = u->model.output;
    u->initial_drive = START_DRIVE;
}

EXPORT const char *fmi2GetTypesPlatform(void);
const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void);
const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT status fmi2SetDebugLogging(void *u, boolean on, size_t count, const char *const names[]);
status fmi2SetDebugLogging(void *u, boolean on, size_t count, const char *const names[]) {
    (void)u, (void)on, (void)count, (void)names;
    return STATUS_OK;
}

EXPORT void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                             const void *functions, boolean visible, boolean logging);
void *fmi2Instantiate(const char *name, int kind, const char *guid, const char *resources,
                      const void *functions, boolean visible, boolean logging) {
    unit *u = NULL;
    (void)name, (void)resources, (void)functions, (void)visible, (void)logging;
    if (kind == 1 && guid != NULL && strcmp(guid, "GUID") == 0) u = (unit *)malloc(sizeof *u);
    if (u != NULL) fresh(u);
    return u;
}

EXPORT void fmi2FreeInstance(void *u);
void fmi2FreeInstance(void *u) { free(u); }

EXPORT status fmi2SetupExperiment(void *u, boolean tolerant, double tolerance, double start, boolean stops,
                                  double stop);
status fmi2SetupExperiment(void *u, boolean tolerant, double tolerance, double start, boolean stops,
                           double stop) {
    (void)u, (void)tolerant, (void)tolerance, (void)start, (void)stops, (void)stop;
    return STATUS_OK;
}

EXPORT status fmi2EnterInitializationMode(void *u);
status fmi2EnterInitializationMode(void *u) {
    (void)u;
    return STATUS_OK;
}

EXPORT status fmi2ExitInitializationMode(void *instance);
status fmi2ExitInitializationMode(void *instance) {
    unit *u = (unit *)instance;
    if (u->settled)
        NAME_reset(&u->model, u->initial_drive);
    else
        NAME_init(&u->model);
    u->output = u->model.output;
    return STATUS_OK;
}

EXPORT status fmi2Terminate(void *u);
status fmi2Terminate(void *u) {
    (void)u;
    return STATUS_OK;
}

EXPORT status fmi2Reset(void *u);
status fmi2Reset(void *u) {
    fresh((unit *)u);
    return STATUS_OK;
}

EXPORT status fmi2GetReal(void *instance, const reference at[], size_t count, double values[]);
status fmi2GetReal(void *instance, const reference at[], size_t count, double values[]) {
    const unit *u = (const unit *)instance;
    for (size_t i = 0; i < count; i++) {
        if (at[i] == INPUT)
            values[i] = u->input;
        else if (at[i] == OUTPUT)
            values[i] = u->output;
        else if (at[i] == INITIAL_DRIVE)
            values[i] = u->initial_drive;
        else
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

EXPORT status fmi2SetReal(void *instance, const reference at[], size_t count, const double values[]);
status fmi2SetReal(void *instance, const reference at[], size_t count, const double values[]) {
    unit *u = (unit *)instance;
    for (size_t i = 0; i < count; i++) {
        if (at[i] == INPUT)
            u->input = values[i];
        else if (at[i] == INITIAL_DRIVE)
            u->initial_drive = values[i];
        else
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

EXPORT status fmi2GetBoolean(void *instance, const reference at[], size_t count, boolean values[]);
status fmi2GetBoolean(void *instance, const reference at[], size_t count, boolean values[]) {
    for (size_t i = 0; i < count; i++) {
        if (at[i] != SETTLED) return STATUS_ERROR;
        values[i] = ((const unit *)instance)->settled;
    }
    return STATUS_OK;
}

EXPORT status fmi2SetBoolean(void *instance, const reference at[], size_t count, const boolean values[]);
status fmi2SetBoolean(void *instance, const reference at[], size_t count, const boolean values[]) {
    for (size_t i = 0; i < count; i++) {
        if (at[i] != SETTLED) return STATUS_ERROR;
        ((unit *)instance)->settled = values[i];
    }
    return STATUS_OK;
}

/* There are no variables of these kinds. */
#define NONE_OF(KIND, TYPE)                                                                           \
    EXPORT status fmi2Get##KIND(void *u, const reference at[], size_t count, TYPE values[]);          \
    status fmi2Get##KIND(void *u, const reference at[], size_t count, TYPE values[]) {                \
        (void)u, (void)at, (void)values;                                                              \
        return count == 0 ? STATUS_OK : STATUS_ERROR;                                                 \
    }                                                                                                 \
    EXPORT status fmi2Set##KIND(void *u, const reference at[], size_t count, TYPE const values[]);    \
    status fmi2Set##KIND(void *u, const reference at[], size_t count, TYPE const values[]) {          \
        (void)u, (void)at, (void)values;                                                              \
        return count == 0 ? STATUS_OK : STATUS_ERROR;                                                 \
    }
NONE_OF(Integer, int)
NONE_OF(String, const char *)

EXPORT status fmi2GetFMUstate(void *u, void **state);
status fmi2GetFMUstate(void *u, void **state) {
    if (*state == NULL) *state = malloc(sizeof(unit));
    if (*state == NULL) return STATUS_ERROR;
    memcpy(*state, u, sizeof(unit));
    return STATUS_OK;
}

EXPORT status fmi2SetFMUstate(void *u, void *state);
status fmi2SetFMUstate(void *u, void *state) {
    memcpy(u, state, sizeof(unit));
    return STATUS_OK;
}

EXPORT status fmi2FreeFMUstate(void *u, void **state);
status fmi2FreeFMUstate(void *u, void **state) {
    (void)u;
    free(*state);
    *state = NULL;
    return STATUS_OK;
}

EXPORT status fmi2SerializedFMUstateSize(void *u, void *state, size_t *size);
status fmi2SerializedFMUstateSize(void *u, void *state, size_t *size) {
    (void)u, (void)state;
    *size = sizeof(unit);
    return STATUS_OK;
}

EXPORT status fmi2SerializeFMUstate(void *u, void *state, char bytes[], size_t size);
status fmi2SerializeFMUstate(void *u, void *state, char bytes[], size_t size) {
    (void)u;
    if (size < sizeof(unit)) return STATUS_ERROR;
    memcpy(bytes, state, sizeof(unit));
    return STATUS_OK;
}

EXPORT status fmi2DeSerializeFMUstate(void *u, const char bytes[], size_t size, void **state);
status fmi2DeSerializeFMUstate(void *u, const char bytes[], size_t size, void **state) {
    (void)u;
    if (size < sizeof(unit)) return STATUS_ERROR;
    if (*state == NULL) *state = malloc(sizeof(unit));
    if (*state == NULL) return STATUS_ERROR;
    memcpy(*state, bytes, sizeof(unit));
    return STATUS_OK;
}

EXPORT status fmi2GetDirectionalDerivative(void *u, const reference a[], size_t an, const reference b[],
                                           size_t bn, const double d[], double out[]);
status fmi2GetDirectionalDerivative(void *u, const reference a[], size_t an, const reference b[], size_t bn,
                                    const double d[], double out[]) {
    (void)u, (void)a, (void)an, (void)b, (void)bn, (void)d, (void)out;
    return STATUS_ERROR;
}

EXPORT status fmi2SetRealInputDerivatives(void *u, const reference at[], size_t count, const int order[],
                                          const double values[]);
status fmi2SetRealInputDerivatives(void *u, const reference at[], size_t count, const int order[],
                                   const double values[]) {
    (void)u, (void)at, (void)count, (void)order, (void)values;
    return STATUS_ERROR;
}

EXPORT status fmi2GetRealOutputDerivatives(void *u, const reference at[], size_t count, const int order[],
                                           double values[]);
status fmi2GetRealOutputDerivatives(void *u, const reference at[], size_t count, const int order[],
                                    double values[]) {
    (void)u, (void)at, (void)count, (void)order, (void)values;
    return STATUS_ERROR;
}

EXPORT status fmi2DoStep(void *instance, double time, double step, boolean no_return);
status fmi2DoStep(void *instance, double time, double step, boolean no_return) {
    unit *u = (unit *)instance;
/*? timed */
    const double wanted = step / TIME_STEP;
    const long steps = wanted > 0.5 && wanted < 1e6 ? (long)(wanted + 0.5) : 0;
    (void)time, (void)no_return;
    if (steps == 0 || wanted - (double)steps > 1e-6 || (double)steps - wanted > 1e-6) return STATUS_ERROR;
    for (long k = 0; k < steps; k++) u->output = NAME_step(&u->model, u->input);
/*: timed */
/*? !timed */
    (void)time, (void)no_return;
    if (!(step > 0.0)) return STATUS_ERROR;
    u->output = NAME_step(&u->model, u->input);
/*: timed */
    return STATUS_OK;
}

EXPORT status fmi2CancelStep(void *u);
status fmi2CancelStep(void *u) {
    (void)u;
    return STATUS_ERROR;
}

#define NOT_PENDING(KIND, TYPE)                              \
    EXPORT status fmi2Get##KIND(void *u, int what, TYPE *value); \
    status fmi2Get##KIND(void *u, int what, TYPE *value) {   \
        (void)u, (void)what, (void)value;                    \
        return STATUS_DISCARD;                               \
    }
NOT_PENDING(Status, status)
NOT_PENDING(RealStatus, double)
NOT_PENDING(IntegerStatus, int)
NOT_PENDING(BooleanStatus, boolean)
NOT_PENDING(StringStatus, const char *)
