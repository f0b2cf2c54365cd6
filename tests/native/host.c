/* A plain host for native FMUs, of FMI 2 or, with -DFMI=3, of FMI 3; for Linux, macOS and Windows.

   host LIBRARY TOKEN INPUT_VARIABLES INPUTS FIRST_OUTPUT OUTPUTS INPUT_TIME STEPS H ROUNDS [RESOURCES] < path

   Reads the path, INPUTS numbers for each of STEPS + 1 instants, and follows it, inputs belonging to the end of each
   step. Prints the outputs at all instants with all digits; with more than one round, the microseconds of a step and of
   an instantiation instead: the fastest round. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#ifdef _WIN32
#include <windows.h>
#define SYMBOL(library, name) ((void *)GetProcAddress(library, name))
#else
#include <dlfcn.h>
#define SYMBOL(library, name) dlsym(library, name)
#endif

#ifndef FMI
#define FMI 2
#endif
#if FMI == 2
#include "fmi2Functions.h"
#define PREFIX(name) fmi2##name
#define NAME(name) "fmi2" name
typedef fmi2ValueReference Reference;
typedef fmi2GetRealTYPE Getter;
typedef fmi2SetRealTYPE Setter;
#else
#include "fmi3Functions.h"
#define PREFIX(name) fmi3##name
#define NAME(name) "fmi3" name
typedef fmi3ValueReference Reference;
typedef fmi3GetFloat64TYPE Getter;
typedef fmi3SetFloat64TYPE Setter;
#endif

#define MOST 256

static double seconds(void)
{
#ifdef _WIN32
    return (double)clock() / CLOCKS_PER_SEC;
#else
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
#endif
}

#if FMI == 2
static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String text,
                   ...)
{
    va_list values;
    va_start(values, text);
    vfprintf(stderr, text, values);
    va_end(values);
    fputc('\n', stderr);
}
#else
static void logger(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String text)
{
    fprintf(stderr, "%s\n", text);
}
#endif

int main(int count, char **words)
{
    Reference references[MOST];
    double *path, outputs[MOST], fastest = 1e300, quickest = 1e300;
    if (count < 11) return 1;
    const char *resources = count > 11 ? words[11] : "";
    const size_t variables = (size_t)atoi(words[3]), inputs = (size_t)atoi(words[4]), first = (size_t)atoi(words[5]);
    const size_t results = (size_t)atoi(words[6]);
    const Reference choice = (Reference)atoi(words[7]);
    const long steps = atol(words[8]), rounds = atol(words[10]);
    const double h = atof(words[9]);
    for (Reference k = 0; k < MOST; k++) references[k] = k;
    path = malloc(sizeof(double) * inputs * (size_t)(steps + 1));
    for (size_t k = 0; k < inputs * (size_t)(steps + 1); k++)
        if (scanf("%lf", path + k) != 1) return 1;
#ifdef _WIN32
    HMODULE library = LoadLibraryA(words[1]);
#else
    void *library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) fprintf(stderr, "%s\n", dlerror());
#endif
    if (library == NULL) return 2;
    PREFIX(EnterInitializationModeTYPE) *enter = SYMBOL(library, NAME("EnterInitializationMode"));
    PREFIX(ExitInitializationModeTYPE) *leave = SYMBOL(library, NAME("ExitInitializationMode"));
    PREFIX(FreeInstanceTYPE) *discard = SYMBOL(library, NAME("FreeInstance"));
    PREFIX(DoStepTYPE) *step = SYMBOL(library, NAME("DoStep"));
#if FMI == 2
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    fmi2InstantiateTYPE *instantiate = SYMBOL(library, "fmi2Instantiate");
    fmi2SetIntegerTYPE *choose = SYMBOL(library, "fmi2SetInteger");
    fmi2SetupExperimentTYPE *setup = SYMBOL(library, "fmi2SetupExperiment");
    Getter *get = SYMBOL(library, "fmi2GetReal");
    Setter *set = SYMBOL(library, "fmi2SetReal");
    const fmi2Integer end = 2;
#define INSTANTIATE instantiate("host", fmi2CoSimulation, words[2], resources, &callbacks, 0, 0)
#define CHOOSE(c) choose(c, &choice, 1, &end)
#define ENTER(c) (setup(c, 0, 0.0, 0.0, 0, 0.0) || enter(c))
#define SET(c, values) set(c, references, inputs, values)
#define GET(c, values) get(c, references + first, results, values)
#define STEP(c, t) step(c, t, h, 1)
#else
    fmi3InstantiateCoSimulationTYPE *instantiate = SYMBOL(library, "fmi3InstantiateCoSimulation");
    fmi3SetInt64TYPE *choose = SYMBOL(library, "fmi3SetInt64");
    Getter *get = SYMBOL(library, "fmi3GetFloat64");
    Setter *set = SYMBOL(library, "fmi3SetFloat64");
    const fmi3Int64 end = 2;
    fmi3Boolean event, over, early;
    fmi3Float64 last;
#define INSTANTIATE instantiate("host", words[2], resources, 0, 0, 0, 0, NULL, 0, NULL, logger, NULL)
#define CHOOSE(c) choose(c, &choice, 1, &end, 1)
#define ENTER(c) enter(c, 0, 0.0, 0.0, 0, 0.0)
#define SET(c, values) set(c, references, variables, values, inputs)
#define GET(c, values) get(c, references + first, results, values, results)
#define STEP(c, t) step(c, t, h, 1, &event, &over, &early, &last)
#endif
    for (long round = 0; round < rounds; round++) {
        double begin = seconds(), taken;
        void *c = INSTANTIATE;
        if (c == NULL) return 3;
        taken = seconds() - begin;
        if (taken < quickest) quickest = taken;
        if ((choice < 1000 && CHOOSE(c)) || ENTER(c) || SET(c, path) || leave(c)) return 4;
        begin = seconds();
        for (long k = 0; k <= steps; k++) {
            if (k > 0 && (SET(c, path + (size_t)k * inputs) || STEP(c, (double)(k - 1) * h) > 1)) return 5;
            if (GET(c, outputs)) return 6;
            for (size_t i = 0; i < results && rounds == 1; i++) printf("%.17g%c", outputs[i], i + 1 < results ? ' ' : '\n');
        }
        taken = (seconds() - begin) / (double)steps;
        if (taken < fastest) fastest = taken;
        discard(c);
    }
    if (rounds > 1) printf("%.4f %.4f\n", 1e6 * fastest, 1e6 * quickest);
    return 0;
}
