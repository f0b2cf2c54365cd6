/* FMI 2.0 for co-simulation: a thin layer over instance.h. A value reference is the place of a number; those of choices
   follow after the last one. */

#include "model.h"
#if !defined(FMI2_OVERRIDE_FUNCTION_PREFIX) && !defined(FMI2_FUNCTION_PREFIX)
#define FMI2_FUNCTION_PREFIX FUNCTION_PREFIX
#endif
#include "fmi2Functions.h"
#include KERNEL

static const fmi2Status STATUS[] = {fmi2OK, fmi2Warning, fmi2Discard, fmi2Error};

static void report(const Instance *instance, Outcome outcome, const char *message)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)instance->logger;
    /* Hosts that are not written in C show the format as it is. */
    logger(instance->environment, instance->name, STATUS[outcome], CATEGORY[outcome],
           strchr(message, '%') == NULL ? message : "%s", message);
}

#define OF_FMI(name) fmi2##name
#define STATE(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate
#define NUMBERS(what) fmi2##what##Real
#define NUMBER "Real"
#define SETTABLE NUMBER
#define ITEMS(what) fmi2##what##Integer
#define ITEM "Integer"
#define IGNORED "; it is ignored"
#define STOPS 0                   /* what follows a refused value is done all the same */
#define FIRST_CHOICE N_NUMBERS
#define VALUES(type) type values[]
#define ROOM count
typedef fmi2Integer Integer;

static Array array_of(fmi2ValueReference reference)
{
    const Array number = {(unsigned short)(reference < N_NUMBERS ? reference : NOWHERE), 1};
    return number;
}

#include "calls.h"

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging)
{
    const char *refusal = type == fmi2CoSimulation ? NULL : "%s is for co-simulation only";
    Memory memory = OWN_MEMORY;
    (void)resources;
    (void)visible;
    (void)logging; /* for debugging messages, of which there are none: warnings and refusals are always logged */
    if (functions == NULL) return NULL;
    if (functions->allocateMemory != NULL && functions->freeMemory != NULL) {
        memory.allocate = functions->allocateMemory;
        memory.release = functions->freeMemory;
    }
    return new_instance(name, refusal, guid, report, (void (*)(void))functions->logger, functions->componentEnvironment,
                        memory);
}

fmi2Status fmi2SetupExperiment(fmi2Component component, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean stopDefined, fmi2Real stop)
{
    REQUIRE(BEFORE, "fmi2SetupExperiment");
    (void)toleranceDefined;
    (void)tolerance;
    return STATUS[set_experiment(instance, start, stopDefined, stop)];
}

fmi2Status fmi2EnterInitializationMode(fmi2Component component)
{
    REQUIRE(BEFORE, "fmi2EnterInitializationMode");
    instance->state.phase = INITIALIZING;
    instance->state.due = 1;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component component)
{
    REQUIRE(DURING, "fmi2ExitInitializationMode");
    if (refresh(instance) != GOOD && !DEFERRED_CHECKS) return fmi2Error;
    instance->state.phase = STEPPING;
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component component, fmi2Real time, fmi2Real step, fmi2Boolean noSetPrior)
{
    REQUIRE(AFTER, "fmi2DoStep");
    (void)noSetPrior;
    return STATUS[do_step(instance, time, step)];
}

/* Derivatives, and missing features --------------------------------------------------------------------------------- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
                                        size_t unknownCount, const fmi2ValueReference knowns[], size_t knownCount,
                                        const fmi2Real seeds[], fmi2Real derivatives[])
{
    size_t of[N_NUMBERS] = {0}, by[N_NUMBERS] = {0};
    REQUIRE(DURING | AFTER, "fmi2GetDirectionalDerivative");
    if (!spread(instance, unknowns, unknownCount, unknownCount, of)) return fmi2Error;
    if (!spread(instance, knowns, knownCount, knownCount, by)) return fmi2Error;
    return STATUS[directional(instance, of, unknownCount, by, knownCount, seeds, derivatives)];
}

#define NO_DERIVATIVES(name, values_type, sentence) \
    fmi2Status fmi2##name(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                          const fmi2Integer orders[], values_type values[]) \
    { \
        REQUIRE(ANY, "fmi2" #name); \
        (void)references; \
        (void)orders; \
        (void)values; \
        return count == 0 ? fmi2OK : STATUS[say(instance, ERROR, sentence)]; \
    }
NO_DERIVATIVES(SetRealInputDerivatives, const fmi2Real, "derivatives of the path are inputs of their own")
NO_DERIVATIVES(GetRealOutputDerivatives, fmi2Real, "derivatives of outputs by time are not computed")

fmi2Status fmi2CancelStep(fmi2Component component)
{
    REQUIRE(ANY, "fmi2CancelStep");
    return STATUS[say(instance, ERROR, "steps end before they return: there is none to cancel")];
}

fmi2Status fmi2GetRealStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Real *value)
{
    REQUIRE(ANY, "fmi2GetRealStatus");
    if (kind != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = instance->state.now.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component component, const fmi2StatusKind kind, fmi2Boolean *value)
{
    REQUIRE(ANY, "fmi2GetBooleanStatus");
    if (kind != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

#define NO_SUCH_STATUS(name, type) \
    fmi2Status fmi2Get##name(fmi2Component component, const fmi2StatusKind kind, type *value) \
    { \
        (void)component; \
        (void)kind; \
        (void)value; \
        return fmi2Discard; \
    }
NO_SUCH_STATUS(Status, fmi2Status)
NO_SUCH_STATUS(IntegerStatus, fmi2Integer)
NO_SUCH_STATUS(StringStatus, fmi2String)
