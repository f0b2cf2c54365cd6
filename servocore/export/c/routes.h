/* Routes: steps of a method on some formulation of some model, in place of the exact inversion of every instant.

   A method that reads few derivatives of the path rebuilds the others from the history in its state; that history holds
   the step. So when the step changes the history is rebuilt for the new one: from exact values a few steps back, along the
   path's Taylor polynomial, up to the present. Without that the first step after a change would have an error that no small
   step reduces. The route without functions is the exact inversion. */

#ifndef ROUTES_H
#define ROUTES_H

#define SHORTEST_STEP 1e-6        /* s; below, differences over a step drown in round-off: exact values are taken instead */

static const Route *chosen_route(const State *state)
{
    return &ROUTES[(state->choices[MODEL] - 1) * N_FORMULATIONS + state->choices[FORMULATION] - 1];
}

static Outcome require_route_branch(const Instance *instance, const Moment *moment, double time)
{
    const Route *route = chosen_route(&instance->state);
    for (size_t k = 0; k < N_OUTPUTS; k++)
        if (OUTPUT_IS_POSITIVE[k] && !(moment->outputs[k] > 0.0))
            return say(instance, DISCARD, "%s: at t = %.6g s %s is %.4g%s, %s%s", route->name, time,
                       VARIABLES[FIRST_OUTPUT + k].name, moment->outputs[k], VARIABLES[FIRST_OUTPUT + k].unit,
                       WRONG_SIGNS[k], route->smaller_steps_help && !OUTPUT_IS_FORCE[k] ? "; reduce the step" : "");
    return GOOD;
}

/* Check the limits of the path, at an instant that is not solved yet. */
static Outcome require_path(Instance *instance, const double *path, double time)
{
    instance->arguments[0] = path;
    instance->arguments[1] = instance->state.parameters;
    instance->results[0] = instance->scratch.margins;
    call(instance, MATHEMATICS(margins));
    return require_limits(instance, time, LIMITS, N_LIMITS, instance->scratch.margins);
}

/* Compute a start from the paths in `past`; returns whether its equations are solved. */
static int start_route(Instance *instance, const Route *route, Moment *moment, double h)
{
    double residual = NAN;
    instance->arguments[1] = instance->scratch.past;
    instance->arguments[2] = &h;
    instance->arguments[3] = instance->state.parameters;
    instance->arguments[4] = &moment->time;
    instance->results[0] = moment->state;
    instance->results[1] = moment->outputs;
    instance->results[2] = &residual;
    return !call(instance, route->begin) && all_finite(moment->state, route->size) && fabs(residual) <= DBL_MAX;
}

/* Compute exact values at moment->path. */
static Outcome begin_route(Instance *instance, Moment *moment, double time)
{
    const Route *route = chosen_route(&instance->state);
    int solved;
    Outcome outcome = require_path(instance, moment->path, time);
    if (outcome != GOOD) return outcome;
    if (route->begin == NULL)
        solved = solve_instant(instance, moment);
    else {
        for (size_t k = 0; k < route->instants; k++)
            memcpy(instance->scratch.past + k * N_PATH, moment->path, sizeof moment->path);
        solved = start_route(instance, route, moment, 0.0);
    }
    if (!solved) return say(instance, DISCARD, "%s: no consistent values at t = %.6g s", route->name, time);
    return require_route_branch(instance, moment, time);
}

/* One step of a route from `state` to moment->path; returns whether its equations are solved. */
static int solve_route(Instance *instance, const Route *route, Moment *moment, double h)
{
    double residual = NAN;
    int solved;
    instance->arguments[0] = moment->state;
    instance->arguments[1] = moment->path;
    instance->arguments[2] = &h;
    instance->arguments[3] = instance->state.parameters;
    instance->arguments[4] = &moment->time;
    instance->results[0] = instance->scratch.next;
    instance->results[1] = moment->outputs;
    instance->results[2] = &residual;
    solved = !call(instance, route->step) && all_finite(instance->scratch.next, route->size) && fabs(residual) <= DBL_MAX;
    if (solved) memcpy(moment->state, instance->scratch.next, route->size * sizeof(double));
    return solved;
}

/* Refuse a step, naming the equation with the largest residual at the first guess. */
static Outcome refuse_step(Instance *instance, const Route *route, const double *state, const double *path, double begin,
                           double end)
{
    const double h = end - begin;
    size_t worst = 0;
    double *left = instance->scratch.left;
    instance->arguments[0] = state;
    instance->arguments[1] = path;
    instance->arguments[2] = &h;
    instance->arguments[3] = instance->state.parameters;
    instance->arguments[4] = &begin;
    instance->results[0] = left;
    call(instance, route->guess);
    for (size_t k = 0; k < route->equations && !isnan(left[worst]); k++)
        if (!(fabs(left[k]) <= fabs(left[worst]))) worst = k;
    return say(instance, DISCARD, "%s: the step from t = %.6g s to %.6g s was not solved; the worst equation is the %s. Likely"
               " causes: a step too large for the path, or inputs that are not derivatives of each other", route->name, begin,
               end, route->names[worst]);
}

/* Compute the state that the method would have after a history of steps h. Before the first step it is that of a start. */
static Outcome rebuild(Instance *instance, const Route *route, Moment *moment, double h)
{
    const double settle = moment->inner > 0.0 ? route->settle : 0.0;
    double *past = instance->scratch.past, present[N_PATH];
    Moment *then = &instance->scratch.then;
    int solved;
    for (size_t k = 0; k < route->instants; k++) continued(moment->path, (route->at[k] - settle) * h, past + k * N_PATH);
    then->time = moment->time - settle * h;
    solved = start_route(instance, route, then, h);
    memcpy(present, moment->path, sizeof present);
    for (double k = 0.0; k < settle && solved; k += 1.0) {
        continued(present, (k + 1.0 - settle) * h, then->path);
        solved = solve_route(instance, route, then, h);
        then->time += h;
    }
    if (!solved)
        return say(instance, DISCARD, "%s: at t = %.6g s the step cannot change from %.6g s to %.6g s; the path continued"
                   " backwards leaves the crane's range", route->name, moment->time, moment->inner, h);
    memcpy(moment->state, then->state, route->size * sizeof(double));
    return GOOD;
}

/* Take the path at the start of a step, so far extrapolated, from the inputs. */
static Outcome take_path(Instance *instance, Moment *moment, const double *given)
{
    if (moment->inner == 0.0 && memcmp(moment->path, given, sizeof moment->path) != 0) {
        memcpy(moment->path, given, sizeof moment->path);
        return begin_route(instance, moment, moment->time);
    }
    memcpy(moment->path, given, sizeof moment->path);
    return require_path(instance, given, moment->time);
}

/* Step instance->work through a communication step, in `count` steps of the method. */
static Outcome follow_route(Instance *instance, const double *given, double time, double h, double count)
{
    const State *state = &instance->state;
    const Route *route = chosen_route(state);
    const double step = h / count;
    Moment *work = &instance->work;
    double first[N_PATH];
    Outcome outcome = GOOD;
    work->time = time;
    if (state->choices[INPUT_TIME] == AT_START) outcome = take_path(instance, work, given);
    memcpy(first, work->path, sizeof first);
    if (outcome == GOOD && step >= SHORTEST_STEP && route->step != NULL && fabs(step - work->inner) > JITTER * step)
        outcome = rebuild(instance, route, work, step);
    for (double k = step < SHORTEST_STEP ? count - 1.0 : 0.0; k < count && outcome == GOOD; k += 1.0) {
        const double begin = work->time, end = k + 1.0 == count ? time + h : time + (k + 1.0) * step;
        double before[N_OUTPUTS];
        memcpy(before, work->outputs, sizeof before);
        path_within(state->choices[INPUT_TIME], first, given, h, k + 1.0 == count ? 1.0 : (k + 1.0) / count, work->path);
        if (step < SHORTEST_STEP || route->step == NULL) {
            work->time = end;
            outcome = begin_route(instance, work, end);
        } else {
            outcome = require_path(instance, work->path, end);
            if (outcome == GOOD && !solve_route(instance, route, work, step))
                outcome = refuse_step(instance, route, work->state, work->path, begin, end);
            if (outcome == GOOD) outcome = require_route_branch(instance, work, end);
            work->time = end;
        }
        keep_turning(work->outputs, before);
        work->inner = step;
    }
    return outcome;
}

#endif
