/* Sums, differences and products of Chebyshev models, LANES boxes side by side.

   A model is an array of rows, one per coefficient and one with the radius, of one number per box. Pairs with a
   coefficient that is zero in all lanes, as of what does not depend on a parameter, are left out. The bounds are those
   of chebyshev.py. */

#include <stddef.h>

#define LANES 16
#define EACH for (whole l = 0; l < LANES; ++l)

typedef ptrdiff_t whole; /* as NumPy's intp */

static const double UNIT = 2.3e-16, UP = 1.0 + 1e-14, TINY = 1e-290;

static double magnitude(double x) { return x < 0.0 ? -x : x; }

/* Rows of a model are `apart` numbers apart. */

static void norm(whole terms, whole apart, const double *a, double *restrict sum)
{
    EACH sum[l] = 0.0;
    for (whole k = 0; k < terms; ++k)
        EACH sum[l] += magnitude(a[k * apart + l]);
}

static void add(whole terms, whole apart, double sign, const double *a, const double *b, double *restrict to)
{
    double size[LANES];
    const double *r = a + terms * apart, *s = b + terms * apart;
    for (whole k = 0; k < terms * apart; k += apart)
        EACH to[k + l] = a[k + l] + sign * b[k + l];
    norm(terms, apart, to, size);
    EACH to[terms * apart + l] = (r[l] + s[l] + UNIT * size[l]) * UP;
}

static int used(const double *row)
{
    int any = 0;
    EACH any |= row[l] != 0.0;
    return any;
}

static void multiply(const whole *tape, whole apart, const double *a, const double *b, double *restrict results,
                     double *restrict to)
{
    double x[LANES], z[LANES], size_a[LANES], size_b[LANES], beyond[LANES], off[LANES] = {0.0};
    const whole terms = tape[0], targets = tape[1], full = tape[2], *table = tape + 4;
    const double *r = a + terms * apart, *s = b + terms * apart;
    double share = 1.0 / targets, added = tape[3];
    for (whole k = 0; k < full * LANES; ++k) results[k] = 0.0;
    for (whole i = terms - 1; i >= 0; --i) {
        const double *left = a + i * apart;
        if (!used(left)) continue;
        EACH x[l] = share * left[l];
        EACH off[l] += (1.0 + added * (i + 1)) * UNIT / 2.0 * magnitude(left[l]);
        for (whole j = 0; j < terms; ++j) {
            const double *right = b + j * apart;
            const whole *place = table + (i * terms + j) * targets;
            if (targets > 2 && !used(right)) continue;
            EACH z[l] = x[l] * right[l];
            for (whole k = 0; k < targets; ++k) {
                double *at = results + place[k] * LANES;
                EACH at[l] += z[l];
            }
        }
    }
    for (whole k = 0; k < terms; ++k)
        EACH to[k * apart + l] = results[k * LANES + l];
    norm(full - terms, LANES, results + terms * LANES, beyond);
    norm(terms, apart, a, size_a);
    norm(terms, apart, b, size_b);
    EACH {
        double crossed = size_a[l] * s[l] + size_b[l] * r[l] + r[l] * s[l];
        double radius = (beyond[l] + off[l] * size_b[l] + crossed) * UP;
        to[terms * apart + l] = radius + (radius > 0.0 ? TINY : 0.0);
    }
}

/* The tape has the numbers of terms, of results of a pair of coefficients, of all results and of most additions to one
   with a coefficient of a, and the places of the results, those within the degrees first. A step is an operation, the
   place of its result and those of its arguments among the models, an array (places, rows, boxes). There are LANES boxes
   at least; some of the last are computed twice, as no step overwrites an argument. */
void sc_run(const whole *tape, const whole *steps, double *models, double *results, whole count, whole boxes)
{
    whole terms = tape[0], size = (terms + 1) * boxes;
    for (whole next = 0; next < boxes; next += LANES) {
        double *from = models + (next + LANES < boxes ? next : boxes - LANES);
        for (const whole *step = steps; step < steps + 4 * count; step += 4) {
            double *to = from + step[1] * size, *a = from + step[2] * size, *b = from + step[3] * size;
            if (step[0] < 2)
                add(terms, boxes, step[0] ? -1.0 : 1.0, a, b, to);
            else
                multiply(tape, boxes, a, b, results, to);
        }
    }
}
