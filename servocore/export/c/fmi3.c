/* FMI 3.0 for co-simulation: a thin layer over instance.h. A value reference is the place of a variable among ARRAYS;
   those of choices, and of the time, follow after the last one. */

#include "model.h"
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX FUNCTION_PREFIX
#endif
#include "fmi3Functions.h"
#include KERNEL

static const fmi3Status STATUS[] = {fmi3OK, fmi3Warning, fmi3Discard, fmi3Error};

static void report(const Instance *instance, Outcome outcome, const char *message)
{
    const fmi3LogMessageCallback logger = (fmi3LogMessageCallback)instance->logger;
    logger(instance->environment, STATUS[outcome], CATEGORY[outcome], message);
}

#define OF_FMI(name) fmi3##name
#define STATE(before, after) fmi3##before##FMUState##after
#define DESERIALIZE fmi3DeserializeFMUState
#define NUMBERS(what) fmi3##what##Float64
#define NUMBER "Float64"
#define SETTABLE "settable " NUMBER
#define ITEMS(what) fmi3##what##Int64
#define ITEM "Int64"
#define IGNORED ""
#define STOPS 1
#define FIRST_CHOICE N_ARRAYS
#define VALUES(type) type values[], size_t valueCount
#define ROOM valueCount
typedef fmi3Int64 Integer;

static Array array_of(fmi3ValueReference reference)
{
    const Array time = {N_NUMBERS, 1}, none = {NOWHERE, 1};
    return reference < N_ARRAYS ? ARRAYS[reference] : reference == N_ARRAYS + N_CHOICES ? time : none;
}

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

NO_SUCH_VARIABLES(Float32)
NO_SUCH_VARIABLES(Int8)
NO_SUCH_VARIABLES(UInt8)
NO_SUCH_VARIABLES(Int16)
NO_SUCH_VARIABLES(UInt16)
NO_SUCH_VARIABLES(Int32)
NO_SUCH_VARIABLES(UInt32)
NO_SUCH_VARIABLES(UInt64)

/* Derivatives -------------------------------------------------------------------------------------------------------- */

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
