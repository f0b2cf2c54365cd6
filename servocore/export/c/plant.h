/* Forward dynamics: the motion of a system under its inputs, held or extrapolated between communication points, under
   wind and a gust, and held by brakes until an input is not zero.

   The mathematics is generated: `begin`, and steps and observation with inputs given or held. */

#ifndef PLANT_H
#define PLANT_H

#include "model.h"

enum { FIRST_ORDER = 1, ZERO_ORDER = 2 }; /* items of hold */
enum { UNTIL_INPUTS = 1, NO_BRAKES = 2 }; /* items of brakes */

/* The data of one instant. */
typedef struct {
    double time;
    double state[N_STATE];
    double acting[N_INPUTS];      /* inputs at this instant, extrapolated */
    double last_step;             /* 0 if there is none to extrapolate the inputs from */
    int64_t released;             /* 0 while the brakes hold */
    double outputs[N_OUTPUTS];
} Moment;

typedef struct {
    double parameters[AT_LEAST_1(N_PARAMETERS)], next[N_STATE], margins[N_LIMITS + N_START_LIMITS + 1];
    double seeds[AT_LEAST_1(N_PARAMETERS)], state_seed[N_STATE], next_seed[N_STATE];
} Work;

#define INTERNAL(moment, k) (moment).state[k]
/* With brakes, zeros before the first other value are no inputs. */
#define AWAITED(state) ((state)->choices[BRAKES] == UNTIL_INPUTS ? N_INPUTS : 0)
#define remark_step(instance, time) GOOD

#include "instance.h"

#if N_OFFSETS == 0
#define PLACE_OFFSETS 0           /* coordinates have no offsets */
#define COUNT_OFFSETS 0
#endif
#if N_ERRORS == 0
#define PLACE_ERRORS 0            /* the plant has the parameters of its model */
#define COUNT_ERRORS 0
#endif
CHECKED(GROUPS, COUNT_OFFSETS == N_OFFSETS && COUNT_ERRORS == N_ERRORS && COUNT_WIND == N_PUSHED &&
        COUNT_GUST == N_PUSHED && COUNT_MOTION == N_STARTS * N_PUSHED);

/* Ratio of a parameter of the plant to that of the model. */
static double larger(const State *state, size_t place)
{
    double factor = 1.0;
    for (size_t k = 0; k < N_ERRORS; k++)
        if (ERRORS[k] == place) factor *= 1.0 + state->parameters[PLACE_ERRORS + k];
    return factor;
}

static void prepare(Instance *instance)
{
    for (size_t k = 0; k < N_PARAMETERS; k++)
        instance->scratch.parameters[k] = instance->state.parameters[k] * larger(&instance->state, k);
}

/* The force on the output just after an instant. */
static void pushed(const double *parameters, double time, double *force)
{
    const double start = parameters[PLACE_GUST_START];
    const int blows = start <= time && time < start + parameters[PLACE_GUST_DURATION];
    for (size_t k = 0; k < N_PUSHED; k++)
        force[k] = blows ? parameters[PLACE_WIND + k] + parameters[PLACE_GUST + k] : parameters[PLACE_WIND + k];
}

/* The mathematics ---------------------------------------------------------------------------------------------------- */

/* One step of h seconds; the inputs are held where `u` is NULL. Along directions as well where `state_seed` is one. */
static void one_step(Instance *instance, double *state, const double *u, const double *slope, const double *force,
                     double h, const double *u_seed, const double *slope_seed)
{
    Work *work = &instance->scratch;
    const double **arguments = instance->arguments;
    for (int tangent = u_seed != NULL; tangent >= 0; tangent--) {
        size_t k = 0;
        arguments[k++] = state;
        if (u != NULL) {
            arguments[k++] = u;
            arguments[k++] = slope;
        }
        arguments[k++] = force;
        arguments[k++] = work->parameters;
        arguments[k++] = &h;
        if (tangent) {
            arguments[k++] = work->state_seed;
            if (u != NULL) {
                arguments[k++] = u_seed;
                arguments[k++] = slope_seed;
            }
            arguments[k++] = work->seeds;
        }
        instance->results[0] = tangent ? work->next_seed : work->next;
        if (tangent)
            call(instance, u != NULL ? MATHEMATICS(step_tangent) : MATHEMATICS(held_step_tangent));
        else
            call(instance, u != NULL ? MATHEMATICS(step) : MATHEMATICS(held_step));
    }
    if (u_seed != NULL) memcpy(work->state_seed, work->next_seed, sizeof work->state_seed);
    memcpy(state, work->next, sizeof work->next);
}

/* Compute outputs and margins of a moment, or their derivatives along work->state_seed and a direction of the inputs. */
static void observe(Instance *instance, const Moment *moment, double *outputs, const double *u_seed)
{
    Work *work = &instance->scratch;
    const double **arguments = instance->arguments;
    double force[N_PUSHED];
    size_t k = 0;
    pushed(instance->state.parameters, moment->time, force);
    arguments[k++] = moment->state;
    if (moment->released) arguments[k++] = moment->acting;
    arguments[k++] = force;
    arguments[k++] = work->parameters;
    instance->results[0] = outputs;
    if (u_seed == NULL) {
        instance->results[1] = work->margins;
        call(instance, moment->released ? MATHEMATICS(observe) : MATHEMATICS(held_observe));
        return;
    }
    arguments[k++] = work->state_seed;
    if (moment->released) arguments[k++] = u_seed;
    arguments[k++] = work->seeds;
    call(instance, moment->released ? MATHEMATICS(observe_tangent) : MATHEMATICS(held_observe_tangent));
}

/* Steps -------------------------------------------------------------------------------------------------------------- */

static Outcome checked_moment(Instance *instance, Moment *moment, double h)
{
    if (!all_finite(moment->state, N_STATE))
        return say(instance, DISCARD, "the step from t = %.6g s to %.6g s has no finite result: the inputs are too large,"
                   " or internal_step is", moment->time - h, moment->time);
    observe(instance, moment, moment->outputs, NULL);
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (!all_finite(&moment->outputs[k], 1))
            return say(instance, DISCARD, "at t = %.6g s %s is %g, not a finite number", moment->time,
                       VARIABLES[FIRST_OUTPUT + k].name, moment->outputs[k]);
    if (require_limits(instance, moment->time, LIMITS, N_LIMITS, instance->scratch.margins) != GOOD) return DISCARD;
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_IS_POSITIVE[k] && !(moment->outputs[k] > 0.0))
            return say(instance, DISCARD, "at t = %.6g s %s%s%s is %.4g%s, it must stay above 0%s", moment->time, REASONS[k],
                       *REASONS[k] ? " " : "", VARIABLES[FIRST_OUTPUT + k].name, moment->outputs[k],
                       VARIABLES[FIRST_OUTPUT + k].unit, VARIABLES[FIRST_OUTPUT + k].unit);
    return GOOD;
}

static Outcome first_moment(Instance *instance)
{
    const double *parameters = instance->state.parameters;
    Moment *work = &instance->work;
    prepare(instance);
    instance->arguments[0] = parameters + PLACE_MOTION;
    instance->arguments[1] = instance->scratch.parameters;
    instance->results[0] = instance->scratch.margins;
    call(instance, MATHEMATICS(start_margins));
    if (require_limits(instance, work->time, START_LIMITS, N_START_LIMITS, instance->scratch.margins) != GOOD) return DISCARD;
    instance->arguments[0] = parameters + PLACE_MOTION;
    instance->arguments[1] = parameters + PLACE_OFFSETS;
    instance->arguments[2] = instance->scratch.parameters;
    instance->results[0] = work->state;
    call(instance, MATHEMATICS(begin));
    if (!all_finite(work->state, N_STATE))
        return say(instance, DISCARD, "at t = %.6g s no motion goes on with start.position and its derivatives", work->time);
    memcpy(work->acting, instance->state.inputs, sizeof work->acting);
    /* Brakes are open at a start in motion: they hold velocities constant, and would not stop it. */
    work->released = any(work->acting, N_INPUTS) || any(parameters + PLACE_MOTION + N_PUSHED, (N_STARTS - 1) * N_PUSHED) ||
                     instance->state.choices[BRAKES] == NO_BRAKES;
    return checked_moment(instance, work, 0.0);
}

/* Compute the inputs at the start of a step, and their rates. */
static void reconstructed(const State *state, const Moment *now, const double *u, const double *last, double h,
                          double *begin, double *slope)
{
    const int held = state->choices[HOLD] == ZERO_ORDER || !now->released;
    const int reached = state->choices[INPUT_TIME] == AT_END;
    for (size_t k = 0; k < N_INPUTS; k++) {
        begin[k] = !held && reached ? last[k] : u[k];
        slope[k] = held ? 0.0 : reached ? (u[k] - last[k]) / h : now->last_step > 0.0 ? (u[k] - last[k]) / now->last_step : 0.0;
    }
}

/* Divide the time from `begin` to `end` into steps; the inputs are those of a step that began at `time`. */
static Outcome through(Instance *instance, double time, double begin, double end, const double *u, const double *slope,
                       const double *u_seed, const double *slope_seed)
{
    double force[N_PUSHED], now[N_INPUTS], now_seed[N_INPUTS], count, h;
    const Outcome outcome = divided(instance, instance->state.parameters[PLACE_LONGEST], end - begin, &count);
    if (outcome != GOOD) return outcome;
    h = (end - begin) / count;
    pushed(instance->state.parameters, begin, force);
    for (double i = 0.0; i < count; i += 1.0) {
        const double elapsed = begin - time + i * h;
        for (size_t k = 0; k < N_INPUTS && u != NULL; k++) {
            now[k] = u[k] + slope[k] * elapsed;
            if (u_seed != NULL) now_seed[k] = u_seed[k] + slope_seed[k] * elapsed;
        }
        one_step(instance, instance->work.state, u == NULL ? NULL : now, slope, force, h, u_seed == NULL ? NULL : now_seed,
                 slope_seed);
    }
    return GOOD;
}

/* Integrate a communication step, divided where the gust begins and ends. */
static Outcome integrated(Instance *instance, double time, double h, const double *u, const double *slope,
                          const double *u_seed, const double *slope_seed)
{
    const double start = instance->state.parameters[PLACE_GUST_START], end = time + h;
    const double edges[] = {start, start + instance->state.parameters[PLACE_GUST_DURATION], end};
    double begin = time;
    for (size_t k = 0; k < 3; k++)
        if (k == 2 || (time < edges[k] && edges[k] < end && edges[k] > begin)) {
            const Outcome outcome = through(instance, time, begin, edges[k], u, slope, u_seed, slope_seed);
            if (outcome != GOOD) return outcome;
            begin = edges[k];
        }
    return GOOD;
}

static Outcome move(Instance *instance, double time, double h)
{
    State *state = &instance->state;
    Moment *work = &instance->work;
    const double *given = instance->step_inputs;
    const int released = work->released || any(given, N_INPUTS);
    double begin[N_INPUTS], slope[N_INPUTS];
    Outcome outcome;
    prepare(instance);
    reconstructed(state, &state->now, given, state->last_inputs, h, begin, slope);
    outcome = integrated(instance, time, h, released ? begin : NULL, slope, NULL, NULL);
    if (outcome != GOOD) return outcome;
    for (size_t k = 0; k < N_INPUTS; k++) work->acting[k] = begin[k] + slope[k] * h;
    work->last_step = released && state->choices[HOLD] == FIRST_ORDER ? h : 0.0;
    work->released = released;
    work->time = time + h;
    return checked_moment(instance, work, h);
}

/* Derivatives -------------------------------------------------------------------------------------------------------- */

static Outcome differentiate(Instance *instance, const double *input_seed, const double *parameter_seed, double *found)
{
    const State *state = &instance->state;
    Work *scratch = &instance->scratch;
    const Outcome outcome = refresh(instance);
    static const double none[N_INPUTS] = {0.0};
    double u[N_INPUTS], slope[N_INPUTS], u_seed[N_INPUTS] = {0.0}, slope_seed[N_INPUTS] = {0.0}, acting[N_INPUTS];
    if (outcome != GOOD) return outcome;
    prepare(instance);
    for (size_t k = 0; k < N_PARAMETERS; k++) scratch->seeds[k] = parameter_seed[k] * larger(state, k);
    memset(scratch->state_seed, 0, sizeof scratch->state_seed);
    memcpy(acting, input_seed, sizeof acting);
    if (state->steps > 0) {
        const double h = state->step;
        instance->work = state->before;
        reconstructed(state, &state->before, state->last_inputs, state->earlier, h, u, slope);
        reconstructed(state, &state->before, input_seed, none, h, u_seed, slope_seed);
        if (integrated(instance, state->before.time, h, state->now.released ? u : NULL, slope, u_seed, slope_seed) != GOOD)
            return ERROR;
        for (size_t k = 0; k < N_INPUTS; k++) acting[k] = u_seed[k] + slope_seed[k] * h;
    }
    observe(instance, &state->now, found, acting);
    return GOOD;
}

#endif
