/* Sums, differences and products of Chebyshev models, LANES boxes side by side.

   A model is an array of rows, one per coefficient and one with the radius, of one number per box. Pairs with a
   coefficient that is zero in all lanes, as of what does not depend on a parameter, are left out. The bounds are those
   of programs.py. */

#include <stddef.h>

#define LANES 16
#define EACH for (whole l = 0; l < LANES; ++l)

typedef ptrdiff_t whole; /* as NumPy's intp */

static const double UNIT = 2.3e-16, UP = 1.0 + 1e-14, TINY = 1e-290;

static double magnitude(double x) { return x < 0.0 ? -x : x; }

static void norm(whole terms, const double *restrict a, double *restrict sum)
{
    EACH sum[l] = 0.0;
    for (whole k = 0; k < terms; ++k)
        EACH sum[l] += magnitude(a[k * LANES + l]);
}

static void add(whole terms, double sign, const double *a, const double *b, double *restrict to)
{
    double size[LANES];
    const double *r = a + terms * LANES, *s = b + terms * LANES;
    for (whole k = 0; k < terms * LANES; ++k) to[k] = a[k] + sign * b[k];
    norm(terms, to, size);
    EACH to[terms * LANES + l] = (r[l] + s[l] + UNIT * size[l]) * UP;
}

static int used(const double *row)
{
    int any = 0;
    EACH any |= row[l] != 0.0;
    return any;
}

static void multiply(const whole *tape, const double *a, const double *b, double *restrict results,
                     double *restrict to)
{
    double x[LANES], z[LANES], size_a[LANES], size_b[LANES], beyond[LANES], off[LANES] = {0.0};
    const whole terms = tape[0], targets = tape[1], full = tape[2], *table = tape + 4;
    const double *r = a + terms * LANES, *s = b + terms * LANES;
    double share = 1.0 / targets, added = tape[3];
    for (whole k = 0; k < full * LANES; ++k) results[k] = 0.0;
    for (whole i = terms - 1; i >= 0; --i) {
        if (!used(a + i * LANES)) continue;
        EACH x[l] = share * a[i * LANES + l];
        EACH off[l] += (1.0 + added * (i + 1)) * UNIT / 2.0 * magnitude(a[i * LANES + l]);
        for (whole j = 0; j < terms; ++j) {
            const double *right = b + j * LANES;
            const whole *place = table + (i * terms + j) * targets;
            if (targets > 2 && !used(right)) continue;
            EACH z[l] = x[l] * right[l];
            for (whole k = 0; k < targets; ++k) {
                double *at = results + place[k] * LANES;
                EACH at[l] += z[l];
            }
        }
    }
    for (whole k = 0; k < terms * LANES; ++k) to[k] = results[k];
    norm(full - terms, results + terms * LANES, beyond);
    norm(terms, a, size_a);
    norm(terms, b, size_b);
    EACH {
        double crossed = size_a[l] * s[l] + size_b[l] * r[l] + r[l] * s[l];
        double radius = (beyond[l] + off[l] * size_b[l] + crossed) * UP;
        to[terms * LANES + l] = radius + (radius > 0.0 ? TINY : 0.0);
    }
}

/* The first tape has the numbers of terms, of results of a pair of coefficients, of all results and of most additions to
   one with a coefficient of a, and the places of the results, those within the degrees first; the second the numbers of
   steps, inputs and outputs, for each step its operation, the slot of the result and those of the arguments, and for
   inputs and outputs slots and places among the models, an array (rows, places, boxes). */
void sc_run(const whole *products, const whole *tape, double *models, double *scratch, whole places, whole boxes)
{
    const whole *steps = tape + 3, *inputs = steps + 4 * tape[0], *outputs = inputs + 2 * tape[1];
    whole terms = products[0], rows = terms + 1, size = rows * LANES;
    double *results = scratch, *slots = scratch + products[2] * LANES;
    for (whole first = 0; first < boxes; first += LANES) {
        whole lanes = boxes - first < LANES ? boxes - first : LANES;
        for (whole n = 0; n < tape[1]; ++n)
            for (whole k = 0; k < rows; ++k) {
                const double *from = models + (k * places + inputs[2 * n + 1]) * boxes + first;
                double *to = slots + inputs[2 * n] * size + k * LANES;
                EACH to[l] = l < lanes ? from[l] : 0.0;
            }
        for (whole n = 0; n < tape[0]; ++n) {
            const whole *step = steps + 4 * n;
            double *to = slots + step[1] * size, *a = slots + step[2] * size, *b = slots + step[3] * size;
            if (step[0] < 2)
                add(terms, step[0] ? -1.0 : 1.0, a, b, to);
            else
                multiply(products, a, b, results, to);
        }
        for (whole n = 0; n < tape[2]; ++n)
            for (whole k = 0; k < rows; ++k) {
                const double *from = slots + outputs[2 * n] * size + k * LANES;
                double *to = models + (k * places + outputs[2 * n + 1]) * boxes + first;
                for (whole l = 0; l < lanes; ++l) to[l] = from[l];
            }
    }
}
