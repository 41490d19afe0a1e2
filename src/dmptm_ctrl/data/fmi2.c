/* FMI 2.0 for co-simulation around @NAME@_step. */
#include <math.h>
#include <string.h>

#include "@NAME@.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT
#endif

#define INPUTS @INPUTS@
#define VALUES @VALUES@
#define SAMPLE_TIME @SAMPLE_TIME@
#define UNEVEN 1e-6 /* of a sample: rounding of the communication step */

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef void (*fmi2Logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
    fmi2Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    @NAME@_state state;
    double value[VALUES];
    const fmi2CallbackFunctions *callbacks;
} model;

static fmi2Status refuse(model *m, fmi2String message) {
    if (m->callbacks->logger != NULL) {
        m->callbacks->logger(
            m->callbacks->componentEnvironment, "@NAME@", fmi2Error, "error", "%s", message);
    }
    return fmi2Error;
}

/* Readings at the present time: those of a step that is not kept. */
static void read_sensors(model *m) {
    @NAME@_state trial = m->state;
    @NAME@_step(&trial, @ARGUMENTS@);
}

EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }

EXPORT fmi2Status fmi2SetDebugLogging(
    fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)c; (void)on; (void)n; (void)categories;
    return fmi2OK;
}

EXPORT fmi2Status fmi2Reset(fmi2Component c) {
    model *m = c;
    memset(m->value, 0, sizeof m->value);
    @NAME@_init(&m->state);
    return fmi2OK;
}

EXPORT fmi2Component fmi2Instantiate(
    fmi2String instance, fmi2Type type, fmi2String guid, fmi2String resources,
    const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    (void)instance; (void)resources; (void)visible; (void)logging;
    if (type != fmi2CoSimulation || strcmp(guid, "@GUID@") != 0) {
        return NULL;
    }
    model *m = callbacks->allocateMemory(1, sizeof(model));
    if (m != NULL) {
        m->callbacks = callbacks;
        fmi2Reset(m);
    }
    return m;
}

EXPORT void fmi2FreeInstance(fmi2Component c) {
    model *m = c;
    if (m != NULL) {
        m->callbacks->freeMemory(m);
    }
}

EXPORT fmi2Status fmi2SetupExperiment(
    fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
    fmi2Boolean has_stop, fmi2Real stop) {
    (void)c; (void)has_tolerance; (void)tolerance; (void)start; (void)has_stop; (void)stop;
    return fmi2OK;
}

EXPORT fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    read_sensors(c);
    return fmi2OK;
}

EXPORT fmi2Status fmi2Terminate(fmi2Component c) {
    (void)c;
    return fmi2OK;
}

EXPORT fmi2Status fmi2DoStep(
    fmi2Component c, fmi2Real now, fmi2Real size, fmi2Boolean no_way_back) {
    model *m = c;
    (void)now; (void)no_way_back;
    double samples = size / SAMPLE_TIME;
    if (!(fabs(samples - round(samples)) <= UNEVEN) || samples < 0.0) {
        return refuse(m, "the communication step must be a multiple of @SAMPLE_TIME@ s");
    }
    for (long k = 0; k < lround(samples); k++) {
        @NAME@_step(&m->state, @ARGUMENTS@);
    }
    read_sensors(m);
    return fmi2OK;
}

EXPORT fmi2Status fmi2GetReal(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    model *m = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= VALUES) {
            return refuse(m, "no variable of that reference");
        }
        value[k] = m->value[vr[k]];
    }
    return fmi2OK;
}

EXPORT fmi2Status fmi2SetReal(
    fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    model *m = c;
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= INPUTS) {
            return refuse(m, "no input of that reference");
        }
        m->value[vr[k]] = value[k];
    }
    return fmi2OK;
}

#define NONE_OF(function, type) \
    EXPORT fmi2Status function( \
        fmi2Component c, const fmi2ValueReference vr[], size_t n, type value[]) { \
        (void)vr; (void)value; \
        return n == 0 ? fmi2OK : refuse(c, "all variables are real"); \
    }

NONE_OF(fmi2GetInteger, fmi2Integer)
NONE_OF(fmi2GetBoolean, fmi2Boolean)
NONE_OF(fmi2GetString, fmi2String)
NONE_OF(fmi2SetInteger, const fmi2Integer)
NONE_OF(fmi2SetBoolean, const fmi2Boolean)
NONE_OF(fmi2SetString, const fmi2String)

#define NOT_OFFERED(function, arguments) \
    EXPORT fmi2Status function arguments { return fmi2Error; }

NOT_OFFERED(fmi2GetFMUstate, (fmi2Component c, void **s))
NOT_OFFERED(fmi2SetFMUstate, (fmi2Component c, void *s))
NOT_OFFERED(fmi2FreeFMUstate, (fmi2Component c, void **s))
NOT_OFFERED(fmi2SerializedFMUstateSize, (fmi2Component c, void *s, size_t *n))
NOT_OFFERED(fmi2SerializeFMUstate, (fmi2Component c, void *s, char b[], size_t n))
NOT_OFFERED(fmi2DeSerializeFMUstate, (fmi2Component c, const char b[], size_t n, void **s))
NOT_OFFERED(
    fmi2GetDirectionalDerivative,
    (fmi2Component c, const fmi2ValueReference u[], size_t nu, const fmi2ValueReference k[],
     size_t nk, const fmi2Real du[], fmi2Real dv[]))
NOT_OFFERED(
    fmi2SetRealInputDerivatives,
    (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
     const fmi2Real value[]))
NOT_OFFERED(
    fmi2GetRealOutputDerivatives,
    (fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[],
     fmi2Real value[]))
NOT_OFFERED(fmi2CancelStep, (fmi2Component c))
NOT_OFFERED(fmi2GetStatus, (fmi2Component c, int s, fmi2Status *value))
NOT_OFFERED(fmi2GetRealStatus, (fmi2Component c, int s, fmi2Real *value))
NOT_OFFERED(fmi2GetIntegerStatus, (fmi2Component c, int s, fmi2Integer *value))
NOT_OFFERED(fmi2GetBooleanStatus, (fmi2Component c, int s, fmi2Boolean *value))
NOT_OFFERED(fmi2GetStringStatus, (fmi2Component c, int s, fmi2String *value))
