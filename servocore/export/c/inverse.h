/* The inverse model: from a path and its derivatives to the inputs that make a system follow it.

   The mathematics is generated: `quick` and `begin` for a single instant, `advance` for a step of internal
   dynamics. */

#ifndef INVERSE_H
#define INVERSE_H

#include "model.h"
#include "path.h"

#if N_ROUTES == 0
#define ROUTE_SIZE 0
#endif

/* The data of one instant. */
typedef struct {
    double time;
    double path[N_PATH];          /* the path and its derivatives, order by order */
    double state[AT_LEAST_1(N_STATE + ROUTE_SIZE)];
    double outputs[N_OUTPUTS];
    int64_t is_odd;               /* whether the inputs of its step contradict each other */
#if N_ROUTES > 0
    double inner;                 /* the last step of the method in s, 0 before the first */
#endif
#if HAS_FEEDBACK
    double memory[N_MEMORY];      /* of the feedback */
    int64_t remembers, is_far;    /* whether it has a memory; whether it is inactive far from the path */
#endif
#if HAS_ESTIMATES
    double peak;                  /* of the output that the error of estimates is compared with */
#endif
} Moment;

typedef struct {
    double nodes[N_PATH * N_NODES], node_seeds[N_PATH * N_NODES], margins[AT_LEAST_1(N_LIMITS)];
    double next[AT_LEAST_1(N_STATE + ROUTE_SIZE)], state_seed[AT_LEAST_1(N_STATE)], next_seed[AT_LEAST_1(N_STATE)];
#if N_ROUTES > 0
    double past[N_PATH * ROUTE_INSTANTS], left[ROUTE_EQUATIONS];
    Moment then;
#endif
#if HAS_FEEDBACK
    double memory[N_MEMORY], drives[N_DRIVES];
#endif
#if HAS_MOTORS
    double motors[N_OUTPUTS];
#endif
#if HAS_ESTIMATES
    double completed_path[N_PATH]; /* the inputs with estimated derivatives */
    double error, known, worth[3];
#endif
} Work;

#define INTERNAL(moment, k) (moment).state[k]
#define AWAITED(state) N_PATH

#include "instance.h"

/* The mathematics ---------------------------------------------------------------------------------------------------- */

#if N_INTERNAL == 0
#define PLACE_STARTS 0            /* no internal states */
#define COUNT_STARTS 0
#endif
CHECKED(INTERNAL, COUNT_STARTS == N_INTERNAL);
CHECKED(INPUTS, N_INPUTS == N_PATH + N_MEASURED);
#if HAS_FEEDBACK
CHECKED(DRIVES, COUNT_LIMITS == N_DRIVES);
#endif

/* Compute outputs and state at an instant from the path alone. Returns 0 if the equations are not solved. */
static int solve_instant(Instance *instance, Moment *moment)
{
    const double **arguments = instance->arguments;
    double **results = instance->results, residual = NAN;
    arguments[0] = moment->path;
    arguments[1] = instance->state.parameters;
    arguments[2] = &moment->time;
#if HAS_QUICK
    results[0] = instance->scratch.margins;
    results[1] = moment->outputs;
    call(instance, MATHEMATICS(quick));
    if (all_finite(moment->outputs, N_OUTPUTS)) return 1;
#endif
    arguments[3] = instance->state.parameters + PLACE_STARTS;
    results[0] = moment->state;
    results[1] = moment->outputs;
    results[2] = instance->scratch.margins;
    results[3] = &residual;
    if (call(instance, MATHEMATICS(begin))) return 0;
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
    arguments[1] = instance->scratch.nodes;
    arguments[2] = &h;
    arguments[3] = instance->state.parameters;
    arguments[4] = &moment->time;
    results[0] = instance->scratch.next;
    results[1] = moment->outputs;
    results[2] = instance->scratch.margins;
    results[3] = &residual;
    if (call(instance, MATHEMATICS(advance))) return 0;
    memcpy(moment->state, instance->scratch.next, N_STATE * sizeof(double));
    return all_finite(moment->outputs, N_OUTPUTS) && all_finite(moment->state, N_STATE) && fabs(residual) <= DBL_MAX;
}
#endif

/* Checks, each with its sentence ------------------------------------------------------------------------------------- */

static inline int outside(const Instance *instance)
{
    for (int k = 0; k < N_LIMITS; k++)
        if (breaks(&LIMITS[k], instance->scratch.margins[k])) return 1;
    return 0;
}

static Outcome require_branch(const Instance *instance, const Moment *moment, double time)
{
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_IS_POSITIVE[k] && !(moment->outputs[k] > 0.0))
            return say(instance, DISCARD,
                       "at t = %.6g s %s is %.4g%s, on another branch of the equations than the one wanted", time,
                       VARIABLES[FIRST_OUTPUT + k].name, moment->outputs[k], VARIABLES[FIRST_OUTPUT + k].unit);
    return GOOD;
}

static Outcome checked_moment(const Instance *instance, const Moment *moment, int solved, double time)
{
    const Outcome outcome = require_limits(instance, time, LIMITS, N_LIMITS, instance->scratch.margins);
    if (outcome != GOOD) return outcome;
    if (!solved)
        return say(instance, DISCARD, "the equations were not solved at t = %.6g s; likely causes: a path that the model"
                   " cannot follow, inputs that are not derivatives of each other, or a step too large", time);
    return require_branch(instance, moment, time);
}

#if N_ROUTES > 0
#include "routes.h"
#endif

/* Estimated derivatives ----------------------------------------------------------------------------------------------- */

#if HAS_ESTIMATES
#define ALL_CONNECTED 1 /* item of `connected`; each of the next ones has one derivative less */
#define ORDERS_CONNECTED(state) (ORDERS + ALL_CONNECTED - (size_t)(state)->choices[CONNECTED])

/* Store the first sample, and set derivatives of the path that are not connected to zero. */
static void begin_samples(Instance *instance, double *path)
{
    const size_t connected = ORDERS_CONNECTED(&instance->state);
    const double order = (double)connected - 1.0;
    if (connected == ORDERS) return;
    memset(path + COMPONENTS * connected, 0, (N_PATH - COMPONENTS * connected) * sizeof *path);
    instance->arguments[0] = path;
    instance->arguments[1] = &order;
    instance->results[0] = instance->to_keep;
    call(instance, MATHEMATICS(first_samples));
    instance->keeps = 1;
}

/* Return the path of the inputs, with estimates of the derivatives that are not connected. */
static const double *completed(Instance *instance, double h)
{
    const State *state = &instance->state;
    const double order = (double)ORDERS_CONNECTED(state) - 1.0, at_end = state->choices[INPUT_TIME] == AT_END;
    Work *scratch = &instance->scratch;
    scratch->worth[1] = scratch->worth[2] = 0.0;
    scratch->known = 1.0;
    if (state->choices[CONNECTED] == ALL_CONNECTED) return instance->step_inputs;
    instance->arguments[0] = state->kept;
    instance->arguments[1] = instance->step_inputs;
    instance->arguments[2] = &h;
    instance->arguments[3] = &at_end;
    instance->arguments[4] = &order;
    instance->results[0] = instance->to_keep;
    instance->results[1] = scratch->completed_path;
    instance->results[2] = &scratch->error;
    instance->results[3] = &scratch->known;
    call(instance, MATHEMATICS(estimate));
    instance->keeps = 1;
    return scratch->completed_path;
}

/* Compute the error of the outputs that corresponds to the error of the estimates. */
static void judge_estimates(Instance *instance)
{
    Moment *work = &instance->work;
    Work *scratch = &instance->scratch;
    if (!instance->keeps || !(scratch->known > 0.0)) return;
    instance->arguments[0] = &scratch->error;
    instance->arguments[1] = work->path;
    instance->arguments[2] = work->outputs;
    instance->arguments[3] = instance->state.parameters;
    instance->arguments[4] = &work->peak;
    instance->results[0] = scratch->worth;
    call(instance, MATHEMATICS(worth));
    work->peak = scratch->worth[0];
}

/* Warn once of too few samples, and once of too rough ones. */
static Outcome remark_estimates(Instance *instance, double time)
{
    const State *state = &instance->state;
    const Work *scratch = &instance->scratch;
    const size_t order = ORDERS_CONNECTED(state) - 1;
    if (!(scratch->known > 0.0) && !(instance->warned >> 4 & 1)) {
        instance->warned |= 1 << 4;
        return say(instance, WARNING, UNKNOWN[order], time);
    }
    if (scratch->worth[1] > scratch->worth[2] && !(instance->warned >> 5 & 1)) {
        instance->warned |= 1 << 5;
        return say(instance, WARNING, ROUGH[order], time, scratch->error, scratch->worth[1], scratch->worth[0]);
    }
    return GOOD;
}
#else
#define ORDERS_CONNECTED(state) ((size_t)ORDERS)
#endif

#if HAS_ESTIMATES
#define OR_ESTIMATED ", or set connected = %s to have it estimated"
#else
#define OR_ESTIMATED "%.0s"
#endif
#define SLIGHT 1e-9               /* of the size of a position: smaller changes are rounding */

/* Return the order of the derivative that changes while all connected higher ones stay exactly zero; ORDERS if none does. */
static size_t contradicted(const State *state, const double *given)
{
    const size_t top = ORDERS_CONNECTED(state) - 1;
    const double *before = state->last_inputs;
    double size = 1.0;
    size_t still = top + 1; /* from this one on all are zero */
    if (state->steps == 0) return ORDERS;
    while (still > 0) {
        const size_t first = (still - 1) * COMPONENTS;
        int moves = 0;
        for (size_t c = first; c < first + COMPONENTS; c++) moves |= before[c] != 0.0 || given[c] != 0.0;
        if (moves) break;
        still--;
    }
    if (still == top + 1) return ORDERS; /* as nearly always in motion */
    for (size_t c = 0; c < COMPONENTS; c++) size = fmax(size, fabs(given[c]));
    for (size_t k = still == 0 ? 0 : still - 1; k < top; k++)
        for (size_t c = k * COMPONENTS; c < (k + 1) * COMPONENTS; c++)
            if (fabs(given[c] - before[c]) > SLIGHT * size) return k;
    return ORDERS;
}

/* Warn once of a path that moves while connected derivatives stay zero; refuse a second such step. */
static Outcome require_agreement(Instance *instance, double time)
{
    const State *state = &instance->state;
    const size_t top = ORDERS_CONNECTED(state) - 1, k = contradicted(state, instance->step_inputs);
    const int again = state->now.is_odd != 0;
    char above[LONGEST_MESSAGE / 4] = "";
    instance->work.is_odd = k < ORDERS;
    if (k == ORDERS || (!again && instance->warned & 1)) return GOOD;
    for (size_t j = k + 1; j <= top; j++) {
        if (j > k + 1) strcat(above, " and ");
        strcat(above, ORDER_NAMES[j]);
    }
    instance->warned |= again ? 0 : 1;
    return say(instance, again ? DISCARD : WARNING, "at t = %.6g s the " FOLLOWER "'s %s changes, but its %s %s zero: connect what"
               " is missing" OR_ESTIMATED "%s", time, ORDER_NAMES[k], above, top - k > 1 ? "stay" : "stays", ORDER_NAMES[k],
               again ? "" : "; the outputs are those of a " FOLLOWER " that stands still, and the next such step is refused");
}

static Outcome remark_step(Instance *instance, double time)
{
    /* The instant that the inputs belong to. */
    const double instant = AT_START_OF_STEP(&instance->state) ? time : instance->work.time;
    const Outcome outcome = require_agreement(instance, instant);
#if HAS_ESTIMATES
    if (outcome <= WARNING && remark_estimates(instance, instant) != GOOD) return WARNING;
#endif
    return outcome;
}

/* Feedback -------------------------------------------------------------------------------------------------------------- */

#if HAS_FEEDBACK
static void within_limits(const Instance *instance, double *outputs)
{
    const double *most = instance->state.parameters + PLACE_LIMITS;
    for (size_t k = 0; k < N_DRIVES; k++) outputs[k] = fmin(fmax(outputs[k], -most[k]), most[k]);
}

/* Warn once that this step has no feedback; its outputs are the feedforward. */
static Outcome left_out(Instance *instance, int topic, const char *format, double time, double value, double limit)
{
    Moment *work = &instance->work;
    work->remembers = 0;
    within_limits(instance, work->outputs);
    if (instance->warned >> topic & 1) return GOOD;
    instance->warned |= 1 << topic;
    return say(instance, WARNING, format, time, value, limit);
}

/* Add the feedback on measured values to the drives' outputs of a step. */
static Outcome with_feedback(Instance *instance, const double *given, double time, double h)
{
    const State *state = &instance->state;
    const double *p = state->parameters, *measured = state->inputs + N_PATH;
    const int at_end = state->choices[INPUT_TIME] == AT_END;
    const double *before = at_end ? state->now.path : given;
    Moment *work = &instance->work;
    Work *scratch = &instance->scratch;
    double feedforward[N_DRIVES], judged[3] = {0.0, NAN, NAN}, *found = scratch->drives;
    int finite;
    if (!(p[PLACE_SHARE] > 0.0) || !any(measured, N_MEASURED)) {
        work->remembers = 0;
        within_limits(instance, work->outputs);
        return GOOD;
    }
    memcpy(feedforward, work->outputs, sizeof feedforward);
    instance->arguments[0] = before;
    instance->arguments[1] = measured;
    instance->arguments[2] = p;
    instance->arguments[3] = &h;
    instance->results[0] = judged;
    call(instance, MATHEMATICS(judge));
    if (!(judged[0] > 0.0)) return say(instance, DISCARD, "at t = %.6g s " NOT_MEASURED, time NOT_MEASURED_VALUES);
    work->is_far = judged[1] > (work->is_far ? 0.5 : 1.0) * p[PLACE_DISTANCE];
    if (work->is_far)
        return left_out(instance, 1, "at t = %.6g s the measured " FOLLOWER " is %.3g m from its path, more than"
                        " feedback_distance = %g m: it is left to the feedforward until it is within half of that", time, judged[1],
                        p[PLACE_DISTANCE]);
    if (judged[2] > LARGEST_TURN)
        return left_out(instance, 2, "at t = %.6g s the step of %g s is too long for the feedback: " TOO_LONG " may be %.3g s at"
                        " most; the " FOLLOWER " is left to the feedforward", time, h, LARGEST_TURN / judged[2] * h);
    if (!work->remembers) { /* of the same arguments */
        instance->results[0] = work->memory;
        call(instance, at_end ? MATHEMATICS(begin_end) : MATHEMATICS(begin_start));
    }
    instance->arguments[0] = work->memory;
    instance->arguments[1] = given;
    instance->arguments[2] = before;
    instance->arguments[3] = measured;
    instance->arguments[4] = state->now.outputs; /* the drives' come first */
    instance->arguments[5] = feedforward;
    instance->arguments[6] = p;
    instance->arguments[7] = &h;
    instance->arguments[8] = p + PLACE_SHARE;
    instance->arguments[9] = p + PLACE_LIMITS;
    instance->results[0] = scratch->memory;
    instance->results[1] = found;
    call(instance, at_end ? MATHEMATICS(feedback_end) : MATHEMATICS(feedback_start));
    finite = all_finite(scratch->memory, N_MEMORY) && all_finite(found, N_DRIVES);
    if (!finite)
        return left_out(instance, 3, "at t = %.6g s the feedback finds no inputs; the " FOLLOWER " is left to the"
                        " feedforward", time, 0.0, 0.0);
    memcpy(work->memory, scratch->memory, sizeof work->memory);
    memcpy(work->outputs, found, sizeof feedforward);
    work->remembers = 1;
    return GOOD;
}
#else
#define within_limits(instance, outputs) (void)(outputs) /* there are no limits of drives */
#endif

/* Compute the quantities of motors from the inputs, which feedback and limits have changed. */
static void observe_motors(Instance *instance)
{
#if HAS_MOTORS
    instance->arguments[0] = instance->work.outputs;
    instance->arguments[1] = instance->state.parameters;
    instance->results[0] = instance->scratch.motors;
    call(instance, MATHEMATICS(motors));
    memcpy(instance->work.outputs, instance->scratch.motors, (N_OUTPUTS - N_ADDED_UP) * sizeof(double));
#else
    (void)instance;
#endif
}

/* Steps -------------------------------------------------------------------------------------------------------------- */

static Outcome first_moment(Instance *instance)
{
    Moment *work = &instance->work;
    Outcome outcome;
    memcpy(work->path, instance->state.inputs, sizeof work->path);
#if HAS_ESTIMATES
    begin_samples(instance, work->path);
#endif
#if N_ROUTES > 0
    outcome = begin_route(instance, work, work->time);
#else
    outcome = checked_moment(instance, work, solve_instant(instance, work), work->time);
#endif
    if (outcome == GOOD) {
        within_limits(instance, work->outputs);
        observe_motors(instance);
    }
    return outcome;
}

#if N_STATE > 0
static Outcome move(Instance *instance, double time, double h)
{
    const State *state = &instance->state;
    Moment *work = &instance->work;
    double count;
    Outcome outcome = divided(instance, state->parameters[PLACE_STEP], h, &count);
    if (outcome != GOOD) return outcome;
    for (double k = 0.0; k < count; k += 1.0) {
        const Moment before = *work;
        const double end = k + 1.0 == count ? time + h : time + (k + 1.0) / count * h;
        for (size_t i = 0; i < N_NODES; i++)
            path_within(state->choices[INPUT_TIME], state->now.path, instance->step_inputs, h,
                        i + 1 == N_NODES && k + 1.0 == count ? 1.0 : (k + NODES[i]) / count,
                        instance->scratch.nodes + i * N_PATH);
        outcome = checked_moment(instance, work, solve_step(instance, work, h / count), end);
        if (outcome != GOOD) return outcome;
        work->time = end;
        memcpy(work->path, instance->scratch.nodes + (N_NODES - 1) * N_PATH, sizeof work->path);
        keep_turning(work->outputs, before.outputs);
    }
    return GOOD;
}
#else
#if N_ROUTES > 0
static Outcome reached(Instance *instance, const double *given, double time, double h)
{
    double count;
    const Outcome outcome = divided(instance, instance->state.parameters[PLACE_STEP], h, &count);
    return outcome == GOOD ? follow_route(instance, given, time, h, count) : outcome;
}
#else
/* Refuse a step whose end has no solution; the cause may be at its start, the instant of the inputs. */
static Outcome refuse_instant(Instance *instance, const double *given, double time, double h)
{
    Moment *work = &instance->work;
    double ahead[N_PATH];
    int solved;
    memcpy(ahead, work->path, sizeof ahead);
    if (instance->state.choices[INPUT_TIME] == AT_START) {
        memcpy(work->path, given, sizeof work->path);
        work->time = time;
        solved = solve_instant(instance, work);
        if (checked_moment(instance, work, solved, time) != GOOD) return DISCARD;
        memcpy(work->path, ahead, sizeof work->path);
        work->time = time + h;
    }
    solved = solve_instant(instance, work);
    return checked_moment(instance, work, solved, time + h);
}

/* The instant at the end of a step, from the path alone. */
static Outcome reached(Instance *instance, const double *given, double time, double h)
{
    Moment *work = &instance->work;
    Outcome outcome;
    if (instance->state.choices[INPUT_TIME] == AT_START)
        continued(given, h, work->path);
    else
        memcpy(work->path, given, sizeof work->path);
    work->time = time + h;
    if (!solve_instant(instance, work) || outside(instance)) return refuse_instant(instance, given, time, h);
    outcome = require_branch(instance, work, time + h);
    if (outcome == GOOD) keep_turning(work->outputs, instance->state.now.outputs);
    return outcome;
}
#endif

static Outcome move(Instance *instance, double time, double h)
{
#if HAS_ESTIMATES
    const double *given = completed(instance, h);
#else
    const double *given = instance->step_inputs;
#endif
    Outcome outcome = reached(instance, given, time, h);
    if (outcome != GOOD) return outcome;
#if HAS_ESTIMATES
    judge_estimates(instance);
#endif
#if HAS_FEEDBACK
    outcome = with_feedback(instance, given, time, h);
    observe_motors(instance);
#endif
    return outcome;
}
#endif

/* Derivatives -------------------------------------------------------------------------------------------------------- */

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
        static const double none[N_PATH] = {0.0};
        double count;
        if (divided(instance, state->parameters[PLACE_STEP], state->step, &count) != GOOD) return ERROR;
        *work = state->before;
        memset(instance->scratch.state_seed, 0, sizeof instance->scratch.state_seed);
        for (double k = 0.0; k < count && !failed; k += 1.0) {
            double h = state->step / count;
            for (size_t i = 0; i < N_NODES; i++) {
                const double fraction = i + 1 == N_NODES && k + 1.0 == count ? 1.0 : (k + NODES[i]) / count;
                path_within(state->choices[INPUT_TIME], state->before.path, state->last_inputs, state->step, fraction,
                            instance->scratch.nodes + i * N_PATH);
                path_within(state->choices[INPUT_TIME], none, input_seed, state->step, fraction,
                            instance->scratch.node_seeds + i * N_PATH);
            }
            arguments[0] = work->state;
            arguments[1] = instance->scratch.nodes;
            arguments[2] = &h;
            arguments[3] = state->parameters;
            arguments[4] = &work->time;
            arguments[5] = instance->scratch.state_seed;
            arguments[6] = instance->scratch.node_seeds;
            arguments[7] = parameter_seed;
            results[0] = instance->scratch.next_seed;
            results[1] = found;
            failed = call(instance, MATHEMATICS(advance_tangent));
            failed |= !solve_step(instance, work, h);
            work->time = state->before.time + (k + 1.0) / count * state->step;
            memcpy(instance->scratch.state_seed, instance->scratch.next_seed, sizeof instance->scratch.state_seed);
        }
    } else
#endif
    {
        if (state->steps > 0 && state->choices[INPUT_TIME] == AT_START)
            continued(input_seed, state->step, instance->scratch.node_seeds);
        else
            memcpy(instance->scratch.node_seeds, input_seed, N_PATH * sizeof(double));
        arguments[0] = state->now.path;
        arguments[1] = state->parameters;
        arguments[2] = &state->now.time;
        arguments[3] = state->parameters + PLACE_STARTS;
        arguments[4] = instance->scratch.node_seeds;
        arguments[5] = parameter_seed;
        results[0] = instance->scratch.next_seed;
        results[1] = found;
        failed = call(instance, MATHEMATICS(begin_tangent));
    }
    if (failed)
        return say(instance, DISCARD, "at t = %.6g s the outputs have no derivatives", state->now.time);
    return GOOD;
}
#endif
