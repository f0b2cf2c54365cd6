/* The common part of all exported FMUs, for any model and both versions of FMI: times, checks, steps, variables, states,
   derivatives.

   The mathematics is generated; the tables of variables (model.h) are filled in for each; a kernel (inverse.h, plant.h,
   trajectory.h) defines the data of an instant and the step to the next one, and includes this file. Everything is static
   and only constants are global: instances are independent, and several models can be linked into one program. Memory
   is allocated for instances and saved states only: by the host where FMI lets it, else by ALLOCATE and RELEASE, which a
   target without heap may define. There is no call of an operating system; without HAS_STDIO none of <stdio.h> either, and
   messages have a question mark in the place of each number. */

#ifndef INSTANCE_H
#define INSTANCE_H

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <string.h>

#if HAS_STDIO
#include <stdio.h>
#endif

#ifndef ALLOCATE
#include <stdlib.h>
#define ALLOCATE calloc
#define RELEASE free
#endif

#ifdef __GNUC__
#pragma GCC diagnostic ignored "-Wtype-limits" /* a model may have no inputs or choices: loops from zero to zero */
#endif

#define LONGEST_STEP 3600.0       /* s; a longer one is refused as a mistake */
#define JITTER 1e-6               /* of a step: hosts compute times with rounding */
#define SUMMED 1e-3               /* of a step: rounding of the sum of millions of steps */
#define ROUND_OFF 1e-9            /* of a limit: what a run adds up may exceed it by so much */
#define LONGEST_MESSAGE 512

/* Places of numbers, one after the other: inputs, outputs, parameters of the model, settings, internal states. */
#define FIRST_OUTPUT N_INPUTS
#define FIRST_PARAMETER (FIRST_OUTPUT + N_OUTPUTS)
#define FIRST_INTERNAL (FIRST_PARAMETER + N_PARAMETERS + N_SETTINGS)
#define N_NUMBERS (FIRST_INTERNAL + N_INTERNAL)
#define NOWHERE (N_NUMBERS + 1)   /* the place of no number; that of the time is N_NUMBERS */
CHECKED(NUMBERS, N_NUMBERS == sizeof VARIABLES / sizeof *VARIABLES);

#ifndef N_KEPT
#define N_KEPT 0                  /* numbers that some kernels keep outside a moment, since copying them would cost too much */
#endif

#ifndef N_MEASURED
#define N_MEASURED 0              /* the last inputs: the measured values of a feedback */
#endif

#if N_INPUTS > 0
#define AT_START_OF_STEP(state) ((state)->choices[INPUT_TIME] == AT_START)
#else
#define AT_START_OF_STEP(state) 0
#endif

typedef enum { GOOD, WARNING, DISCARD, ERROR } Outcome;
enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };

/* The complete state, without pointers and padding: a copy saves it. */
typedef struct {
    uint64_t stamp;               /* of this model: a saved state of another one is refused */
    int64_t phase;
    int64_t choices[N_CHOICES];   /* by the numbers of their items, from 1 on */
    int64_t due;                  /* whether outputs must still be computed from the inputs */
    int64_t steps;                /* taken so far */
    int64_t checked;              /* whether all parameters and choices are known to be legal */
    double inputs[AT_LEAST_1(N_INPUTS)];
    double last_inputs[AT_LEAST_1(N_INPUTS)]; /* the inputs of the present outputs */
    double earlier[AT_LEAST_1(N_INPUTS)]; /* those of the previous outputs */
    double parameters[AT_LEAST_1(N_PARAMETERS + N_SETTINGS)];
    double step;                  /* the last one, in s */
    double start, stop;           /* of the experiment, in s */
    double kept[AT_LEAST_1(N_KEPT)];
    Moment now, before;
    char failure[DEFERRED_CHECKS ? LONGEST_MESSAGE : 8]; /* of the initialization: every step logs it again */
} State;

#define FAILED(state) (DEFERRED_CHECKS && *(state)->failure)

typedef struct Instance Instance;
typedef void (*Reporter)(const Instance *instance, Outcome outcome, const char *message);

typedef struct {
    void *(*allocate)(size_t count, size_t size); /* zeros */
    void (*release)(void *memory);
} Memory;

static const Memory OWN_MEMORY = {ALLOCATE, RELEASE};

struct Instance {
    State state;
    double step_inputs[AT_LEAST_1(N_INPUTS)]; /* those of the current step */
    Moment work;                  /* where steps are computed, so that a refused step changes no state */
    double to_keep[AT_LEAST_1(N_KEPT)];
    int keeps;                    /* whether the step has written to_keep */
    char *failure;                /* where a refusal is stored during the initialization, else NULL */
    Work scratch;
    const double *arguments[SCRATCH_ARGUMENTS];
    double *results[SCRATCH_RESULTS];
    casadi_int integers[AT_LEAST_1(SCRATCH_INTEGERS)];
    double numbers[AT_LEAST_1(SCRATCH_NUMBERS)];
    Reporter report;
    Memory memory;
    void *environment;            /* an argument of the host's logger */
    void (*logger)(void);         /* of the host; its type depends on the version of FMI */
    int logged[4];                /* which outcomes are logged */
    int warned;                   /* warnings issued once per instance, one bit each: a rollback does not repeat them */
    char *name;
};

/* Functions of a kernel. */

/* Compute instance->work at the start from the inputs. */
static Outcome first_moment(Instance *instance);
/* Advance instance->work by h seconds. */
static Outcome move(Instance *instance, double time, double h);
/* Warn of doubtful inputs of a computed step, or refuse it; a kernel without doubts has a macro. */
#ifndef remark_step
static Outcome remark_step(Instance *instance, double time);
#endif
/* Of macros: INTERNAL(moment, k), an internal state; AWAITED(state), the number of inputs, the first ones, that keep their
   values at the start while the first step has zeros. */
/* Directional derivatives of the present outputs with respect to inputs and parameters. */
static Outcome differentiate(Instance *instance, const double *input_seed, const double *parameter_seed, double *found);

/* Call one of the generated functions. */
static inline int call(Instance *instance, Compiled *function)
{
    return function(instance->arguments, instance->results, instance->integers, instance->numbers, 0);
}

#if !HAS_STDIO
/* Write a format with its texts and characters, but with question marks for numbers. */
static void written(char *message, size_t room, const char *format, va_list values)
{
    char *end = message + room - 1;
    for (; *format != '\0' && message < end; format++) {
        if (*format != '%') {
            *message++ = *format;
            continue;
        }
        format += 1 + strspn(format + 1, ".0123456789l");
        if (*format == 's') {
            for (const char *text = va_arg(values, const char *); *text != '\0' && message < end;) *message++ = *text++;
            continue;
        }
        if (*format == 'g') (void)va_arg(values, double);
        else if (format[-1] == 'l') (void)va_arg(values, long long);
        else if (*format == 'c') *message = (char)va_arg(values, int);
        else (void)va_arg(values, int);
        if (*format != 'c') *message = '?';
        message++;
    }
    *message = '\0';
}
#else
#define written vsnprintf
#endif

static Outcome say(const Instance *instance, Outcome outcome, const char *format, ...)
{
    static const char begin[] = "the initialization failed: ";
    const int fails = instance->failure != NULL && outcome > WARNING;
    const int logs = instance->report != NULL && instance->logged[outcome];
    char message[LONGEST_MESSAGE];
    va_list values;
    if (!fails && !logs) return outcome;
    va_start(values, format);
    written(message + (fails ? sizeof begin - 1 : 0), sizeof message - sizeof begin, format, values);
    va_end(values);
    if (fails) {
        memcpy(message, begin, sizeof begin - 1);
        strcpy(instance->failure, message);
    }
    if (logs) instance->report(instance, outcome, message);
    return outcome;
}

/* Calls and phases ----------------------------------------------------------------------------------------------- */

#define BEFORE (1u << INSTANTIATED)
#define DURING (1u << INITIALIZING)
#define AFTER (1u << STEPPING)
#define ENDED (1u << TERMINATED)
#define ANY (BEFORE | DURING | AFTER | ENDED)

static const char *const PHASE[] = {"instantiated", "initializing", "stepping", "terminated"};

/* Refuse a call in this phase, by its name without prefix. */
static int refuse_call(const Instance *instance, unsigned phases, const char *call)
{
    const char *name = call + sizeof "fmi2" - 1;
    int wanted = INSTANTIATED;
    while (!(phases >> wanted & 1u)) wanted++;
    if (strcmp(name, "DoStep") == 0)
        say(instance, DISCARD, "doStep needs a finished initialization, but the FMU is %s", PHASE[instance->state.phase]);
    else
        say(instance, ERROR, "%c%s is ignored: the FMU is %s, not %s", *name | 0x20, name + 1, /* in lower case */
            PHASE[instance->state.phase], PHASE[wanted]);
    return 1;
}

static int refused(const Instance *instance, unsigned phases, const char *call)
{
    return instance == NULL || (!(phases >> instance->state.phase & 1u) && refuse_call(instance, phases, call));
}

static const char *const CATEGORY[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};

/* Switch logging on or off: that of some categories, or all of it. */
static Outcome set_logging(Instance *instance, int on, size_t count, const char *const categories[])
{
    for (size_t k = 0; k < count; k++) {
        const int all = strcmp(categories[k], "logAll") == 0;
        int known = all;
        for (int outcome = 0; outcome < 4; outcome++)
            if (all || strcmp(categories[k], CATEGORY[outcome]) == 0) {
                instance->logged[outcome] = on;
                known = 1;
            }
        if (!known) return say(instance, ERROR, "there is no logger category %.100s", categories[k]);
    }
    for (int outcome = 0; outcome < 4 && count == 0; outcome++) instance->logged[outcome] = on;
    return GOOD;
}

/* Start and end -------------------------------------------------------------------------------------------------- */

static void reset(Instance *instance)
{
    State *state = &instance->state;
    memset(state, 0, sizeof *state);
    instance->warned = 0;
    state->stamp = STAMP;
    state->phase = INSTANTIATED;
    for (size_t k = 0; k < N_CHOICES; k++) state->choices[k] = CHOICES[k].start;
    state->due = 1;
    state->stop = HUGE_VAL;
    for (size_t k = 0; k < N_INPUTS; k++) state->inputs[k] = VARIABLES[k].start;
    for (size_t k = 0; k < N_PARAMETERS + N_SETTINGS; k++)
        state->parameters[k] = VARIABLES[FIRST_PARAMETER + k].start;
}

static void free_instance(Instance *instance)
{
    void (*release)(void *);
    if (instance == NULL) return;
    release = instance->memory.release;
    release(instance->name);
    release(instance);
}

/* Make an instance, unless there is a refusal, or the model description belongs to another build. */
static Instance *new_instance(const char *name, const char *refusal, const char *token, Reporter report,
                              void (*logger)(void), void *environment, Memory memory)
{
    Instance *instance = (Instance *)memory.allocate(1, sizeof *instance);
    if (instance == NULL) return NULL;
    if (name == NULL) name = MODEL_NAME;
    if (refusal == NULL && (token == NULL || strcmp(token, INSTANTIATION_TOKEN) != 0))
        refusal = "%s: the model description belongs to another build of the library";
    instance->memory = memory;
    instance->name = (char *)memory.allocate(strlen(name) + 1, 1);
    if (instance->name != NULL) {
        strcpy(instance->name, name);
        instance->report = logger == NULL ? NULL : report;
        instance->logger = logger;
        instance->environment = environment;
        for (int k = 0; k < 4; k++) instance->logged[k] = 1;
        reset(instance);
        if (refusal == NULL) return instance;
        say(instance, ERROR, refusal, MODEL_NAME);
    }
    free_instance(instance);
    return NULL;
}

static Outcome require_experiment(const Instance *instance, double start, double stop)
{
    if (!(fabs(start) <= DBL_MAX))
        return say(instance, ERROR, "the start time must be a finite number, not %g s", start);
    if (!(stop >= start))
        return say(instance, ERROR, "the experiment from %g s to %g s has no duration", start, stop);
    return GOOD;
}

/* Set start and stop time, before or with the initialization. */
static Outcome set_experiment(Instance *instance, double start, int stops, double stop)
{
    const double end = stops ? stop : HUGE_VAL;
    if (!DEFERRED_CHECKS && require_experiment(instance, start, end) != GOOD) return ERROR;
    instance->state.start = start;
    instance->state.now.time = start;
    instance->state.stop = end;
    instance->state.due = 1; /* what was read before belongs to another start */
    return GOOD;
}

/* Checks, each with its sentence ------------------------------------------------------------------------------------- */

static int all_finite(const double *values, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (!(fabs(values[k]) <= DBL_MAX)) return 0;
    return 1;
}

static inline int any(const double *values, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (values[k] != 0.0) return 1;
    return 0;
}

/* The inputs of a step belong to an instant of it, measured values always to its start. */
static Outcome require_finite_inputs(const Instance *instance, double start, double time)
{
    const double *inputs = instance->state.inputs;
    for (size_t k = 0; k < N_INPUTS; k++)
        if (!(fabs(inputs[k]) <= DBL_MAX))
            return say(instance, DISCARD, "at t = %.6g s the input %s is %g, not a finite number",
                       k < N_INPUTS - N_MEASURED ? time : start, VARIABLES[k].name, inputs[k]);
    return GOOD;
}

static Outcome require_step(const Instance *instance, double time, double h)
{
    const double present = instance->state.now.time, size = fmax(fabs(time), fabs(present));
    if (!(fabs(time) <= DBL_MAX))
        return say(instance, ERROR, "the communication point must be a finite number, not %g s", time);
    if (!(h > 0.0 && h <= LONGEST_STEP))
        return say(instance, ERROR, "at t = %.6g s the communication step is %g s, it must be above 0 s and at most %g s",
                   time, h, LONGEST_STEP);
    if (time + h <= time)
        return say(instance, ERROR, "at t = %.17g s a communication step of %g s is lost in round-off", time, h);
    if (!(fabs(time - present) <= JITTER * h + 4.0 * DBL_EPSILON * size))
        return say(instance, ERROR,
                   "the communication point t = %.16g s lies %s the FMU's time %.16g s;"
                   " to repeat a step restore the FMU's state first",
                   time, time < present ? "behind" : "ahead of", present);
    if (time + h > instance->state.stop + fmax(SUMMED * h, 16.0 * DBL_EPSILON * fabs(instance->state.stop)))
        return say(instance, ERROR, "at t = %.16g s a communication step of %g s goes beyond the stop time of %.16g s",
                   time, h, instance->state.stop);
    return GOOD;
}

/* Refuse the value of a parameter outside its range. */
static Outcome require_legal(const Instance *instance, const Variable *variable, double value)
{
    if (!(fabs(value) <= DBL_MAX))
        return say(instance, ERROR, "%s = %g%s is not a finite number", variable->name, value, variable->unit);
    if (!(value >= variable->low && value <= variable->high))
        return say(instance, ERROR, "%s = %g%s is outside its range [%g, %g]%s", variable->name, value, variable->unit,
                   variable->low, variable->high, variable->unit);
    return GOOD;
}

static Outcome require_item(const Instance *instance, const Choice *choice, int64_t value)
{
    if (value < 1 || value > choice->count)
        return say(instance, ERROR, "%s = %lld is unknown; it may be %s", choice->name, (long long)value, choice->items);
    return GOOD;
}

/* Whether a limit is exceeded; a rate without direction is NaN. */
static inline int breaks(const Limit *limit, double margin)
{
    return !(margin > 0.0) && !(limit->rate && isnan(margin));
}

static inline Outcome say_broken(const Instance *instance, Outcome outcome, double time, const Limit *limit, double margin)
{
    return say(instance, outcome, "at t = %.6g s %s%s%s is %.4g %s, it must stay %s %g %s", time, limit->reason,
               *limit->reason ? ": " : "", limit->quantity, limit->bound + limit->side * margin, limit->unit,
               limit->side > 0.0 ? "above" : "below", limit->bound, limit->unit);
}

static inline Outcome require_limits(const Instance *instance, double time, const Limit *limits, int count, const double *margins)
{
    for (int k = 0; k < count; k++)
        if (breaks(&limits[k], margins[k])) return say_broken(instance, DISCARD, time, &limits[k], margins[k]);
    return GOOD;
}

/* Warn of broken limits of what the run adds up, at its end: earlier an energy may still come back, and only the host
   knows when the last step is done. */
static inline Outcome ended(Instance *instance)
{
    const Moment *now = &instance->state.now;
    Outcome outcome = GOOD;
    instance->state.phase = TERMINATED;
    for (size_t k = 0; k < N_RUN_LIMITS && instance->state.steps > 0; k++) {
        const double margin = RUN_LIMITS[k].side * (now->outputs[RUN_LIMIT_OF[k]] - RUN_LIMITS[k].bound);
        if (breaks(&RUN_LIMITS[k], margin + ROUND_OFF * fabs(RUN_LIMITS[k].bound)))
            outcome = say_broken(instance, WARNING, now->time, &RUN_LIMITS[k], margin);
    }
    return outcome;
}

/* Check all values that were set without a check. */
static Outcome require_settings(Instance *instance)
{
    State *state = &instance->state;
    if (!DEFERRED_CHECKS || state->checked) return GOOD;
    for (size_t k = 0; k < N_CHOICES; k++)
        if (require_item(instance, &CHOICES[k], state->choices[k]) != GOOD) return DISCARD;
    for (size_t k = 0; k < N_PARAMETERS + N_SETTINGS; k++)
        if (require_legal(instance, &VARIABLES[FIRST_PARAMETER + k], state->parameters[k]) != GOOD) return DISCARD;
    state->checked = 1;
    return GOOD;
}

/* Outputs ------------------------------------------------------------------------------------------------------------ */

/* Keep angles within half a turn of the previous ones. */
static inline void keep_turning(double *outputs, const double *before)
{
    const double turn = 6.283185307179586;
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_WRAPS[k]) {
            const double change = before[k] - outputs[k];
            if (!(fabs(change) <= turn / 2.0)) outputs[k] += turn * floor(change / turn + 0.5);
        }
}

/* Add a step to the integrals of outputs and to the roots of mean squares, by the trapezoidal rule: between rest and rest
   it is as accurate as the outputs are smooth. Without a step these are their values at the start. */
static void add_up(const State *state, double *outputs, double h)
{
    const double *before = state->now.outputs, elapsed = state->now.time - state->start;
    for (size_t k = 0; k < N_ADDED_UP; k++) {
        const size_t of = ADDED_UP[k].of, to = N_OUTPUTS - N_ADDED_UP + k;
        const double a = before[of], b = outputs[of];
        if (!ADDED_UP[k].rms)
            outputs[to] = h > 0.0 ? before[to] + h * (a + b) / 2.0 : 0.0;
        else
            outputs[to] = h > 0.0 ? sqrt((before[to] * before[to] * elapsed + h * (a * a + b * b) / 2.0) / (elapsed + h)) : fabs(b);
    }
}

/* Their derivatives, from those of the other outputs; the sums before the last step are given. */
static void differentiate_added_up(const State *state, double *found)
{
    const double h = state->steps > 0 ? state->step : 0.0, elapsed = state->now.time - state->start;
    for (size_t k = 0; k < N_ADDED_UP; k++) {
        const size_t of = ADDED_UP[k].of, to = N_OUTPUTS - N_ADDED_UP + k;
        const double share = h > 0.0 ? h / (2.0 * elapsed) : 1.0;
        found[to] = ADDED_UP[k].rms ? share * state->now.outputs[of] / state->now.outputs[to] * found[of] : h / 2.0 * found[of];
    }
}

/* Make the computed moment the present. */
static void accept(Instance *instance)
{
    instance->state.now = instance->work;
    if (instance->keeps) memcpy(instance->state.kept, instance->to_keep, sizeof instance->to_keep);
    instance->keeps = 0;
}

/* Compute the start from the present settings and inputs. */
static Outcome begun(Instance *instance)
{
    State *state = &instance->state;
    Outcome outcome = DEFERRED_CHECKS ? require_experiment(instance, state->start, state->stop) : GOOD;
    if (outcome == GOOD) outcome = require_settings(instance);
    if (outcome == GOOD) outcome = require_finite_inputs(instance, state->start, state->start);
    if (outcome != GOOD) return outcome;
    memset(&instance->work, 0, sizeof instance->work);
    instance->work.time = state->start;
    instance->keeps = 0;
    outcome = first_moment(instance);
    if (outcome != GOOD) return outcome;
    add_up(state, instance->work.outputs, 0.0);
    state->before = instance->work;
    accept(instance);
    memcpy(state->last_inputs, state->inputs, sizeof state->last_inputs);
    state->due = 0;
    return GOOD;
}

/* Compute outputs from the inputs where that is still due: before the first step. If it fails in a host whose calls cannot
   fail, outputs are NaN and every step logs the reason. */
static Outcome refresh(Instance *instance)
{
    State *state = &instance->state;
    Outcome outcome;
    if (DEFERRED_CHECKS && state->phase == INSTANTIATED) return DISCARD;
    if (!state->due) return FAILED(state) ? DISCARD : GOOD;
    *state->failure = '\0';
    instance->failure = DEFERRED_CHECKS ? state->failure : NULL;
    outcome = begun(instance);
    instance->failure = NULL;
    if (outcome != GOOD && DEFERRED_CHECKS) {
        for (size_t k = 0; k < N_OUTPUTS; k++) state->now.outputs[k] = NAN;
        state->due = 0;
    }
    return outcome;
}

/* Some masters pass connected values on after the first step only: zeros do not replace the inputs of the start then. */
static void take_inputs(Instance *instance)
{
    State *state = &instance->state;
    const size_t count = AWAITED(state);
    memcpy(instance->step_inputs, state->inputs, sizeof instance->step_inputs);
    if (state->steps == 0 && !any(state->inputs, count)) memcpy(instance->step_inputs, state->last_inputs, count * sizeof(double));
}

/* One communication step; a refused step changes no state. */
static Outcome do_step(Instance *instance, double time, double h)
{
    State *state = &instance->state;
    Outcome outcome, remark;
    if (FAILED(state)) return say(instance, DISCARD, "%s", state->failure);
    outcome = require_step(instance, time, h);
    if (outcome == GOOD) outcome = refresh(instance);
    if (outcome == GOOD) outcome = require_settings(instance);
    if (outcome == GOOD)
        outcome = require_finite_inputs(instance, time, AT_START_OF_STEP(state) ? time : time + h);
    if (outcome != GOOD) return outcome;
    instance->work = state->now;
    instance->keeps = 0;
    take_inputs(instance);
    outcome = move(instance, time, h);
    if (outcome > WARNING) return outcome;
    remark = remark_step(instance, time);
    if (remark > WARNING) return remark;
    if (outcome == WARNING) remark = WARNING;
    add_up(state, instance->work.outputs, h);
    state->before = state->now;
    accept(instance);
    memcpy(state->earlier, state->last_inputs, sizeof state->earlier);
    memcpy(state->last_inputs, instance->step_inputs, sizeof state->last_inputs);
    state->step = h;
    state->steps++;
    return remark;
}

/* Divide a time into a whole number of steps of nearly the given size, 0 for one. */
static inline Outcome divided(const Instance *instance, double wanted, double duration, double *count)
{
    *count = wanted > 0.0 ? fmax(1.0, floor(duration / wanted + 0.5)) : 1.0;
    if (*count > MOST_INTERNAL_STEPS)
        return say(instance, ERROR, "an internal_step of %g s divides the communication step of %g s into more than %g"
                   " steps", wanted, duration, MOST_INTERNAL_STEPS);
    return GOOD;
}

/* Variables ---------------------------------------------------------------------------------------------------------- */

static Outcome get_numbers(Instance *instance, size_t first, size_t count, double *values)
{
    const State *state = &instance->state;
    for (size_t k = first; k < first + count; k++) {
        double value;
        if (k < FIRST_OUTPUT)
            value = state->inputs[k];
        else if (k >= FIRST_PARAMETER && k < FIRST_INTERNAL)
            value = state->parameters[k - FIRST_PARAMETER];
        else if (k >= N_NUMBERS)
            value = state->now.time;
        else {
            if (refresh(instance) != GOOD) {
                *values = NAN;
                return ERROR;
            }
            value = k < FIRST_PARAMETER ? state->now.outputs[k - FIRST_OUTPUT]
                                        : INTERNAL(state->now, k - FIRST_INTERNAL);
        }
        *values++ = value;
    }
    return GOOD;
}

/* Set a number; NaN and infinite inputs are refused when they are used, with the time. */
static Outcome set_number(Instance *instance, size_t k, double value)
{
    State *state = &instance->state;
    const Variable *variable = &VARIABLES[k];
    if (k < N_INPUTS) {
        state->inputs[k] = value;
        if (state->phase < STEPPING) state->due = 1;
        return GOOD;
    }
    if (k < FIRST_PARAMETER || k >= FIRST_INTERNAL)
        return say(instance, ERROR, "%s is calculated and cannot be set; the new value is ignored", variable->name);
    if (variable->fixed && state->phase >= STEPPING)
        return say(instance, ERROR, "%s cannot change after the initialization; the new value is ignored",
                   variable->name);
    if (!DEFERRED_CHECKS && require_legal(instance, variable, value) != GOOD) return ERROR;
    state->parameters[k - FIRST_PARAMETER] = value;
    state->checked = 0;
    if (state->phase < STEPPING) state->due = 1;
    return GOOD;
}

static Outcome set_choice(Instance *instance, size_t k, int64_t value)
{
    if (CHOICES[k].fixed && instance->state.phase >= STEPPING)
        return say(instance, ERROR, "%s cannot change after the initialization; the new value is ignored",
                   CHOICES[k].name);
    if (!DEFERRED_CHECKS && require_item(instance, &CHOICES[k], value) != GOOD) return ERROR;
    instance->state.choices[k] = value;
    instance->state.checked = 0;
    if (instance->state.phase < STEPPING) instance->state.due = 1;
    return GOOD;
}

/* States ------------------------------------------------------------------------------------------------------------- */

static Outcome require_state(const Instance *instance, const State *saved)
{
    int known = saved->stamp == STAMP && saved->phase >= INSTANTIATED && saved->phase <= TERMINATED;
    known &= saved->steps >= 0 && saved->steps < INT64_MAX / 2; /* counting on must not overflow */
    for (size_t k = 0; k < N_CHOICES && !DEFERRED_CHECKS; k++)
        known &= saved->choices[k] >= 1 && saved->choices[k] <= CHOICES[k].count;
    if (!known)
        return say(instance, ERROR, "the state to restore is not one of this FMU; nothing was changed");
    return GOOD;
}

/* Copy a state to the memory of the host, or to new memory. */
static Outcome keep_state(const Instance *instance, const State *state, void **saved)
{
    if (*saved == NULL) *saved = instance->memory.allocate(1, sizeof(State));
    if (*saved == NULL) return say(instance, ERROR, "there is no memory left to save the state in");
    memcpy(*saved, state, sizeof(State));
    return GOOD;
}

static Outcome restore_state(Instance *instance, const void *saved)
{
    if (saved == NULL) return say(instance, ERROR, "there is no saved state to restore");
    if (require_state(instance, (const State *)saved) != GOOD) return ERROR;
    memcpy(&instance->state, saved, sizeof(State));
    instance->state.checked = 0;
    instance->state.failure[sizeof instance->state.failure - 1] = '\0';
    return GOOD;
}

static void free_state(const Instance *instance, void **saved)
{
    if (instance == NULL || saved == NULL || *saved == NULL) return;
    instance->memory.release(*saved);
    *saved = NULL;
}

static Outcome write_state(const Instance *instance, const void *saved, void *bytes, size_t size)
{
    if (saved == NULL) return say(instance, ERROR, "there is no saved state to write");
    if (size < sizeof(State))
        return say(instance, ERROR, "a state takes %u bytes, there are %u", (unsigned)sizeof(State), (unsigned)size);
    memcpy(bytes, saved, sizeof(State));
    return GOOD;
}

static Outcome read_state(const Instance *instance, const void *bytes, size_t size, void **saved)
{
    State state;
    if (size != sizeof(State))
        return say(instance, ERROR, "the state to restore is not one of this FMU; nothing was changed");
    memcpy(&state, bytes, sizeof(State));
    if (require_state(instance, &state) != GOOD) return ERROR;
    return keep_state(instance, &state, saved);
}

/* Derivatives -------------------------------------------------------------------------------------------------------- */

/* Sum the derivatives of unknowns (places of outputs) by knowns (places of inputs or parameters) times their seeds. */
static Outcome directional(Instance *instance, const size_t *unknowns, size_t unknown_count, const size_t *knowns,
                           size_t known_count, const double *seeds, double *found)
{
    double input_seed[AT_LEAST_1(N_INPUTS)] = {0.0}, parameter_seed[AT_LEAST_1(N_PARAMETERS)] = {0.0}, outputs[N_OUTPUTS] = {0.0};
    Outcome outcome;
    for (size_t k = 0; k < unknown_count; k++)
        if (unknowns[k] < FIRST_OUTPUT || unknowns[k] >= FIRST_PARAMETER)
            return say(instance, ERROR, "%s is no output: there are derivatives of outputs only",
                       VARIABLES[unknowns[k]].name);
    for (size_t k = 0; k < known_count; k++) {
        const size_t place = knowns[k];
        if (place < N_INPUTS)
            input_seed[place] += seeds[k];
        else if (place >= FIRST_PARAMETER && place < FIRST_PARAMETER + N_PARAMETERS)
            parameter_seed[place - FIRST_PARAMETER] += seeds[k];
        else
            return say(instance, ERROR, "there are no derivatives by %s, only by inputs and parameters of the model",
                       VARIABLES[place].name);
    }
    outcome = differentiate(instance, input_seed, parameter_seed, outputs);
    if (outcome != GOOD) return outcome;
    differentiate_added_up(&instance->state, outputs);
    for (size_t k = 0; k < unknown_count; k++) {
        found[k] = outputs[unknowns[k] - FIRST_OUTPUT];
        /* Only requested ones must exist: the angle of a rope that hangs vertically, for one, has no derivative. */
        if (!all_finite(&found[k], 1))
            return say(instance, DISCARD, "at t = %.6g s %s has no derivative", instance->state.now.time,
                       VARIABLES[unknowns[k]].name);
    }
    return GOOD;
}

/* Sensitivities of a weighted sum of unknowns by each known: one direction at a time, since a step may have substeps. */
static inline Outcome adjoint(Instance *instance, const size_t *unknowns, size_t unknown_count, const size_t *knowns,
                       size_t known_count, const double *weights, double *found)
{
    const double one = 1.0;
    double each[N_OUTPUTS];
    if (unknown_count > N_OUTPUTS)
        return say(instance, ERROR, "more unknowns than the %d outputs were requested", N_OUTPUTS);
    for (size_t k = 0; k < known_count; k++) {
        const Outcome outcome = directional(instance, unknowns, unknown_count, &knowns[k], 1, &one, each);
        if (outcome != GOOD) return outcome;
        found[k] = 0.0;
        for (size_t i = 0; i < unknown_count; i++) found[k] += weights[i] * each[i];
    }
    return GOOD;
}

#endif
