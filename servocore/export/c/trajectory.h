/* A path and its derivatives over time: a line from rest to rest by a time law, or a built-in path. At rest a new line
   begins where another value of the trigger is set: the settings of a motion are those that its begin found.

   The time laws are generated: start, end, start time, end time, ramp and time -> the path, order by order. */

#ifndef TRAJECTORY_H
#define TRAJECTORY_H

#include "model.h"

/* The data of one instant. */
typedef struct {
    double time;
    double outputs[N_OUTPUTS];
} Moment;

#define N_KEPT (N_SETTINGS + 1) /* the settings of the present motion, and the number of its profile */

typedef struct {
    double unused;
} Work;

#define INTERNAL(moment, k) 0.0
#define AWAITED(state) 0
#define remark_step(instance, time) GOOD

#include "instance.h"

#if N_PIECES > 0
static size_t piece_of(double time)
{
    size_t low = 0, high = N_PIECES;
    while (high - low > 1) {
        const size_t middle = (low + high) / 2;
        if (time >= KNOTS[middle])
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* Return the time within the first period of a periodic path. */
static double within_period(double time)
{
    const double since = time - KNOTS[0];
    return PERIOD > 0.0 ? KNOTS[0] + fmod(since, PERIOD) + (since < 0.0 ? PERIOD : 0.0) : time;
}

static void follow_table(double instant, double *found)
{
    const double time = within_period(instant);
    const size_t piece = piece_of(time);
    const double left = KNOTS[piece], right = KNOTS[piece + 1], length = right - left;
    const double u = ((time - left) - (right - time)) / (2.0 * length);
    const int before = RESTS_BEFORE && time <= KNOTS[0], after = RESTS_AFTER && time >= KNOTS[N_PIECES];
    for (size_t c = 0; c < COMPONENTS; c++) {
        double scale = 1.0;
        for (size_t k = 0; k < ORDERS; k++) {
            double value = 0.0;
            for (size_t j = DEGREE + 1; j-- > k;) {
                double falling = 1.0;
                for (size_t i = 0; i < k; i++) falling *= (double)(j - i);
                value = value * u + falling * COEFFICIENTS[piece][j * COMPONENTS + c];
            }
            if (before && (k == 0 || k <= REST_ORDER || time < KNOTS[0])) value = k == 0 ? ENDS[0][c] : 0.0;
            if (after) value = k == 0 ? ENDS[1][c] : 0.0;
            found[k * COMPONENTS + c] = value / scale;
            scale *= length;
        }
    }
}
#endif

static Outcome followed(Instance *instance, Moment *moment)
{
    const double *settings = instance->keeps ? instance->to_keep : instance->state.kept, duration = settings[PLACE_DURATION], ramp = settings[PLACE_RAMP];
    const double end_time = settings[PLACE_START_TIME] + duration;
    const double profile = settings[N_SETTINGS];
    const int64_t law = profile >= 1.0 && profile <= N_LAWS + 1.0 ? (int64_t)profile : 0;
    if (law == 0) return say(instance, DISCARD, "the restored state has no profile");
    if (ramp > 0.0 && law != RAMPED)
        return say(instance, DISCARD, "a ramp belongs to the profile %s, not to %s", LAW_NAMES[RAMPED - 1],
                   LAW_NAMES[law - 1]);
    if (law > N_LAWS) {
#if N_PIECES > 0
        follow_table(moment->time, moment->outputs);
        return GOOD;
#else
        return say(instance, DISCARD, "the profile %s needs a table, and the FMU was built without one", LAW_NAMES[law - 1]);
#endif
    }
    if (ramp > duration / 2.0)
        return say(instance, DISCARD, "a path with a ramp of %g s takes at least %g s, but its duration is %g s", ramp,
                   2.0 * ramp, duration);
    instance->arguments[0] = settings + PLACE_START;
    instance->arguments[1] = settings + PLACE_END;
    instance->arguments[2] = &settings[PLACE_START_TIME];
    instance->arguments[3] = &end_time;
    instance->arguments[4] = &settings[PLACE_RAMP];
    instance->arguments[5] = &moment->time;
    instance->results[0] = moment->outputs;
    call(instance, LAWS[law - 1]);
    if (!all_finite(moment->outputs, N_OUTPUTS))
        return say(instance, DISCARD, "at t = %.6g s the path is not finite", moment->time);
    return GOOD;
}

static void take_settings(Instance *instance)
{
    memcpy(instance->to_keep, instance->state.parameters, N_SETTINGS * sizeof(double));
    instance->to_keep[N_SETTINGS] = (double)instance->state.choices[PROFILE];
    instance->keeps = 1;
}

static Outcome first_moment(Instance *instance)
{
    take_settings(instance);
    return followed(instance, &instance->work);
}

/* Begin a new motion where the present one rests, at its start time or now. */
static Outcome begin_again(Instance *instance, double time)
{
    const double *present = instance->state.kept, begin = present[PLACE_START_TIME];
    const double end = begin + present[PLACE_DURATION];
    const double slight = JITTER * (end - begin); /* no lower derivative is above round-off there */
    double first = begin, last = end, *settings = instance->to_keep;
#if N_PIECES > 0
    if (present[N_SETTINGS] > N_LAWS) {
        first = RESTS_BEFORE ? KNOTS[0] : -HUGE_VAL;
        last = RESTS_AFTER ? KNOTS[N_PIECES] : HUGE_VAL;
    }
#endif
    if (time > first + slight && time < last - slight)
        return say(instance, DISCARD, "at t = %.6g s a new motion cannot begin: the present one ends at t = %.6g s", time,
                   last);
    take_settings(instance);
    if (settings[N_SETTINGS] > N_LAWS)
        return say(instance, DISCARD, "at t = %.6g s a new motion cannot begin: the profile %s has its own times", time,
                   LAW_NAMES[N_LAWS]);
    memcpy(settings + PLACE_START, instance->work.outputs, COMPONENTS * sizeof(double));
    settings[PLACE_START_TIME] = fmax(time, settings[PLACE_START_TIME]);
    return GOOD;
}

static Outcome move(Instance *instance, double time, double h)
{
    if (instance->state.parameters[PLACE_TRIGGER] != instance->state.kept[PLACE_TRIGGER]
        && begin_again(instance, time) != GOOD)
        return DISCARD;
    instance->work.time = time + h;
    return followed(instance, &instance->work);
}

static Outcome differentiate(Instance *instance, const double *input_seed, const double *parameter_seed, double *found)
{
    (void)input_seed;
    (void)parameter_seed;
    (void)found;
    return say(instance, ERROR, "a path has no inputs, and is not differentiated by its settings");
}

#endif
