/* The FMU's binary: forwards every FMI function to PythonFMU's binary beside it.

   PythonFMU's binary needs Python in the process, undoes no escape of an address but %20 and trusts every pointer.
   This one opens libpython where the host has none, undoes all escapes, compares the GUID, tells the host's logger
   in a sentence why an instance cannot be made, and refuses null pointers. shim_config.h is written at build:
   FMU_GUID, REAL_BINARY (a file name), REQUIRED_PACKAGES and PYTHON_LIBRARIES (what to try, best first).

   Environment, for hosts that are not Python:
     CRANE_FMU_LIBPYTHON  the Python library to open, a file or a name; nothing else is tried then
     CRANE_FMU_PYTHON     the Python interpreter whose packages are used, for instance that of a virtual environment */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <wchar.h>

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

static pthread_mutex_t loading = PTHREAD_MUTEX_INITIALIZER;
static int loaded;

/* --- sentences ---------------------------------------------------------------------------------------------------- */

static void sentence(char *text, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, LONGEST, format, arguments);
    va_end(arguments);
}

/* The logger takes a format: percent signs are doubled. */
static void tell(const fmi2CallbackFunctions *functions, fmi2String instance, const char *text) {
    char escaped[2 * LONGEST + 1];
    size_t k = 0;
    for (; *text && k < 2 * LONGEST - 1; text++) {
        if (*text == '%') escaped[k++] = '%';
        escaped[k++] = *text;
    }
    escaped[k] = '\0';
    functions->logger(functions->componentEnvironment, instance, fmi2Error, "logStatusError", escaped);
}

/* --- Python ------------------------------------------------------------------------------------------------------- */

static void *python(const char *name) { return dlsym(RTLD_DEFAULT, name); }

/* The folder of the version that an environment is made of, as in lib/python3.12/site-packages, or an empty text. */
static void version_of(const char *interpreter, char *version) {
    static const char *const known[] = {"3.13", "3.12", "3.11"};
    char path[LONGEST];
    const char *slash = strrchr(interpreter, '/');
    const int folder = slash ? (int)(slash - interpreter) : 0;
    version[0] = '\0';
    for (size_t k = 0; slash && k < sizeof known / sizeof *known; k++) {
        snprintf(path, sizeof path, "%.*s/../lib/python%s/site-packages", folder, interpreter, known[k]);
        if (!access(path, R_OK)) strcpy(version, known[k]);
    }
}

static int is_program(const char *path) {
    struct stat found;
    return !stat(path, &found) && S_ISREG(found.st_mode) && !access(path, X_OK); /* folders may be "run" as well */
}

/* The interpreter that is asked for: CRANE_FMU_PYTHON, or that of the active virtual environment, or an empty text. */
static int chosen_interpreter(char *path, char *why) {
    const char *chosen = getenv("CRANE_FMU_PYTHON"), *environment = getenv("VIRTUAL_ENV");
    path[0] = '\0';
    if (chosen && *chosen) {
        snprintf(path, LONGEST, "%s", chosen);
        if (!is_program(path)) {
            sentence(why, "CRANE_FMU_PYTHON = %s is no program that can be run: it must be the path of a Python interpreter",
                     chosen);
            return 0;
        }
    } else if (environment && *environment) {
        snprintf(path, LONGEST, "%s/bin/python", environment);
        if (!is_program(path)) path[0] = '\0';
    }
    return 1;
}

/* Make the symbols of a Python library visible to PythonFMU's binary and to extension modules. */
static int open_python(char *why) {
    static const char *const candidates[] = {PYTHON_LIBRARIES};
    const size_t count = sizeof candidates / sizeof *candidates;
    const char *wanted = getenv("CRANE_FMU_LIBPYTHON");
    char interpreter[LONGEST], version[8], name[64];
    if (python("Py_Initialize")) return 1;
    if (!chosen_interpreter(interpreter, why)) return 0;
    if (wanted && *wanted) {
        if (dlopen(wanted, RTLD_NOW | RTLD_GLOBAL) && python("Py_Initialize")) return 1;
        const char *reason = dlerror();
        sentence(why, "CRANE_FMU_LIBPYTHON = %s is no Python library: %s", wanted, reason ? reason : "no Py_Initialize");
        return 0;
    }
    /* a host may have opened one for itself alone: two of them in a process would not do */
    for (size_t k = 0; k < count; k++)
        if (dlopen(candidates[k], RTLD_NOW | RTLD_GLOBAL | RTLD_NOLOAD) && python("Py_Initialize")) return 1;
    /* the environment that is asked for decides: packages of one version are of no use to another */
    version_of(interpreter, version);
    if (*version) {
        char real_path[LONGEST];
        snprintf(name, sizeof name, "libpython%s.so.1.0", version);
        for (size_t k = 0; k < count; k++)
            if (strstr(candidates[k], name) && dlopen(candidates[k], RTLD_NOW | RTLD_GLOBAL) && python("Py_Initialize"))
                return 1;
        if (realpath(interpreter, real_path) && strrchr(real_path, '/')) { /* beside the interpreter it was made of */
            char beside[2 * LONGEST];
            snprintf(beside, sizeof beside, "%.*s/../lib/%s", (int)(strrchr(real_path, '/') - real_path), real_path, name);
            if (dlopen(beside, RTLD_NOW | RTLD_GLOBAL) && python("Py_Initialize")) return 1;
        }
        sentence(why, "%s is Python %s, but no library %s was found: install it, or name it in the environment variable"
                      " CRANE_FMU_LIBPYTHON", interpreter, version, name);
        return 0;
    }
    for (size_t k = 0; k < count; k++)
        if (dlopen(candidates[k], RTLD_NOW | RTLD_GLOBAL) && python("Py_Initialize")) return 1;
    sentence(why, "the host has no Python and no Python library was found (tried %s first); name one in the environment"
                  " variable CRANE_FMU_LIBPYTHON", candidates[0]);
    return 0;
}

static char packages_of[LONGEST]; /* the interpreter that was asked for, for the sentence on what it lacks */

/* Let the interpreter find the packages of CRANE_FMU_PYTHON, or of the active virtual environment, or of the interpreter
   that the library belongs to: without that it would take those of any python3 on the search path. */
static void choose_packages(void) {
    void (*set_name)(const wchar_t *) = (void (*)(const wchar_t *))python("Py_SetProgramName");
    wchar_t *(*decode)(const char *, size_t *) = (wchar_t * (*)(const char *, size_t *)) python("Py_DecodeLocale");
    char path[LONGEST], unused[LONGEST];
    Dl_info library;
    if (!chosen_interpreter(path, unused)) return;
    strcpy(packages_of, path);
    if (!*path && dladdr(python("Py_Initialize"), &library) && library.dli_fname && strchr(library.dli_fname, '/')) {
        const int folder = (int)(strrchr(library.dli_fname, '/') - library.dli_fname);
        snprintf(path, sizeof path, "%.*s/../bin/python3", folder, library.dli_fname);
        if (access(path, X_OK)) return; /* Python looks for python3 on the search path itself */
    }
    if (!*path) return;
    wchar_t *name = set_name && decode ? decode(path, NULL) : NULL;
    if (name) set_name(name); /* Python keeps the pointer */
}

/* Start Python without its signal handlers. It is never ended: NumPy cannot be loaded a second time. */
static int start_python(char *why) {
    int (*running)(void) = (int (*)(void))python("Py_IsInitialized");
    void (*start)(int) = (void (*)(int))python("Py_InitializeEx");
    void *(*release)(void) = (void *(*)(void))python("PyEval_SaveThread");
    if (!running || !start || !release) {
        sentence(why, "the Python library in this process lacks functions that the FMU needs");
        return 0;
    }
    if (running()) return 1;
    int *utf8 = (int *)python("Py_UTF8Mode"); /* paths are UTF-8 whatever the host's locale says */
    if (utf8) *utf8 = 1;
    choose_packages();
    start(0);
    release();
    return 1;
}

/* Import what the FMU stands on. PythonFMU would meet a failure later, and harm the host's memory over it. */
static int import_packages(char *why) {
    static const char *const packages[] = {REQUIRED_PACKAGES};
    int (*hold)(void) = (int (*)(void))python("PyGILState_Ensure");
    void (*release)(int) = (void (*)(int))python("PyGILState_Release");
    void *(*import)(const char *) = (void *(*)(const char *))python("PyImport_ImportModule");
    void (*fetch)(void **, void **, void **) = (void (*)(void **, void **, void **))python("PyErr_Fetch");
    void *(*text)(void *) = (void *(*)(void *))python("PyObject_Str");
    const char *(*utf8)(void *) = (const char *(*)(void *))python("PyUnicode_AsUTF8");
    void (*give_back)(void *) = (void (*)(void *))python("Py_DecRef");
    if (!hold || !release || !import || !fetch || !text || !utf8 || !give_back) return 1;
    const int state = hold();
    int done = 1;
    for (size_t k = 0; done && k < sizeof packages / sizeof *packages; k++) {
        void *module = import(packages[k]), *error[3] = {NULL, NULL, NULL};
        if (module) {
            give_back(module);
            continue;
        }
        fetch(&error[0], &error[1], &error[2]);
        void *message = error[1] ? text(error[1]) : NULL;
        const char *reason = message ? utf8(message) : NULL;
        sentence(why, "the FMU needs a Python with ctypes, but importing %s%s%s failed: %s; name an interpreter that has it in the"
                      " environment variable CRANE_FMU_PYTHON", packages[k],
                 *packages_of ? " with the packages of " : "", packages_of, reason ? reason : "no reason given");
        give_back(message);
        for (int part = 0; part < 3; part++) give_back(error[part]);
        done = 0;
    }
    release(state);
    return done;
}

/* --- PythonFMU's binary ------------------------------------------------------------------------------------------- */

/* PythonFMU 0.7 gives its hold on Python back twice when the process ends, the second time from freed memory: now and
   then the process was killed at its very end. Asked to give it back before, it finds nothing to do later. */
static void (*give_back_python)(void);

static void at_the_end(void) { give_back_python(); }

static int open_real(char *why) {
    Dl_info self;
    char path[LONGEST];
    if (!dladdr((void *)&real, &self) || !self.dli_fname) {
        sentence(why, "the FMU's binary does not find its own folder");
        return 0;
    }
    const char *slash = strrchr(self.dli_fname, '/');
    const int folder = slash ? (int)(slash - self.dli_fname) + 1 : 0;
    snprintf(path, sizeof path, "%.*s%s", folder, self.dli_fname, REAL_BINARY);
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        sentence(why, "the second binary of the FMU does not load: %s", dlerror());
        return 0;
    }
#define FIND(name) real.name = (fmi2##name##TYPE *)dlsym(library, "fmi2" #name);
    FUNCTIONS(FIND)
    if (!real.Instantiate || !real.FreeInstance) {
        sentence(why, "%s is no FMI 2.0 binary", path);
        return 0;
    }
    give_back_python = (void (*)(void))dlsym(library, "finalizePythonInterpreter");
    if (give_back_python) atexit(at_the_end); /* runs before what the library has registered while it was opened */
    return 1;
}

static int load(char *why) {
    pthread_mutex_lock(&loading);
    if (!loaded) loaded = open_python(why) && start_python(why) && import_packages(why) && open_real(why);
    const int done = loaded;
    pthread_mutex_unlock(&loading);
    return done;
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

/* --- what the host says ------------------------------------------------------------------------------------------- */

/* Equal but for braces around them. */
static int same_guid(const char *given, const char *own) {
    const size_t length = strlen(given);
    const int braces = length >= 2 && given[0] == '{' && given[length - 1] == '}';
    return strlen(own) == length - 2 * (size_t)braces && !strncmp(given + braces, own, strlen(own));
}

static int digit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
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
        const int high = is_address && *address == '%' ? digit(address[1]) : -1;
        const int low = high >= 0 ? digit(address[2]) : -1;
        plain[k++] = low >= 0 ? (char)(16 * high + low) : *address;
        if (low >= 0) address += 2;
    }
    plain[k] = '\0';
    if (*address || k == 7 || strlen(plain) != k)
        sentence(why, "the resource location that the host gives is empty, too long or no path");
    else if (!is_utf8(plain))
        sentence(why, "the FMU is unpacked into a folder whose name is not UTF-8; it cannot be used from there");
    else if (strstr(plain, "%20"))
        sentence(why, "the FMU is unpacked into %s; a folder with %%20 in its name cannot be used", plain + 7);
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
        sentence(why, "the FMU offers co-simulation only");
    else if (!guid || !same_guid(guid, FMU_GUID))
        sentence(why, "the host's description of the FMU has the GUID %s, its binary %s", guid ? guid : "", FMU_GUID);
    else if (plain_location(location ? location : "", plain, why) && load(why))
        return real.Instantiate(instance, type, guid, plain, functions, visible, logging);
    tell(functions, instance, why);
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
    if (!c || !real.SetString) return fmi2Error;
    for (size_t k = 0; k < n; k++)
        if (!values || !values[k] || !is_utf8(values[k])) return fmi2Error;
    return real.SetString(c, vr, n, values);
}

/* PythonFMU takes every state for a living one: a null pointer would end the host. */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    if (!c || !state || !real.GetFMUstate) return fmi2Error;
    fmi2FMUstate before = *state; /* one that the host asks to be reused */
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
