/* The FMU's binary. In a process where Python runs it forwards every FMI function to PythonFMU's binary beside it, in any
   other to the native library of the slave: no Python is needed there.

   PythonFMU's binary undoes no escape of an address but %20 and trusts every pointer. This one undoes all escapes,
   compares the GUID, logs the reason if an instance cannot be made, and refuses null pointers.
   shim_config.h is written at build: FMU_GUID, REAL_BINARY (PythonFMU's, a file name) and LIBRARY (the path from the
   folder of this binary). */

#define _GNU_SOURCE
#include <ctype.h>
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "shim_config.h"

#define LONGEST 4096 /* of paths and sentences */

/* --- the functions that are forwarded ---------------------------------------------------------------------------- */

#define FUNCTIONS(APPLY)                                                                                               \
    APPLY(Instantiate) APPLY(FreeInstance) APPLY(SetDebugLogging) APPLY(SetupExperiment)                               \
    APPLY(EnterInitializationMode) APPLY(ExitInitializationMode) APPLY(Terminate) APPLY(Reset)                         \
    APPLY(GetReal) APPLY(GetInteger) APPLY(GetBoolean) APPLY(GetString)                                                \
    APPLY(SetReal) APPLY(SetInteger) APPLY(SetBoolean) APPLY(SetString)                                                \
    APPLY(GetFMUstate) APPLY(SetFMUstate) APPLY(FreeFMUstate)                                                          \
    APPLY(SerializedFMUstateSize) APPLY(SerializeFMUstate) APPLY(DeSerializeFMUstate)                                  \
    APPLY(GetDirectionalDerivative) APPLY(SetRealInputDerivatives) APPLY(GetRealOutputDerivatives)                     \
    APPLY(DoStep) APPLY(CancelStep) APPLY(GetStatus) APPLY(GetRealStatus) APPLY(GetIntegerStatus)                      \
    APPLY(GetBooleanStatus) APPLY(GetStringStatus)

#define MEMBER(name) fmi2##name##TYPE *name;
static struct {
    FUNCTIONS(MEMBER)
} real;

static char not_loaded[LONGEST]; /* the reason if the library is not loaded */

#define SAY(text, ...) snprintf(text, LONGEST, __VA_ARGS__)

/* The logger takes a format: percent signs are doubled. */
static void report(const fmi2CallbackFunctions *functions, fmi2String instance, const char *text) {
    char escaped[2 * LONGEST + 1];
    size_t k = 0;
    for (; *text && k < 2 * LONGEST - 1; text++) {
        if (*text == '%') escaped[k++] = '%';
        escaped[k++] = *text;
    }
    escaped[k] = '\0';
    functions->logger(functions->componentEnvironment, instance, fmi2Error, "logStatusError", escaped);
}

/* --- the library behind ------------------------------------------------------------------------------------------- */

/* PythonFMU 0.7 gives its hold on Python back twice when the process ends, the second time from freed memory: now and
   then the process was killed at its very end. Called before the end, it does nothing at the end. */
static void (*give_back_python)(void);

static void at_the_end(void) { give_back_python(); }

static int python_runs(void) {
    int (*running)(void) = (int (*)(void))dlsym(RTLD_DEFAULT, "Py_IsInitialized");
    return running && running();
}

__attribute__((constructor)) static void open_real(void) {
    Dl_info self;
    char path[LONGEST];
    const char *slash = dladdr((void *)&real, &self) && self.dli_fname ? strrchr(self.dli_fname, '/') : NULL;
    const int folder = slash ? (int)(slash - self.dli_fname) + 1 : 0;
    snprintf(path, sizeof path, "%.*s%s", folder, slash ? self.dli_fname : "", python_runs() ? REAL_BINARY : LIBRARY);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        SAY(not_loaded, "the second binary of the FMU does not load: %s", dlerror());
        return;
    }
#define FIND(name) real.name = (fmi2##name##TYPE *)dlsym(library, "fmi2" #name);
    FUNCTIONS(FIND)
    give_back_python = (void (*)(void))dlsym(library, "finalizePythonInterpreter");
    if (give_back_python) atexit(at_the_end); /* runs before what the library has registered while it was opened */
}

/* Python makes a text of valid UTF-8 only. */
static int is_utf8(const char *text) {
    const unsigned char *t = (const unsigned char *)text;
    while (*t) {
        const int more = *t < 0x80 ? 0 : *t >= 0xC2 && *t < 0xE0 ? 1 : *t >= 0xE0 && *t < 0xF0 ? 2 : 3;
        const unsigned char low = *t == 0xE0 ? 0xA0 : *t == 0xF0 ? 0x90 : 0x80; /* of the second byte */
        const unsigned char high = *t == 0xED ? 0x9F : *t == 0xF4 ? 0x8F : 0xBF;
        if (*t >= 0x80 && (*t < 0xC2 || *t > 0xF4 || t[1] < low || t[1] > high)) return 0;
        for (int k = 2; k <= more; k++)
            if ((t[k] & 0xC0) != 0x80) return 0;
        t += more + 1;
    }
    return 1;
}

/* --- calls of the host ------------------------------------------------------------------------------------------- */

/* Equal to FMU_GUID, which has braces, but for braces. */
static int is_ours(const char *guid) {
    const size_t length = strlen(guid), own = strlen(FMU_GUID);
    const int braces = length >= 2 && guid[0] == '{' && guid[length - 1] == '}';
    return length + 2 * (size_t)!braces == own && !strncmp(guid + braces, &FMU_GUID[1], own - 2);
}

/* Write file:// and the plain path of an address file:///a%20b, file:/a%20b, file://localhost/a%20b, or of a path. */
static int plain_location(const char *address, char *plain, char *why) {
    const int is_address = !strncmp(address, "file:", 5);
    size_t k = 7;
    strcpy(plain, "file://");
    if (is_address) address += 5;
    if (is_address && !strncmp(address, "//", 2)) {
        address = strchr(address + 2, '/'); /* behind the name of the machine, which is empty or localhost */
        if (!address) address = "";
    }
    for (; *address && k < LONGEST - 1; address++) {
        const unsigned char *code = (const unsigned char *)address + 1;
        const int escapes = is_address && *address == '%' && isxdigit(code[0]) && isxdigit(code[1]);
        plain[k++] = escapes ? (char)strtol((const char[]){address[1], address[2], '\0'}, NULL, 16) : *address;
        if (escapes) address += 2;
    }
    plain[k] = '\0';
    if (*address || k == 7 || strlen(plain) != k)
        SAY(why, "the resource location that the host gives is empty, too long or no path");
    else if (!is_utf8(plain))
        SAY(why, "the FMU is unpacked into a folder whose name is not UTF-8; it cannot be used from there");
    else if (strstr(plain, "%20"))
        SAY(why, "the FMU is unpacked into %s; a folder with %%20 in its name cannot be used", plain + 7);
    else
        return 1;
    return 0;
}

/* --- FMI ---------------------------------------------------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instance, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    char why[LONGEST] = "", plain[LONGEST];
    if (!functions || !functions->logger) return NULL;
    if (!instance || !is_utf8(instance)) instance = "";
    if (type != fmi2CoSimulation)
        SAY(why, "the FMU offers co-simulation only");
    else if (!guid || !is_ours(guid))
        SAY(why, "the host's description of the FMU has the GUID %s, its binary %s", guid ? guid : "", FMU_GUID);
    else if (plain_location(location ? location : "", plain, why) && real.Instantiate)
        return real.Instantiate(instance, type, FMU_GUID, plain, functions, visible, logging);
    report(functions, instance, *why ? why : not_loaded);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) {
    if (c) real.FreeInstance(c);
}

#define FORWARD(name, parameters, arguments)                                                                           \
    fmi2Status fmi2##name parameters { return c && real.name ? real.name arguments : fmi2Error; }

typedef const fmi2ValueReference References[];

FORWARD(SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]), (c, on, n, names))
FORWARD(SetupExperiment, (fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real start,
                          fmi2Boolean has_stop, fmi2Real stop), (c, has_tolerance, tolerance, start, has_stop, stop))
FORWARD(EnterInitializationMode, (fmi2Component c), (c))
FORWARD(ExitInitializationMode, (fmi2Component c), (c))
FORWARD(Terminate, (fmi2Component c), (c))
FORWARD(Reset, (fmi2Component c), (c))
FORWARD(GetReal, (fmi2Component c, References vr, size_t n, fmi2Real values[]), (c, vr, n, values))
FORWARD(GetInteger, (fmi2Component c, References vr, size_t n, fmi2Integer values[]), (c, vr, n, values))
FORWARD(GetBoolean, (fmi2Component c, References vr, size_t n, fmi2Boolean values[]), (c, vr, n, values))
FORWARD(GetString, (fmi2Component c, References vr, size_t n, fmi2String values[]), (c, vr, n, values))
FORWARD(SetReal, (fmi2Component c, References vr, size_t n, const fmi2Real values[]), (c, vr, n, values))
FORWARD(SetInteger, (fmi2Component c, References vr, size_t n, const fmi2Integer values[]), (c, vr, n, values))
FORWARD(SetBoolean, (fmi2Component c, References vr, size_t n, const fmi2Boolean values[]), (c, vr, n, values))
FORWARD(GetDirectionalDerivative, (fmi2Component c, References unknown, size_t m, References known, size_t n,
                                   const fmi2Real dknown[], fmi2Real dunknown[]),
        (c, unknown, m, known, n, dknown, dunknown))
FORWARD(SetRealInputDerivatives, (fmi2Component c, References vr, size_t n, const fmi2Integer order[],
                                  const fmi2Real values[]), (c, vr, n, order, values))
FORWARD(GetRealOutputDerivatives, (fmi2Component c, References vr, size_t n, const fmi2Integer order[],
                                   fmi2Real values[]), (c, vr, n, order, values))
FORWARD(DoStep, (fmi2Component c, fmi2Real time, fmi2Real h, fmi2Boolean no_going_back), (c, time, h, no_going_back))
FORWARD(CancelStep, (fmi2Component c), (c))
FORWARD(GetStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Status *value), (c, kind, value))
FORWARD(GetRealStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Real *value), (c, kind, value))
FORWARD(GetIntegerStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value), (c, kind, value))
FORWARD(GetBooleanStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value), (c, kind, value))
FORWARD(GetStringStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2String *value), (c, kind, value))

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String values[]) {
    for (size_t k = 0; k < n; k++)
        if (!values || !values[k] || !is_utf8(values[k])) return fmi2Error;
    return c && real.SetString ? real.SetString(c, vr, n, values) : fmi2Error;
}

/* PythonFMU takes every state for a living one: a null pointer would end the host. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c || !state || !real.GetFMUstate) return fmi2Error;
    fmi2FMUstate before = *state; /* a state to be reused */
    *state = NULL;
    const fmi2Status status = real.GetFMUstate(c, state);
    if (before && real.FreeFMUstate) real.FreeFMUstate(c, &before);
    return status;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c || !state || !real.FreeFMUstate) return fmi2Error;
    const fmi2Status status = *state ? real.FreeFMUstate(c, state) : fmi2OK;
    *state = NULL;
    return status;
}

#define WITH_STATE(name, parameters, arguments)                                                                        \
    fmi2Status fmi2##name parameters { return c && state && real.name ? real.name arguments : fmi2Error; }

WITH_STATE(SetFMUstate, (fmi2Component c, fmi2FMUstate state), (c, state))
WITH_STATE(SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size), (c, state, size))
WITH_STATE(SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size),
           (c, state, bytes, size))
WITH_STATE(DeSerializeFMUstate, (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state),
           (c, bytes, size, state))
