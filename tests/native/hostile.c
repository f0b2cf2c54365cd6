/* Asks an FMU of FMI 2, linked from its own sources, for whatever it must survive: random sequences of calls with values
   that make no sense, on several instances at once. Built with sanitizers, which say what goes wrong in memory; what goes
   wrong in the answers ends with a sentence and exit code 1.

   hostile SEQUENCES STEPS SEED */

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "model.h"

#define NUMBERS (N_INPUTS + N_OUTPUTS + N_PARAMETERS + N_SETTINGS + N_INTERNAL)
#define MOST_INSTANCES 4
#ifndef COMPONENTS /* of a path; other inputs have no derivatives */
#define COMPONENTS 1
#endif
#ifndef AMPLITUDE /* of the inputs in the long run */
#define AMPLITUDE 0.01
#endif
#define LARGEST_STATE 100000

static uint64_t seed;
static long told, counts[6];

static uint32_t chance(uint32_t below)
{
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(seed >> 33) % below;
}

static double hostile(void)
{
    static const double values[] = {0.0, -0.0, 1.0, -1.0, 1e300, -1e300, 1e-300, 1e-310, 5.0, 0.1, 1e17, DBL_MAX};
    switch (chance(6)) {
    case 0: return NAN;
    case 1: return chance(2) ? INFINITY : -INFINITY;
    case 2: return (double)chance(1000) / 500.0 - 1.0;
    default: return values[chance(sizeof values / sizeof *values)];
    }
}

static void logger(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String text,
                   ...)
{
    (void)e;
    (void)name;
    (void)category;
    told += status != fmi2OK && strlen(text) > 10;
}

static void fail(const char *what)
{
    printf("%s\n", what);
    exit(1);
}

static void save(fmi2Component c, fmi2Byte *bytes, size_t *size)
{
    fmi2FMUstate state = NULL;
    if (fmi2GetFMUstate(c, &state) != fmi2OK) fail("a state is not saved");
    if (fmi2SerializedFMUstateSize(c, state, size) != fmi2OK || *size > LARGEST_STATE) fail("a state has no size");
    memset(bytes, 0, *size);
    if (fmi2SerializeFMUstate(c, state, bytes, *size) != fmi2OK) fail("a state is not serialized");
    fmi2FreeFMUstate(c, &state);
}

static void restore(fmi2Component c, const fmi2Byte *bytes, size_t size)
{
    static fmi2Byte again[LARGEST_STATE];
    size_t found;
    fmi2FMUstate state = NULL;
    if (fmi2DeSerializeFMUstate(c, bytes, size, &state) != fmi2OK) fail("a state is not read back");
    if (fmi2SetFMUstate(c, state) != fmi2OK) fail("a state is not restored");
    fmi2FreeFMUstate(c, &state);
    save(c, again, &found);
    if (found != size || memcmp(bytes, again, size) != 0) fail("a restored state is not the one that was saved");
}

static void rest(fmi2Component c)
{
    for (fmi2ValueReference k = 0; k < N_INPUTS; k++) fmi2SetReal(c, &k, 1, &VARIABLES[k].start);
}

#if HAS_FEEDBACK
/* What is measured of a crane that hangs where it starts, or nearly so. */
static void measure(fmi2Component c, double error)
{
    const double hanging[N_MEASURED] = {0.0, 5.0, 5.0, 0.0, 0.0, 0.0, 5.0, 0.0, -5.0, 0.0, 0.0, 0.0};
    for (fmi2ValueReference k = 0; k < N_MEASURED; k++) {
        const fmi2ValueReference reference = N_PATH + k;
        const double value = hanging[k] + error * ((double)chance(1000) / 500.0 - 1.0);
        fmi2SetReal(c, &reference, 1, &value);
    }
}
#else
static void measure(fmi2Component c, double error) { (void)c; (void)error; }
#endif

/* A step that is refused must leave the state as it was; returns its status. */
static fmi2Status step(fmi2Component c, double time, double h)
{
    static fmi2Byte before[LARGEST_STATE], after[LARGEST_STATE];
    size_t size, again;
    fmi2Status status;
    save(c, before, &size);
    status = fmi2DoStep(c, time, h, fmi2True);
    save(c, after, &again);
    if (status > fmi2Warning && memcmp(before, after, size) != 0) fail("a step that was refused has left a trace");
    counts[status]++;
    return status;
}

static double now(fmi2Component c)
{
    double time = 0.0;
    fmi2GetRealStatus(c, fmi2LastSuccessfulTime, &time);
    return time;
}

/* The same steps from the same state give the same outputs, to the bit. */
static void repeat(fmi2Component c)
{
    static fmi2Byte bytes[LARGEST_STATE];
    double first[3][N_OUTPUTS], values[N_OUTPUTS], inputs[3][AT_LEAST_1(N_INPUTS)];
    fmi2ValueReference references[NUMBERS];
    size_t size;
    for (fmi2ValueReference k = 0; k < NUMBERS; k++) references[k] = k;
    save(c, bytes, &size);
    for (int k = 0; k < 3; k++)
        for (int i = 0; i < N_INPUTS; i++)
            inputs[k][i] = VARIABLES[i].start + (chance(3) ? 0.0 : 1e-3 * ((double)chance(1000) / 500.0 - 1.0));
    for (int pass = 0; pass < 2; pass++) {
        for (int k = 0; k < 3; k++) {
            fmi2SetReal(c, references, N_INPUTS, inputs[k]);
            step(c, now(c), 0.01);
            memset(values, 0, sizeof values);
            fmi2GetReal(c, references + N_INPUTS, N_OUTPUTS, values);
            if (pass == 0)
                memcpy(first[k], values, sizeof values);
            else if (memcmp(first[k], values, sizeof values) != 0)
                fail("repeated steps give other digits");
        }
        if (pass == 0) restore(c, bytes, size);
    }
}

static void one_call(fmi2Component c)
{
    fmi2ValueReference reference = chance(NUMBERS + 3), output = N_INPUTS + chance(N_OUTPUTS);
    double value = hostile(), found;
    static const double steps[] = {0.01, 0.1, 1e-9, 0.0, -0.1, 1e300, 4000.0, 1e-320};
    switch (chance(14)) {
    case 0:
    case 1: fmi2SetReal(c, &reference, 1, &value); break;
    case 2: fmi2GetReal(c, &reference, 1, &found); break;
    case 3: {
        const fmi2ValueReference choice = NUMBERS + chance(N_CHOICES);
        const fmi2Integer when = (fmi2Integer)chance(7);
        fmi2SetInteger(c, &choice, 1, &when);
        break;
    }
    case 4: fmi2SetupExperiment(c, fmi2False, 0.0, chance(3) ? (double)chance(3) : value, fmi2False, 0.0); break;
    case 5: fmi2EnterInitializationMode(c); break;
    case 6: fmi2ExitInitializationMode(c); break;
    case 7: step(c, chance(4) ? now(c) : value, steps[chance(sizeof steps / sizeof *steps)]); break;
    case 8:
    case 9: step(c, now(c), chance(5) ? 0.01 : value); break;
    case 10:
        rest(c);
        if (chance(2)) measure(c, chance(8) ? 0.01 : 3.0);
        break;
    case 11: fmi2GetDirectionalDerivative(c, &output, 1, &reference, 1, &value, &found); break;
    case 12: repeat(c); break;
    case 13:
        if (chance(4) == 0) chance(2) ? fmi2Terminate(c) : fmi2Reset(c);
        break;
    }
}

int main(int count, char **words)
{
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    const long sequences = count > 1 ? atol(words[1]) : 100, steps = count > 2 ? atol(words[2]) : 1000;
    fmi2Component c;
    double path[AT_LEAST_1(N_INPUTS)], outputs[N_OUTPUTS];
    fmi2ValueReference references[NUMBERS];
    seed = count > 3 ? strtoull(words[3], NULL, 10) : 1;
    for (fmi2ValueReference k = 0; k < NUMBERS; k++) references[k] = k;
    if (fmi2Instantiate("other", fmi2CoSimulation, "{}", "", &callbacks, fmi2False, fmi2False) != NULL)
        fail("another model description is accepted");
    for (long k = 0; k < sequences; k++) {
        fmi2Component instances[MOST_INSTANCES];
        const uint32_t many = 1 + chance(MOST_INSTANCES);
        for (uint32_t i = 0; i < many; i++) {
            c = instances[i] =
                fmi2Instantiate("one", fmi2CoSimulation, INSTANTIATION_TOKEN, "", &callbacks, fmi2False, fmi2True);
            if (c == NULL) fail("no instance");
            if (chance(3)) { /* else whatever comes */
                fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
                fmi2EnterInitializationMode(c);
                if (fmi2ExitInitializationMode(c) != fmi2OK) fail("it does not rest");
            }
        }
        for (uint32_t calls = 10 + chance(50); calls > 0; calls--) one_call(instances[chance(many)]);
        for (uint32_t i = 0; i < many; i++) fmi2FreeInstance(instances[i]);
    }
    c = fmi2Instantiate("long", fmi2CoSimulation, INSTANTIATION_TOKEN, "", &callbacks, fmi2False, fmi2False);
#if HAS_ESTIMATES
    {
        const fmi2ValueReference connected = NUMBERS + CONNECTED;
        const fmi2Integer position = ORDERS;
        fmi2SetInteger(c, &connected, 1, &position);
    }
#endif
    fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    fmi2EnterInitializationMode(c);
    fmi2ExitInitializationMode(c);
    for (long k = 0; k < steps; k++) {
        for (int i = 0; i < N_INPUTS; i++) /* a sine and its derivatives */
            path[i] = VARIABLES[i].start + AMPLITUDE * sin(0.01 * (double)k + 1.5707963267948966 * (i / COMPONENTS));
        fmi2SetReal(c, references, N_INPUTS, path);
        measure(c, 0.0);
        if (fmi2DoStep(c, 0.01 * (double)k, 0.01, fmi2True) > fmi2Warning) fail("a step of a long run is refused");
        fmi2GetReal(c, references + N_INPUTS, N_OUTPUTS, outputs);
        for (int i = 0; i < N_OUTPUTS; i++)
            if (!(fabs(outputs[i]) <= DBL_MAX)) fail("an output of a long run is not finite");
    }
    fmi2FreeInstance(c);
    printf("%ld sequences: %ld steps done, %ld discarded, %ld errors, %ld sentences; then %ld steps\n", sequences,
           counts[fmi2OK] + counts[fmi2Warning], counts[fmi2Discard], counts[fmi2Error], told, steps);
    return counts[fmi2OK] > 0 && (N_INPUTS == 0 || counts[fmi2Discard] > 0) && counts[fmi2Error] > 0 ? 0 : 1;
}
