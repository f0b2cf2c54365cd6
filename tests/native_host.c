/* A host that is not Python: ./native_host LIBRARY GUID LOCATION STEPS FIRST_OUTPUT OUTPUTS

   Loads the FMU's binary, initializes, takes steps of 0.1 s and prints the outputs at all times, one line each. Lines
   that begin with "log:" are what the FMU says. Exit codes: 0, 2 the library does not load, 3 no instance, 4 a step
   was refused. */

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"

static void logger(fmi2ComponentEnvironment environment, fmi2String instance, fmi2Status status, fmi2String category,
                   fmi2String message, ...) {
    va_list arguments;
    (void)environment, (void)instance, (void)category;
    printf("log: %d ", (int)status);
    va_start(arguments, message);
    vprintf(message, arguments);
    va_end(arguments);
    printf("\n");
}

static void print_outputs(fmi2GetRealTYPE *get, fmi2Component c, unsigned first, size_t count) {
    fmi2ValueReference references[64];
    fmi2Real values[64];
    for (size_t k = 0; k < count; k++) references[k] = first + (unsigned)k;
    if (get(c, references, count, values) != fmi2OK) exit(5);
    for (size_t k = 0; k < count; k++) printf("%.17g ", values[k]);
    printf("\n");
}

int main(int n, char **argument) {
    if (n != 7) return 1;
    void *library = dlopen(argument[1], RTLD_NOW | RTLD_LOCAL);
    if (!library) {
        printf("%s\n", dlerror());
        return 2;
    }
    const fmi2CallbackFunctions functions = {logger, calloc, free, NULL, NULL};
    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)dlsym(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = (fmi2SetupExperimentTYPE *)dlsym(library, "fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter = dlsym(library, "fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave = dlsym(library, "fmi2ExitInitializationMode");
    fmi2GetRealTYPE *get = (fmi2GetRealTYPE *)dlsym(library, "fmi2GetReal");
    fmi2DoStepTYPE *step = (fmi2DoStepTYPE *)dlsym(library, "fmi2DoStep");
    fmi2TerminateTYPE *terminate = (fmi2TerminateTYPE *)dlsym(library, "fmi2Terminate");
    fmi2FreeInstanceTYPE *discard = (fmi2FreeInstanceTYPE *)dlsym(library, "fmi2FreeInstance");
    const int steps = atoi(argument[4]);
    const unsigned first = (unsigned)atoi(argument[5]);
    const size_t count = (size_t)atoi(argument[6]);

    for (int round = 0; round < 2; round++) { /* a second instance after the first is gone */
        fmi2Component c = instantiate("crane", fmi2CoSimulation, argument[2], argument[3], &functions, 0, 1);
        if (!c) return 3;
        if (setup(c, 0, 0.0, 0.0, 0, 0.0) != fmi2OK || enter(c) != fmi2OK || leave(c) != fmi2OK) return 6;
        print_outputs(get, c, first, count);
        for (int k = 0; k < steps; k++) {
            if (step(c, 0.1 * k, 0.1, fmi2True) != fmi2OK) return 4;
            print_outputs(get, c, first, count);
        }
        if (terminate(c) != fmi2OK) return 7;
        discard(c);
    }
    return 0;
}
