/* FMI 3.0 for co-simulation: a thin layer over instance.h. A value reference is the place of a variable among ARRAYS;
   those of choices, and of the time, follow after the last one. */

#include "model.h"
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX FUNCTION_PREFIX
#endif
#include "fmi3Functions.h"
#include KERNEL

#define TIME (N_ARRAYS + N_CHOICES)

static const fmi3Status STATUS[] = {fmi3OK, fmi3Warning, fmi3Discard, fmi3Error};

static void report(const Instance *instance, Outcome outcome, const char *message)
{
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)instance->logger;
    logger(instance->environment, STATUS[outcome], CATEGORY[outcome], message);
}

#define REQUIRE(phases, call) \
    Instance *instance = (Instance *)component; \
    if (refused(instance, phases, call)) return fmi3Error

#define OF_FMI(name) fmi3##name
#define STATE(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState
#include "calls.h"

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference intermediate[], size_t intermediateCount,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                         fmi3IntermediateUpdateCallback update)
{
    (void)resources;
    (void)visible;
    (void)logging; /* for debugging messages, of which there are none: warnings and refusals are always logged */
    (void)eventModeUsed;
    (void)earlyReturnAllowed;
    (void)intermediate;
    (void)intermediateCount;
    (void)update;
    return new_instance(name, NULL, token, report, (void (*)(void))logger, environment, OWN_MEMORY);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance component, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 start, fmi3Boolean stopDefined, fmi3Float64 stop)
{
    REQUIRE(BEFORE, "fmi3EnterInitializationMode");
    (void)toleranceDefined;
    (void)tolerance;
    if (set_experiment(instance, start, stopDefined, stop) != GOOD) return fmi3Error;
    instance->state.phase = INITIALIZING;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance component)
{
    REQUIRE(DURING, "fmi3ExitInitializationMode");
    if (refresh(instance) != GOOD) return fmi3Error;
    instance->state.phase = STEPPING;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance component, fmi3Float64 time, fmi3Float64 step, fmi3Boolean noSetPrior,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminate, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    Outcome outcome;
    REQUIRE(AFTER, "fmi3DoStep");
    (void)noSetPrior;
    outcome = do_step(instance, time, step);
    *eventHandlingNeeded = *terminate = *earlyReturn = fmi3False;
    *lastSuccessfulTime = instance->state.now.time;
    return STATUS[outcome];
}

/* Variables ---------------------------------------------------------------------------------------------------------- */

static fmi3Status unknown_reference(const Instance *instance, fmi3ValueReference reference, const char *type)
{
    return STATUS[say(instance, ERROR, "no %s variable has the value reference %u", type, reference)];
}

static fmi3Status wrong_count(const Instance *instance, size_t count)
{
    return STATUS[say(instance, ERROR, "%u values do not fit the sizes of the variables", (unsigned)count)];
}

fmi3Status fmi3GetFloat64(fmi3Instance component, const fmi3ValueReference references[], size_t count,
                          fmi3Float64 values[], size_t valueCount)
{
    size_t done = 0;
    REQUIRE(ANY, "fmi3GetFloat64");
    for (size_t k = 0; k < count; k++) {
        Outcome outcome = GOOD;
        const int timed = references[k] == TIME;
        size_t size = 1;
        if (!timed && references[k] >= N_ARRAYS) return unknown_reference(instance, references[k], "Float64");
        if (!timed) size = ARRAYS[references[k]].size;
        if (valueCount - done < size) return wrong_count(instance, valueCount);
        if (timed)
            values[done] = instance->state.now.time;
        else
            outcome = get_numbers(instance, ARRAYS[references[k]].first, size, values + done);
        if (outcome != GOOD) return STATUS[outcome];
        done += size;
    }
    return done == valueCount ? fmi3OK : wrong_count(instance, valueCount);
}

fmi3Status fmi3SetFloat64(fmi3Instance component, const fmi3ValueReference references[], size_t count,
                          const fmi3Float64 values[], size_t valueCount)
{
    size_t done = 0;
    REQUIRE(BEFORE | DURING | AFTER, "fmi3SetFloat64");
    for (size_t k = 0; k < count; k++) {
        const Array *array;
        if (references[k] >= N_ARRAYS) return unknown_reference(instance, references[k], "settable Float64");
        array = &ARRAYS[references[k]];
        if (valueCount - done < array->size) return wrong_count(instance, valueCount);
        for (size_t i = 0; i < array->size; i++) {
            const Outcome outcome = set_number(instance, array->first + i, values[done++]);
            if (outcome != GOOD) return STATUS[outcome];
        }
    }
    return done == valueCount ? fmi3OK : wrong_count(instance, valueCount);
}

/* Enumerations are integers of 64 bits. */
fmi3Status fmi3GetInt64(fmi3Instance component, const fmi3ValueReference references[], size_t count,
                        fmi3Int64 values[], size_t valueCount)
{
    REQUIRE(ANY, "fmi3GetInt64");
    if (count != valueCount) return wrong_count(instance, valueCount);
    for (size_t k = 0; k < count; k++) {
        if (references[k] < N_ARRAYS || references[k] >= TIME)
            return unknown_reference(instance, references[k], "Int64");
        values[k] = instance->state.choices[references[k] - N_ARRAYS];
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt64(fmi3Instance component, const fmi3ValueReference references[], size_t count,
                        const fmi3Int64 values[], size_t valueCount)
{
    REQUIRE(BEFORE | DURING | AFTER, "fmi3SetInt64");
    if (count != valueCount) return wrong_count(instance, valueCount);
    for (size_t k = 0; k < count; k++) {
        if (references[k] < N_ARRAYS || references[k] >= TIME)
            return unknown_reference(instance, references[k], "Int64");
        if (set_choice(instance, references[k] - N_ARRAYS, values[k]) != GOOD) return fmi3Error;
    }
    return fmi3OK;
}

#define NO_SUCH_CALL(what, type, values_type) \
    fmi3Status fmi3##what##type(fmi3Instance component, const fmi3ValueReference references[], size_t count, \
                                values_type values[], size_t valueCount) \
    { \
        REQUIRE(ANY, "fmi3" #what #type); \
        (void)values; \
        (void)valueCount; \
        return count == 0 ? fmi3OK : unknown_reference(instance, references[0], #type); \
    }
#define NO_SUCH_VARIABLES(type) NO_SUCH_CALL(Get, type, fmi3##type) NO_SUCH_CALL(Set, type, const fmi3##type)
NO_SUCH_VARIABLES(Float32)
NO_SUCH_VARIABLES(Int8)
NO_SUCH_VARIABLES(UInt8)
NO_SUCH_VARIABLES(Int16)
NO_SUCH_VARIABLES(UInt16)
NO_SUCH_VARIABLES(Int32)
NO_SUCH_VARIABLES(UInt32)
NO_SUCH_VARIABLES(UInt64)
NO_SUCH_VARIABLES(Boolean)
NO_SUCH_VARIABLES(String)

/* Derivatives -------------------------------------------------------------------------------------------------------- */

/* Write the places of all components of variables one after the other; returns whether they are `size` places, or says
   why not. */
static int spread(const Instance *instance, const fmi3ValueReference references[], size_t count, size_t size,
                  size_t places[])
{
    size_t found = 0;
    for (size_t k = 0; k < count; k++) {
        const Array *array;
        if (references[k] >= N_ARRAYS) {
            unknown_reference(instance, references[k], "Float64");
            return 0;
        }
        array = &ARRAYS[references[k]];
        if (found + array->size > N_NUMBERS) {
            say(instance, ERROR, "more unknowns or knowns than the %d numbers were requested", N_NUMBERS);
            return 0;
        }
        for (size_t i = 0; i < array->size; i++) places[found++] = array->first + i;
    }
    if (found != size) wrong_count(instance, size);
    return found == size;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance component, const fmi3ValueReference unknowns[],
                                        size_t unknownCount, const fmi3ValueReference knowns[], size_t knownCount,
                                        const fmi3Float64 seeds[], size_t seedCount, fmi3Float64 derivatives[],
                                        size_t derivativeCount)
{
    size_t of[N_NUMBERS] = {0}, by[N_NUMBERS] = {0};
    REQUIRE(DURING | AFTER, "fmi3GetDirectionalDerivative");
    if (!spread(instance, unknowns, unknownCount, derivativeCount, of)) return fmi3Error;
    if (!spread(instance, knowns, knownCount, seedCount, by)) return fmi3Error;
    return STATUS[directional(instance, of, derivativeCount, by, seedCount, seeds, derivatives)];
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance component, const fmi3ValueReference unknowns[], size_t unknownCount,
                                    const fmi3ValueReference knowns[], size_t knownCount, const fmi3Float64 seeds[],
                                    size_t seedCount, fmi3Float64 sensitivities[], size_t sensitivityCount)
{
    size_t of[N_NUMBERS] = {0}, by[N_NUMBERS] = {0};
    REQUIRE(DURING | AFTER, "fmi3GetAdjointDerivative");
    if (!spread(instance, unknowns, unknownCount, seedCount, of)) return fmi3Error;
    if (!spread(instance, knowns, knownCount, sensitivityCount, by)) return fmi3Error;
    return STATUS[adjoint(instance, of, seedCount, by, sensitivityCount, seeds, sensitivities)];
}

/* What there is not ---------------------------------------------------------------------------------------------------- */

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define NOT_OFFERED(name, ...) \
    fmi3Status name(__VA_ARGS__) \
    { \
        REQUIRE(ANY, #name); \
        return STATUS[say(instance, ERROR, #name " is not offered: this is for co-simulation, without events or clocks")]; \
    }
#define SELF fmi3Instance component
typedef fmi3ValueReference Reference;

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback logger)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                               fmi3Boolean visible, fmi3Boolean logging,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
                                               fmi3ClockUpdateCallback update, fmi3LockPreemptionCallback lock,
                                               fmi3UnlockPreemptionCallback unlock)
{
    return NULL;
}

NOT_OFFERED(fmi3GetBinary, SELF, const Reference r[], size_t n, size_t s[], fmi3Binary v[], size_t m)
NOT_OFFERED(fmi3SetBinary, SELF, const Reference r[], size_t n, const size_t s[], const fmi3Binary v[], size_t m)
NOT_OFFERED(fmi3GetClock, SELF, const Reference r[], size_t n, fmi3Clock v[])
NOT_OFFERED(fmi3SetClock, SELF, const Reference r[], size_t n, const fmi3Clock v[])
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, SELF, Reference r, size_t *n)
NOT_OFFERED(fmi3GetVariableDependencies, SELF, Reference r, size_t a[], Reference b[], size_t c[], fmi3DependencyKind d[],
            size_t n)
NOT_OFFERED(fmi3EnterConfigurationMode, SELF)
NOT_OFFERED(fmi3ExitConfigurationMode, SELF)
NOT_OFFERED(fmi3EnterEventMode, SELF)
NOT_OFFERED(fmi3EnterContinuousTimeMode, SELF)
NOT_OFFERED(fmi3EnterStepMode, SELF)
NOT_OFFERED(fmi3EvaluateDiscreteStates, SELF)
NOT_OFFERED(fmi3GetIntervalDecimal, SELF, const Reference r[], size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[])
NOT_OFFERED(fmi3GetIntervalFraction, SELF, const Reference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 v[],
            fmi3IntervalQualifier q[])
NOT_OFFERED(fmi3GetShiftDecimal, SELF, const Reference r[], size_t n, fmi3Float64 v[])
NOT_OFFERED(fmi3GetShiftFraction, SELF, const Reference r[], size_t n, fmi3UInt64 c[], fmi3UInt64 v[])
NOT_OFFERED(fmi3SetIntervalDecimal, SELF, const Reference r[], size_t n, const fmi3Float64 v[])
NOT_OFFERED(fmi3SetIntervalFraction, SELF, const Reference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 v[])
NOT_OFFERED(fmi3SetShiftDecimal, SELF, const Reference r[], size_t n, const fmi3Float64 v[])
NOT_OFFERED(fmi3SetShiftFraction, SELF, const Reference r[], size_t n, const fmi3UInt64 c[], const fmi3UInt64 v[])
NOT_OFFERED(fmi3UpdateDiscreteStates, SELF, fmi3Boolean *a, fmi3Boolean *b, fmi3Boolean *c, fmi3Boolean *d,
            fmi3Boolean *e, fmi3Float64 *t)
NOT_OFFERED(fmi3CompletedIntegratorStep, SELF, fmi3Boolean n, fmi3Boolean *a, fmi3Boolean *b)
NOT_OFFERED(fmi3SetTime, SELF, fmi3Float64 t)
NOT_OFFERED(fmi3SetContinuousStates, SELF, const fmi3Float64 x[], size_t n)
NOT_OFFERED(fmi3GetContinuousStateDerivatives, SELF, fmi3Float64 x[], size_t n)
NOT_OFFERED(fmi3GetEventIndicators, SELF, fmi3Float64 x[], size_t n)
NOT_OFFERED(fmi3GetContinuousStates, SELF, fmi3Float64 x[], size_t n)
NOT_OFFERED(fmi3GetNominalsOfContinuousStates, SELF, fmi3Float64 x[], size_t n)
NOT_OFFERED(fmi3GetNumberOfEventIndicators, SELF, size_t *n)
NOT_OFFERED(fmi3GetNumberOfContinuousStates, SELF, size_t *n)
NOT_OFFERED(fmi3GetOutputDerivatives, SELF, const Reference r[], size_t n, const fmi3Int32 o[], fmi3Float64 v[], size_t m)
NOT_OFFERED(fmi3ActivateModelPartition, SELF, Reference r, fmi3Float64 t)
