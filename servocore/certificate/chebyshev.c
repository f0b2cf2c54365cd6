/* Sums, differences and products of Chebyshev models, LANES boxes side by side.

   A model is an array of rows, one per coefficient and one with the radius, of one number per box. Zeros in all lanes,
   as coefficients of what does not depend on a parameter or of a constant, are left out. The bounds are those of
   chebyshev.py. */

#include <stddef.h>
#include <stdint.h>

#define LANES 16
#define LINE 64 /* bytes: memory is faster where rows begin with a line of it */
#ifdef __AVX512F__
#define WIDE 8
#elif defined __AVX__
#define WIDE 4
#else
#define WIDE 2
#endif

/* All lanes of a row in WIDE-fold pieces, as registers are, written out: sums of rows stay there. */
#define EACH _Pragma("GCC unroll 8") for (int l = 0; l < LANES / WIDE; ++l)
#define EACH_LANE for (int l = 0; l < LANES; ++l)

typedef ptrdiff_t whole; /* as NumPy's intp */
typedef double piece __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));
typedef long long bits __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));

static const double UNIT = 2.3e-16, UP = 1.0 + 1e-14, TINY = 1e-290;

#define MAGNITUDE(x) ((piece)((bits)(x) & 0x7fffffffffffffffLL))

/* Rows of a model are `apart` numbers apart. */
#define ROW(a, k) ((const piece *)((a) + (k) * apart))

static void add(whole terms, whole apart, double sign, const double *a, const double *b, double *to)
{
    piece size[LANES / WIDE] = {{0.0}};
    const piece *r = ROW(a, terms), *s = ROW(b, terms);
    piece *radius = (piece *)ROW(to, terms);
    for (whole k = 0; k < terms; ++k) {
        const piece *x = ROW(a, k), *y = ROW(b, k);
        piece *z = (piece *)ROW(to, k);
        EACH {
            z[l] = x[l] + sign * y[l];
            size[l] += MAGNITUDE(z[l]);
        }
    }
    EACH radius[l] = (r[l] + s[l] + UNIT * size[l]) * UP;
}

static int used(const double *row)
{
    int any = 0;
    EACH_LANE any |= row[l] != 0.0;
    return any;
}

static whole used_terms(whole terms, whole apart, const double *a)
{
    while (terms && !used(a + (terms - 1) * apart)) --terms;
    return terms;
}

/* In time alone: c_k = sum over i of a_i (h_|k-i| + h_(k+i)), where h is b with all coefficients but the first halved;
   c_0 is half of that sum. */
static void multiply_in_time(whole terms, whole apart, const double *a, const double *b, piece *h, piece *results)
{
    whole m = used_terms(terms, apart, a), n = used_terms(terms, apart, b);
    for (whole j = 0; j < n; ++j)
        EACH h[j * LANES / WIDE + l] = (j ? 0.5 : 1.0) * ROW(b, j)[l];
    for (whole k = 0; k < 2 * terms - 1; ++k) {
        piece sum[LANES / WIDE] = {{0.0}};
        for (whole i = m < k + n ? m - 1 : k + n - 1; i >= 0 && i > k - n; --i) {
            const piece *x = ROW(a, i), *z = h + (k + i) * LANES / WIDE;
            const piece *y = h + (i < k ? k - i : i - k) * LANES / WIDE;
            if (k + i < n)
                EACH sum[l] += x[l] * (y[l] + z[l]);
            else
                EACH sum[l] += x[l] * y[l];
        }
        EACH results[k * LANES / WIDE + l] = (k ? 1.0 : 0.5) * sum[l];
    }
}

static void multiply_by_places(const whole *tape, whole apart, const double *a, const double *b,
                               double *restrict results)
{
    const whole terms = tape[0], targets = tape[1], full = tape[2], *table = tape + 4;
    double x[LANES], z[LANES], share = 1.0 / targets;
    whole rows[terms], count = 0;
    for (whole j = 0; j < terms; ++j)
        if (used(b + j * apart)) rows[count++] = j;
    for (whole k = 0; k < full * LANES; ++k) results[k] = 0.0;
    for (whole i = terms - 1; i >= 0; --i) {
        const double *left = a + i * apart;
        if (!used(left)) continue;
        EACH_LANE x[l] = share * left[l];
        for (whole n = 0; n < count; ++n) {
            const double *right = b + rows[n] * apart;
            const whole *place = table + (i * terms + rows[n]) * targets;
            EACH_LANE z[l] = x[l] * right[l];
            for (whole k = 0; k < targets; ++k) {
                double *at = results + place[k] * LANES;
                EACH_LANE at[l] += z[l];
            }
        }
    }
}

static void multiply(const whole *tape, whole apart, const double *a, const double *b, piece *results, double *to)
{
    const whole terms = tape[0], full = tape[2];
    const piece *r = ROW(a, terms), *s = ROW(b, terms);
    piece size_a[LANES / WIDE] = {{0.0}}, size_b[LANES / WIDE] = {{0.0}}, beyond[LANES / WIDE] = {{0.0}};
    piece off[LANES / WIDE] = {{0.0}}, *last = (piece *)ROW(to, terms);
    if (tape[1] == 2)
        multiply_in_time(terms, apart, a, b, results + full * LANES / WIDE, results);
    else
        multiply_by_places(tape, apart, a, b, (double *)results);
    for (whole k = 0; k < terms; ++k) {
        double rounded = (1.0 + tape[3] * (k + 1)) * UNIT / 2.0;
        piece *z = (piece *)ROW(to, k);
        EACH {
            z[l] = results[k * LANES / WIDE + l];
            size_a[l] += MAGNITUDE(ROW(a, k)[l]);
            size_b[l] += MAGNITUDE(ROW(b, k)[l]);
            off[l] += rounded * MAGNITUDE(ROW(a, k)[l]);
        }
    }
    for (whole k = terms; k < full; ++k)
        EACH beyond[l] += MAGNITUDE(results[k * LANES / WIDE + l]);
    EACH {
        piece crossed = size_a[l] * s[l] + size_b[l] * r[l] + r[l] * s[l];
        piece radius = (beyond[l] + off[l] * size_b[l] + crossed) * UP;
        bits some = (bits)(size_a[l] + r[l] > 0.0) & (bits)(size_b[l] + s[l] > 0.0);
        last[l] = radius + (piece)((bits)(TINY + (piece){0.0}) & some);
    }
}

/* The tape has the numbers of terms, of results of a pair of coefficients, of all results and of most additions to one
   with a coefficient of a, and the places of the results, those within the degrees first; there is room for all
   results, the coefficients of one model and a line of memory. A step is an operation, the place of its result and
   those of its arguments among the models, an array (places, rows, boxes). There are LANES boxes at least; some of the
   last are computed twice, as no step overwrites an argument. */
void sc_run(const whole *tape, const whole *steps, double *models, double *results, whole count, whole boxes)
{
    whole terms = tape[0], size = (terms + 1) * boxes;
    piece *line = (piece *)(((uintptr_t)results + LINE - 1) / LINE * LINE);
    for (whole next = 0; next < boxes; next += LANES) {
        double *from = models + (next + LANES < boxes ? next : boxes - LANES);
        for (const whole *step = steps; step < steps + 4 * count; step += 4) {
            double *to = from + step[1] * size, *a = from + step[2] * size, *b = from + step[3] * size;
            if (step[0] < 2)
                add(terms, boxes, step[0] ? -1.0 : 1.0, a, b, to);
            else
                multiply(tape, boxes, a, b, line, to);
        }
    }
}
