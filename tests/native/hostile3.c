/* Asks an FMU of FMI 3, linked from its own sources, for variables that do not exist, in counts that do not fit and with
   values that make no sense; what lies behind, both versions of FMI share, and hostile.c asks it. Built with sanitizers.

   hostile3 SEQUENCES SEED */

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "model.h"

#define NUMBERS (N_INPUTS + N_OUTPUTS + N_PARAMETERS + N_SETTINGS + N_INTERNAL)

static uint64_t seed;
static long told, counts[5];

static uint32_t chance(uint32_t below)
{
    seed = seed * 6364136223846793005u + 1442695040888963407u;
    return (uint32_t)(seed >> 33) % below;
}

static void logger(fmi3InstanceEnvironment e, fmi3Status status, fmi3String category, fmi3String text)
{
    (void)e;
    (void)category;
    told += status != fmi3OK && strlen(text) > 10;
}

/* Fill in references, most of which exist; returns how many numbers they stand for. */
static size_t some(fmi3ValueReference *references, size_t count)
{
    size_t numbers = 0;
    for (size_t k = 0; k < count; k++) {
        references[k] = chance(N_ARRAYS + (chance(10) == 0 ? 4 : 0));
        numbers += references[k] < N_ARRAYS ? ARRAYS[references[k]].size : 1;
    }
    return numbers;
}

/* Back to the start values, so that steps are taken too. */
static void rest(fmi3Instance c)
{
    double values[NUMBERS];
    for (fmi3ValueReference k = 0; k < N_ARRAYS; k++) {
        for (size_t i = 0; i < ARRAYS[k].size; i++) values[i] = VARIABLES[ARRAYS[k].first + i].start;
        fmi3SetFloat64(c, &k, 1, values, ARRAYS[k].size);
    }
}

static double *exactly(size_t count) { return malloc((count ? count : 1) * sizeof(double)); }

static void one_call(fmi3Instance c, double *time)
{
    /* Memory for as many as there are: whoever goes beyond is caught. */
    const size_t count = chance(NUMBERS + 4), others = chance(NUMBERS + 4);
    fmi3ValueReference *references = malloc((count + 1) * sizeof *references);
    fmi3ValueReference *knowns = malloc((others + 1) * sizeof *knowns);
    const size_t numbers = some(references, count) + (chance(5) == 0), given = some(knowns, others) + (chance(5) == 0);
    double *values = exactly(numbers), *seeds = exactly(given), last;
    fmi3Boolean event, over, early;
    fmi3FMUState state = NULL;
    fmi3Status status = fmi3OK;
    for (size_t k = 0; k < numbers; k++) values[k] = chance(20) ? 0.5 : chance(2) ? NAN : 1e300;
    for (size_t k = 0; k < given; k++) seeds[k] = chance(20) ? 1.0 : INFINITY;
    switch (chance(9)) {
    case 0: status = fmi3GetFloat64(c, references, count, values, numbers); break;
    case 1: status = fmi3SetFloat64(c, references, count, values, numbers); break;
    case 2:
        status = fmi3GetDirectionalDerivative(c, references, count, knowns, others, seeds, given, values, numbers);
        break;
    case 8:
        status = fmi3GetAdjointDerivative(c, knowns, others, references, count, seeds, given, values, numbers);
        break;
    case 3: {
        const fmi3ValueReference choice = chance(4) ? N_ARRAYS : chance(N_ARRAYS + 3);
        const fmi3Int64 when = (fmi3Int64)chance(5) - 1;
        status = fmi3SetInt64(c, &choice, 1, &when, 1 + (chance(9) == 0));
        break;
    }
    case 4: rest(c); break;
    case 5:
    case 6:
        status = fmi3DoStep(c, *time, chance(5) ? 0.01 : -1.0, 0, &event, &over, &early, &last);
        if (status <= fmi3Warning) *time = last;
        break;
    case 7:
        fmi3GetFMUState(c, &state);
        fmi3SetFMUState(c, state);
        fmi3FreeFMUState(c, &state);
        break;
    }
    counts[status]++;
    free(references);
    free(knowns);
    free(values);
    free(seeds);
}

int main(int count, char **words)
{
    const long sequences = count > 1 ? atol(words[1]) : 100;
    seed = count > 2 ? strtoull(words[2], NULL, 10) : 1;
    for (long k = 0; k < sequences; k++) {
        double time = 0.0;
        fmi3Instance c = fmi3InstantiateCoSimulation("one", INSTANTIATION_TOKEN, "", 0, 0, 0, 0, NULL, 0, NULL, logger,
                                                     NULL);
        if (c == NULL) return 1;
        if (chance(4)) fmi3EnterInitializationMode(c, 0, 0.0, 0.0, 0, 0.0);
        if (chance(4)) fmi3ExitInitializationMode(c);
        for (uint32_t calls = 10 + chance(50); calls > 0; calls--) one_call(c, &time);
        fmi3FreeInstance(c);
    }
    printf("%ld calls done, %ld discarded, %ld errors, %ld sentences\n", counts[fmi3OK] + counts[fmi3Warning],
           counts[fmi3Discard], counts[fmi3Error], told);
    return counts[fmi3OK] > 0 && counts[fmi3Discard] > 0 && counts[fmi3Error] > 0 ? 0 : 2;
}
