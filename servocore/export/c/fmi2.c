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

#define REQUIRE(phases, call) \
    Instance *instance = (Instance *)component; \
    if (refused(instance, phases, call)) return fmi2Error

#define OF_FMI(name) fmi2##name
#define STATE(before, after) fmi2##before##FMUstate##after
#define DESERIALIZE fmi2DeSerializeFMUstate
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

/* Variables ---------------------------------------------------------------------------------------------------------- */

/* A host whose setters cannot fail may set values after the end. */
#define SETTING (DEFERRED_CHECKS ? ANY : BEFORE | DURING | AFTER)

static Outcome unknown_reference(const Instance *instance, fmi2ValueReference reference, const char *type)
{
    return say(instance, ERROR, "no %s variable has the value reference %u; it is ignored", type, reference);
}

fmi2Status fmi2GetReal(fmi2Component component, const fmi2ValueReference references[], size_t count, fmi2Real values[])
{
    Outcome worst = GOOD;
    REQUIRE(ANY, "fmi2GetReal");
    for (size_t k = 0; k < count; k++) {
        Outcome outcome = ERROR;
        if (references[k] < N_NUMBERS)
            outcome = get_numbers(instance, references[k], 1, values + k);
        else {
            values[k] = NAN;
            unknown_reference(instance, references[k], "Real");
        }
        if (outcome > worst) worst = outcome;
    }
    return STATUS[worst];
}

/* What is refused is left as it was, the others are set. */
fmi2Status fmi2SetReal(fmi2Component component, const fmi2ValueReference references[], size_t count,
                       const fmi2Real values[])
{
    Outcome worst = GOOD;
    REQUIRE(SETTING, "fmi2SetReal");
    for (size_t k = 0; k < count; k++) {
        const Outcome outcome = references[k] < N_NUMBERS ? set_number(instance, references[k], values[k])
                                                          : unknown_reference(instance, references[k], "Real");
        if (outcome > worst) worst = outcome;
    }
    return STATUS[worst];
}

fmi2Status fmi2GetInteger(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          fmi2Integer values[])
{
    Outcome worst = GOOD;
    REQUIRE(ANY, "fmi2GetInteger");
    for (size_t k = 0; k < count; k++) {
        const size_t choice = (size_t)references[k] - N_NUMBERS;
        if (choice < N_CHOICES)
            values[k] = (fmi2Integer)instance->state.choices[choice];
        else
            worst = unknown_reference(instance, references[k], "Integer");
    }
    return STATUS[worst];
}

fmi2Status fmi2SetInteger(fmi2Component component, const fmi2ValueReference references[], size_t count,
                          const fmi2Integer values[])
{
    Outcome worst = GOOD;
    REQUIRE(SETTING, "fmi2SetInteger");
    for (size_t k = 0; k < count; k++) {
        const size_t choice = (size_t)references[k] - N_NUMBERS;
        const Outcome outcome = choice < N_CHOICES ? set_choice(instance, choice, values[k])
                                                   : unknown_reference(instance, references[k], "Integer");
        if (outcome > worst) worst = outcome;
    }
    return STATUS[worst];
}

#define NO_SUCH_VARIABLES(type, what, values_type) \
    fmi2Status fmi2##what##type(fmi2Component component, const fmi2ValueReference references[], size_t count, \
                                values_type values[]) \
    { \
        REQUIRE(ANY, "fmi2" #what #type); \
        (void)values; \
        return count == 0 ? fmi2OK : STATUS[unknown_reference(instance, references[0], #type)]; \
    }
NO_SUCH_VARIABLES(Boolean, Get, fmi2Boolean)
NO_SUCH_VARIABLES(Boolean, Set, const fmi2Boolean)
NO_SUCH_VARIABLES(String, Get, fmi2String)
NO_SUCH_VARIABLES(String, Set, const fmi2String)

/* Derivatives, and missing features --------------------------------------------------------------------------------- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component component, const fmi2ValueReference unknowns[],
                                        size_t unknownCount, const fmi2ValueReference knowns[], size_t knownCount,
                                        const fmi2Real seeds[], fmi2Real derivatives[])
{
    size_t outputs[N_OUTPUTS] = {0}, given[N_NUMBERS] = {0};
    Outcome outcome;
    REQUIRE(DURING | AFTER, "fmi2GetDirectionalDerivative");
    if (unknownCount > N_OUTPUTS || knownCount > N_NUMBERS)
        return STATUS[say(instance, ERROR, "more unknowns or knowns than the %d outputs and %d numbers were requested", N_OUTPUTS,
                          N_NUMBERS)];
    for (size_t k = 0; k < unknownCount; k++) {
        if (unknowns[k] >= N_NUMBERS) return STATUS[unknown_reference(instance, unknowns[k], "Real")];
        outputs[k] = unknowns[k];
    }
    for (size_t k = 0; k < knownCount; k++) {
        if (knowns[k] >= N_NUMBERS) return STATUS[unknown_reference(instance, knowns[k], "Real")];
        given[k] = knowns[k];
    }
    outcome = directional(instance, outputs, unknownCount, given, knownCount, seeds, derivatives);
    return STATUS[outcome];
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
