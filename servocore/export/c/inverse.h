/* The inverse model as FMI sees it, whatever its version: times, checks, steps, states, derivatives.

   The mathematics (mathematics.c) is generated; the tables of variables (model.h) are filled in for each scene; this
   file is the same for all. Everything is static and nothing is global but constants: instances never meet, and several
   such models can be linked into one program. Nothing is allocated but the instance itself and saved states. */

#ifndef INVERSE_H
#define INVERSE_H

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#include "path.h"

#define LONGEST_STEP 3600.0       /* s; a longer one is taken for a mistake of the host */
#define MOST_INTERNAL_STEPS 100000.0
#define JITTER 1e-6               /* of a step: hosts compute times with rounding */
#define LONGEST_MESSAGE 512

/* Places of numbers, one after the other: inputs, outputs, parameters, the internal step, moves of the internal states
   at their start, internal states. */
#define FIRST_OUTPUT N_INPUTS
#define FIRST_PARAMETER (FIRST_OUTPUT + N_OUTPUTS)
#define FIRST_INTERNAL (FIRST_PARAMETER + N_PARAMETERS + N_SETTINGS)
#define FIRST_FIXED (FIRST_PARAMETER + N_PARAMETERS + 1)
#define N_NUMBERS (FIRST_INTERNAL + N_INTERNAL)

typedef enum { GOOD, WARNING, DISCARD, ERROR } Outcome;
enum { INSTANTIATED, INITIALIZING, STEPPING, TERMINATED };

/* What belongs to one instant. */
typedef struct {
    double time;
    double path[N_INPUTS];        /* the path and its derivatives, order by order */
    double state[AT_LEAST_1(N_STATE)];
    double outputs[N_OUTPUTS];
} Moment;

/* All that what follows depends on, without pointers and without gaps: copied to save and to restore it. */
typedef struct {
    uint64_t stamp;               /* of this model: a saved state of another one is refused */
    int64_t phase, input_time;
    int64_t due;                  /* whether outputs have yet to be computed from the inputs */
    int64_t steps;                /* taken so far */
    int64_t warned;
    double inputs[N_INPUTS];
    double heard[N_INPUTS];       /* the inputs that the last outputs were computed from */
    double parameters[AT_LEAST_1(N_PARAMETERS + N_SETTINGS)];
    double step;                  /* the last one, in s */
    double stop;                  /* end of the experiment, in s */
    Moment now, before;
} State;

typedef struct Instance Instance;
typedef void (*Reporter)(const Instance *instance, Outcome outcome, const char *message);

struct Instance {
    State state;
    Moment work;                  /* where steps are taken, so that one that fails leaves no trace */
    double nodes[N_INPUTS * N_NODES], node_seeds[N_INPUTS * N_NODES], margins[AT_LEAST_1(N_LIMITS)];
    double next[AT_LEAST_1(N_STATE)], state_seed[AT_LEAST_1(N_STATE)], next_seed[AT_LEAST_1(N_STATE)];
    const double *arguments[SCRATCH_ARGUMENTS];
    double *results[SCRATCH_RESULTS];
    casadi_int integers[AT_LEAST_1(SCRATCH_INTEGERS)];
    double numbers[AT_LEAST_1(SCRATCH_NUMBERS)];
    Reporter report;
    void *environment;            /* what the host wants back with a message */
    void *logger;
    int told[4];                  /* which outcomes it wants to be told */
    char *name;
};

static Outcome say(const Instance *instance, Outcome outcome, const char *format, ...)
{
    char message[LONGEST_MESSAGE];
    va_list values;
    if (instance->report != NULL && instance->told[outcome]) {
        va_start(values, format);
        vsnprintf(message, sizeof message, format, values);
        va_end(values);
        instance->report(instance, outcome, message);
    }
    return outcome;
}

/* What may be called when ---------------------------------------------------------------------------------------- */

#define BEFORE (1u << INSTANTIATED)
#define DURING (1u << INITIALIZING)
#define AFTER (1u << STEPPING)
#define ENDED (1u << TERMINATED)
#define ANY (BEFORE | DURING | AFTER | ENDED)

/* Whether a call is allowed now; says so if not. */
static int refused(const Instance *instance, unsigned phases, const char *call)
{
    if (instance == NULL) return 1;
    if (phases >> instance->state.phase & 1u) return 0;
    say(instance, ERROR, "%s is not allowed now", call);
    return 1;
}

static const char *const CATEGORY[] = {"logEvents", "logStatusWarning", "logStatusDiscard", "logStatusError"};

/* Switch what is told on or off: the categories that are named, or all without a name. */
static Outcome set_logging(Instance *instance, int on, size_t count, const char *const categories[])
{
    for (size_t k = 0; k < count; k++) {
        const int all = strcmp(categories[k], "logAll") == 0;
        int known = all;
        for (int outcome = 0; outcome < 4; outcome++)
            if (all || strcmp(categories[k], CATEGORY[outcome]) == 0) {
                instance->told[outcome] = on;
                known = 1;
            }
        if (!known) return say(instance, ERROR, "there is no logger category %.100s", categories[k]);
    }
    for (int outcome = 0; outcome < 4 && count == 0; outcome++) instance->told[outcome] = on;
    return GOOD;
}

/* Start and end -------------------------------------------------------------------------------------------------- */

static void reset(Instance *instance)
{
    State *state = &instance->state;
    memset(state, 0, sizeof *state);
    state->stamp = STAMP;
    state->phase = INSTANTIATED;
    state->input_time = AT_START;
    state->due = 1;
    state->stop = DBL_MAX;
    for (size_t k = 0; k < N_INPUTS; k++) state->inputs[k] = VARIABLES[k].start;
    for (size_t k = 0; k < N_PARAMETERS + N_SETTINGS; k++)
        state->parameters[k] = VARIABLES[FIRST_PARAMETER + k].start;
}

static Instance *new_instance(const char *name)
{
    Instance *instance = calloc(1, sizeof *instance);
    const size_t length = strlen(name) + 1;
    if (instance == NULL) return NULL;
    instance->name = malloc(length);
    if (instance->name == NULL) {
        free(instance);
        return NULL;
    }
    memcpy(instance->name, name, length);
    for (int k = 0; k < 4; k++) instance->told[k] = 1;
    reset(instance);
    return instance;
}

static void free_instance(Instance *instance)
{
    if (instance == NULL) return;
    free(instance->name);
    free(instance);
}

/* The times of the experiment, which a host tells before or with the initialization. */
static Outcome set_experiment(Instance *instance, double start, int stops, double stop)
{
    if (!(fabs(start) <= DBL_MAX) || (stops && !(stop >= start)))
        return say(instance, ERROR, "the experiment from %g s to %g s has no duration", start, stop);
    instance->state.now.time = start;
    instance->state.stop = stops ? stop : DBL_MAX;
    return GOOD;
}

/* The mathematics ---------------------------------------------------------------------------------------------------- */

static int all_finite(const double *values, size_t count)
{
    for (size_t k = 0; k < count; k++)
        if (!(fabs(values[k]) <= DBL_MAX)) return 0;
    return 1;
}

/* Where the moves of the internal states stand among the parameters. */
#define STARTS(parameters) ((parameters) + N_PARAMETERS + (N_SETTINGS > 0))

/* Outputs and state at an instant from the path alone. Returns 0 where the equations are not solved. */
static int solve_instant(Instance *instance, Moment *moment)
{
    const double **arguments = instance->arguments;
    double **results = instance->results, residual = NAN;
    arguments[0] = moment->path;
    arguments[1] = instance->state.parameters;
    arguments[2] = &moment->time;
#if HAS_QUICK
    results[0] = moment->outputs;
    results[1] = instance->margins;
    MATHEMATICS(quick)(arguments, results, instance->integers, instance->numbers, 0);
    if (all_finite(moment->outputs, N_OUTPUTS)) return 1;
    arguments[0] = moment->path;
    arguments[1] = instance->state.parameters;
    arguments[2] = &moment->time;
#endif
    arguments[3] = STARTS(instance->state.parameters);
    results[0] = moment->state;
    results[1] = moment->outputs;
    results[2] = instance->margins;
    results[3] = &residual;
    if (MATHEMATICS(begin)(arguments, results, instance->integers, instance->numbers, 0)) return 0;
    return all_finite(moment->outputs, N_OUTPUTS) && all_finite(moment->state, N_STATE) && fabs(residual) <= DBL_MAX;
}

#if N_STATE > 0
/* One step of the method, from moment->state and moment->time to the path at the nodes. */
static int solve_step(Instance *instance, Moment *moment, double h)
{
    double residual = NAN;
    const double **arguments = instance->arguments;
    double **results = instance->results;
    arguments[0] = moment->state;
    arguments[1] = instance->nodes;
    arguments[2] = &h;
    arguments[3] = instance->state.parameters;
    arguments[4] = &moment->time;
    results[0] = instance->next;
    results[1] = moment->outputs;
    results[2] = instance->margins;
    results[3] = &residual;
    if (MATHEMATICS(advance)(arguments, results, instance->integers, instance->numbers, 0)) return 0;
    memcpy(moment->state, instance->next, N_STATE * sizeof(double));
    return all_finite(moment->outputs, N_OUTPUTS) && all_finite(moment->state, N_STATE) && fabs(residual) <= DBL_MAX;
}
#endif

/* Checks, each with its sentence ------------------------------------------------------------------------------------- */

static Outcome require_finite_inputs(const Instance *instance, double time)
{
    const double *inputs = instance->state.inputs;
    for (size_t k = 0; k < N_INPUTS; k++)
        if (!(fabs(inputs[k]) <= DBL_MAX))
            return say(instance, DISCARD, "at t = %.6g s the input %s is %g, not a finite number", time,
                       VARIABLES[k].name, inputs[k]);
    return GOOD;
}

static Outcome require_limits(const Instance *instance, double time)
{
    for (int k = 0; k < N_LIMITS; k++)
        if (!(instance->margins[k] > 0.0) && !(LIMITS[k].rate && isnan(instance->margins[k])))
            return say(instance, DISCARD, "at t = %.6g s %s%s%s is %.4g %s, it must stay %s %g %s", time,
                       LIMITS[k].reason, *LIMITS[k].reason ? ": " : "", LIMITS[k].quantity,
                       LIMITS[k].bound + LIMITS[k].side * instance->margins[k], LIMITS[k].unit,
                       LIMITS[k].side > 0.0 ? "above" : "below", LIMITS[k].bound, LIMITS[k].unit);
    return GOOD;
}

static Outcome require_branch(const Instance *instance, const Moment *moment, double time)
{
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_IS_POSITIVE[k] && !(moment->outputs[k] > 0.0))
            return say(instance, DISCARD,
                       "at t = %.6g s %s is %.4g %s, on another branch of the equations than the one wanted", time,
                       VARIABLES[FIRST_OUTPUT + k].name, moment->outputs[k], VARIABLES[FIRST_OUTPUT + k].unit);
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
                   "the communication point t = %.9g s lies %s the FMU's time %.9g s;"
                   " to repeat a step restore the FMU's state first",
                   time, time < present ? "behind" : "ahead of", present);
    if (time + h > instance->state.stop + JITTER * h + 4.0 * DBL_EPSILON * size)
        return say(instance, ERROR, "at t = %.9g s a communication step of %g s goes beyond the stop time of %.9g s", time,
                   h, instance->state.stop);
    return GOOD;
}

/* Tell once if the path moves where all its derivatives say that it rests. */
static Outcome remark_unconnected(Instance *instance, double time)
{
    State *state = &instance->state;
    int moved = 0;
    if (state->warned || state->steps == 0) return GOOD;
    for (size_t k = 0; k < COMPONENTS; k++) moved |= state->inputs[k] != state->heard[k];
    if (!moved) return GOOD;
    for (size_t k = COMPONENTS; k < N_INPUTS; k++)
        if (state->inputs[k] != 0.0 || state->heard[k] != 0.0) return GOOD;
    state->warned = 1;
    return say(instance, WARNING, "at t = %.6g s the path moves, but all its derivatives are zero (%s and further):"
               " they have to be connected too", time, VARIABLES[COMPONENTS].name);
}

/* Outputs ------------------------------------------------------------------------------------------------------------ */

/* Keep angles within half a turn of those before. */
static void keep_turning(Moment *moment, const Moment *before)
{
    const double turn = 6.283185307179586;
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_WRAPS[k]) {
            const double change = before->outputs[k] - moment->outputs[k];
            if (!(fabs(change) <= turn / 2.0)) moment->outputs[k] += turn * floor(change / turn + 0.5);
        }
}

static Outcome checked_moment(const Instance *instance, const Moment *moment, int solved, double time)
{
    const Outcome outcome = require_limits(instance, time);
    if (outcome != GOOD) return outcome;
    if (!solved)
        return say(instance, DISCARD, "the equations were not solved at t = %.6g s; likely causes: a path that the model"
                   " cannot follow, inputs that are not derivatives of each other, or a step too large", time);
    return require_branch(instance, moment, time);
}

/* Compute outputs from the inputs as they are, where that is still to be done: before the first step. */
static Outcome refresh(Instance *instance)
{
    State *state = &instance->state;
    Moment *work = &instance->work;
    Outcome outcome;
    if (!state->due) return GOOD;
    outcome = require_finite_inputs(instance, state->now.time);
    if (outcome != GOOD) return outcome;
    memset(work, 0, sizeof *work);
    work->time = state->now.time;
    memcpy(work->path, state->inputs, sizeof work->path);
    outcome = checked_moment(instance, work, solve_instant(instance, work), work->time);
    if (outcome != GOOD) return outcome;
    state->now = state->before = *work;
    memcpy(state->heard, state->inputs, sizeof state->heard);
    state->due = 0;
    return GOOD;
}

#if N_STATE > 0
static Outcome divided(const Instance *instance, double h, double *count)
{
    const double wanted = instance->state.parameters[N_PARAMETERS];
    *count = wanted > 0.0 ? fmax(1.0, floor(h / wanted + 0.5)) : 1.0;
    if (*count > MOST_INTERNAL_STEPS)
        return say(instance, ERROR, "an internal_step of %g s divides the communication step of %g s into more than %g"
                   " steps", wanted, h, MOST_INTERNAL_STEPS);
    return GOOD;
}

static Outcome move(Instance *instance, double time, double h)
{
    const State *state = &instance->state;
    Moment *work = &instance->work;
    double count;
    Outcome outcome = divided(instance, h, &count);
    if (outcome != GOOD) return outcome;
    for (double k = 0.0; k < count; k += 1.0) {
        const Moment before = *work;
        const double end = k + 1.0 == count ? time + h : time + (k + 1.0) / count * h;
        for (size_t i = 0; i < N_NODES; i++)
            path_within(state->input_time, state->now.path, state->inputs, h,
                        i + 1 == N_NODES && k + 1.0 == count ? 1.0 : (k + NODES[i]) / count,
                        instance->nodes + i * N_INPUTS);
        outcome = checked_moment(instance, work, solve_step(instance, work, h / count), end);
        if (outcome != GOOD) return outcome;
        work->time = end;
        memcpy(work->path, instance->nodes + (N_NODES - 1) * N_INPUTS, sizeof work->path);
        keep_turning(work, &before);
    }
    return GOOD;
}
#else
static Outcome move(Instance *instance, double time, double h)
{
    const State *state = &instance->state;
    Moment *work = &instance->work;
    Outcome outcome;
    if (state->input_time == AT_START)
        continued(state->inputs, h, work->path);
    else
        memcpy(work->path, state->inputs, sizeof work->path);
    work->time = time + h;
    outcome = checked_moment(instance, work, solve_instant(instance, work), time + h);
    if (outcome == GOOD) keep_turning(work, &state->now);
    return outcome;
}
#endif

/* One communication step: a step that is refused leaves everything as it was. */
static Outcome do_step(Instance *instance, double time, double h)
{
    State *state = &instance->state;
    Outcome outcome = require_step(instance, time, h), remark;
    if (outcome == GOOD) outcome = refresh(instance);
    if (outcome == GOOD)
        outcome = require_finite_inputs(instance, state->input_time == AT_START ? time : time + h);
    if (outcome != GOOD) return outcome;
    instance->work = state->now;
    outcome = move(instance, time, h);
    if (outcome != GOOD) return outcome;
    remark = remark_unconnected(instance, time);
    state->before = state->now;
    state->now = instance->work;
    memcpy(state->heard, state->inputs, sizeof state->heard);
    state->step = h;
    state->steps++;
    return remark;
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
        else {
            const Outcome outcome = refresh(instance);
            if (outcome != GOOD) return outcome == DISCARD ? ERROR : outcome;
            value = k < FIRST_PARAMETER ? state->now.outputs[k - FIRST_OUTPUT]
                                        : state->now.state[k - FIRST_INTERNAL];
        }
        *values++ = value;
    }
    return GOOD;
}

/* Whether a number may be set; NaN and infinite inputs are met when they are used, with the time. */
static Outcome set_number(Instance *instance, size_t k, double value)
{
    State *state = &instance->state;
    const Variable *variable = &VARIABLES[k];
    if (k < N_INPUTS) {
        state->inputs[k] = value;
        if (state->phase != STEPPING) state->due = 1;
        return GOOD;
    }
    if (k < FIRST_PARAMETER || k >= FIRST_INTERNAL)
        return say(instance, ERROR, "%s is calculated and cannot be set", variable->name);
    if (!(value >= variable->low && value <= variable->high && fabs(value) <= DBL_MAX))
        return say(instance, ERROR, "%s = %g %s is outside its range [%g, %g] %s", variable->name, value, variable->unit,
                   variable->low, variable->high, variable->unit);
    if (k >= FIRST_FIXED && state->phase == STEPPING)
        return say(instance, ERROR, "%s is fixed: it can be set before the initialization has ended only",
                   variable->name);
    state->parameters[k - FIRST_PARAMETER] = value;
    if (state->phase != STEPPING) state->due = 1;
    return GOOD;
}

static Outcome set_input_time(Instance *instance, int64_t value)
{
    if (instance->state.phase == STEPPING)
        return say(instance, ERROR, "input_time is fixed: it can be set before the initialization has ended only");
    if (value != AT_START && value != AT_END)
        return say(instance, ERROR, "input_time = %lld is unknown; it may be 1 (start) or 2 (end)", (long long)value);
    instance->state.input_time = value;
    return GOOD;
}

/* States ------------------------------------------------------------------------------------------------------------- */

static Outcome require_state(const Instance *instance, const State *saved)
{
    if (saved->stamp != STAMP || saved->phase < INSTANTIATED || saved->phase > TERMINATED ||
        (saved->input_time != AT_START && saved->input_time != AT_END))
        return say(instance, ERROR, "the saved state is not one of %s, or of another version of it", MODEL_NAME);
    return GOOD;
}

/* Copy a state to where the host keeps it; the memory is new where there is none yet. */
static Outcome keep_state(const Instance *instance, const State *state, void **saved)
{
    if (*saved == NULL) *saved = malloc(sizeof(State));
    if (*saved == NULL) return say(instance, ERROR, "there is no memory left to save the state in");
    memcpy(*saved, state, sizeof(State));
    return GOOD;
}

static Outcome restore_state(Instance *instance, const void *saved)
{
    if (saved == NULL) return say(instance, ERROR, "there is no saved state to restore");
    if (require_state(instance, saved) != GOOD) return ERROR;
    memcpy(&instance->state, saved, sizeof(State));
    return GOOD;
}

static void free_state(void **saved)
{
    if (saved == NULL) return;
    free(*saved);
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
        return say(instance, ERROR, "a state takes %u bytes, not %u", (unsigned)sizeof(State), (unsigned)size);
    memcpy(&state, bytes, sizeof(State));
    if (require_state(instance, &state) != GOOD) return ERROR;
    return keep_state(instance, &state, saved);
}

/* Derivatives -------------------------------------------------------------------------------------------------------- */

/* Derivatives of the outputs as they were last computed, by inputs and parameters, along one direction. */
static Outcome differentiate(Instance *instance, const double *input_seed, const double *parameter_seed, double *found)
{
    const State *state = &instance->state;
    const double **arguments = instance->arguments;
    double **results = instance->results;
    const Outcome outcome = refresh(instance);
    int failed = 0;
    if (outcome != GOOD) return outcome;
#if N_STATE > 0
    if (state->steps > 0) {
        Moment *work = &instance->work;
        static const double none[N_INPUTS];
        double count;
        if (divided(instance, state->step, &count) != GOOD) return ERROR;
        *work = state->before;
        memset(instance->state_seed, 0, sizeof instance->state_seed);
        for (double k = 0.0; k < count && !failed; k += 1.0) {
            double h = state->step / count;
            for (size_t i = 0; i < N_NODES; i++) {
                const double fraction = i + 1 == N_NODES && k + 1.0 == count ? 1.0 : (k + NODES[i]) / count;
                path_within(state->input_time, state->before.path, state->heard, state->step, fraction,
                            instance->nodes + i * N_INPUTS);
                path_within(state->input_time, none, input_seed, state->step, fraction,
                            instance->node_seeds + i * N_INPUTS);
            }
            arguments[0] = work->state;
            arguments[1] = instance->nodes;
            arguments[2] = &h;
            arguments[3] = state->parameters;
            arguments[4] = &work->time;
            arguments[5] = instance->state_seed;
            arguments[6] = instance->node_seeds;
            arguments[7] = parameter_seed;
            results[0] = instance->next_seed;
            results[1] = found;
            failed = MATHEMATICS(advance_tangent)(arguments, results, instance->integers, instance->numbers, 0);
            failed |= !solve_step(instance, work, h);
            work->time = state->before.time + (k + 1.0) / count * state->step;
            memcpy(instance->state_seed, instance->next_seed, sizeof instance->state_seed);
        }
    } else
#endif
    {
        if (state->steps > 0 && state->input_time == AT_START)
            continued(input_seed, state->step, instance->node_seeds);
        else
            memcpy(instance->node_seeds, input_seed, N_INPUTS * sizeof(double));
        arguments[0] = state->now.path;
        arguments[1] = state->parameters;
        arguments[2] = &state->now.time;
        arguments[3] = STARTS(state->parameters);
        arguments[4] = instance->node_seeds;
        arguments[5] = parameter_seed;
        results[0] = instance->next_seed;
        results[1] = found;
        failed = MATHEMATICS(begin_tangent)(arguments, results, instance->integers, instance->numbers, 0);
    }
    if (failed || !all_finite(found, N_OUTPUTS))
        return say(instance, DISCARD, "at t = %.6g s the outputs have no derivatives", state->now.time);
    return GOOD;
}

/* Add up derivatives of unknowns (places of outputs) by knowns (places of inputs or parameters), times their seeds. */
static Outcome directional(Instance *instance, const size_t *unknowns, size_t unknown_count, const size_t *knowns,
                           size_t known_count, const double *seeds, double *found)
{
    double input_seed[N_INPUTS] = {0.0}, parameter_seed[AT_LEAST_1(N_PARAMETERS)] = {0.0}, outputs[N_OUTPUTS];
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
    for (size_t k = 0; k < unknown_count; k++) found[k] = outputs[unknowns[k] - FIRST_OUTPUT];
    return GOOD;
}

#endif
