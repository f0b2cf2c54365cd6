/* The path between communication points: Taylor's and Hermite's polynomials.

   A path is an array of COMPONENTS positions, then as many velocities, accelerations and so on, ORDERS in all. */

#ifndef PATH_H
#define PATH_H

#include <stdint.h>
#include <string.h>

/* Continue a path by its Taylor polynomial, tau seconds ahead. */
static void continued(const double *path, double tau, double *found)
{
    for (size_t c = 0; c < COMPONENTS; c++)
        for (size_t k = 0; k < ORDERS; k++) {
            double value = path[(ORDERS - 1) * COMPONENTS + c];
            for (size_t j = ORDERS - 1; j-- > k;)
                value = path[j * COMPONENTS + c] + tau / (double)(j - k + 1) * value;
            found[k * COMPONENTS + c] = value;
        }
}

#if N_STATE > 0 || N_ROUTES > 0
/* Join two instants h apart by the polynomial that has the path and its derivatives at both, and evaluate it at a
   fraction of h. */
static void joined(const double *first, const double *last, double h, double fraction, double *found)
{
    double coefficient[2 * ORDERS], missing[ORDERS];
    for (size_t c = 0; c < COMPONENTS; c++) {
        double scale = 1.0;
        for (size_t k = 0; k < ORDERS; k++) {
            coefficient[k] = first[k * COMPONENTS + c] * scale; /* h^k / k! times the derivative */
            scale *= h / (double)(k + 1);
        }
        scale = 1.0;
        for (size_t k = 0; k < ORDERS; k++) {
            missing[k] = (last[k * COMPONENTS + c] - first[k * COMPONENTS + c]) * scale;
            scale *= h;
            for (size_t j = k + 1; j < ORDERS; j++) {
                double falling = 1.0;
                for (size_t i = 0; i < k; i++) falling *= (double)(j - i);
                missing[k] -= falling * coefficient[j];
            }
        }
        for (size_t j = 0; j < ORDERS; j++) {
            coefficient[ORDERS + j] = 0.0;
            for (size_t k = 0; k < ORDERS; k++)
                coefficient[ORDERS + j] += END_CONDITIONS[j * ORDERS + k] * missing[k];
        }
        scale = 1.0;
        for (size_t k = 0; k < ORDERS; k++) {
            double value = 0.0;
            for (size_t j = 2 * ORDERS; j-- > k;) {
                double falling = 1.0;
                for (size_t i = 0; i < k; i++) falling *= (double)(j - i);
                value = value * fraction + falling * coefficient[j];
            }
            found[k * COMPONENTS + c] = value / scale;
            scale *= h;
        }
    }
}

/* Evaluate the path of a whole step h at a fraction of it: beyond the given instant, or between the last one and it. */
static void path_within(int64_t input_time, const double *first, const double *given, double h, double fraction,
                        double *found)
{
    if (input_time == AT_START)
        continued(given, fraction * h, found);
    else if (fraction == 1.0)
        memcpy(found, given, N_PATH * sizeof *found);
    else
        joined(first, given, h, fraction, found);
}
#endif

#endif
