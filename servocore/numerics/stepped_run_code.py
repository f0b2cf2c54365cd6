"""C source of the runs in `stepped_runs`: all steps, instants and cases in one call.

    int sc_run(const long *sizes, const double *const *in, const double *t, const double *path, long row, long lane,
               long count, double *out)

`sizes` are the numbers of cases and steps, the stride of the rows of the path at the steps, and the strides of cases in
the arrays of `in`: start, path at the steps, numbers of the path, [h; p]. A fifth array holds first and last time. `t`
holds `count` instants, eight or more, and entry i of the path at instant k of case c is at c*lane + i*row + k. Result i
of instant k of case c is written to (c*columns + i)*count + k of `out`. The return value is 0 or an error code.
"""

from __future__ import annotations

import casadi as ca

from servocore.numerics.just_in_time import NAME
from servocore.numerics.machine_code import code_generator
from servocore.numerics.vector_code import HEAD, vector_part

NODES = 4
"""Steps whose values and rates belong to one polynomial."""
SOUND, OUTSIDE, UNSOUND, NO_MEMORY = range(4)
"""Return values: success; a time outside the run; a value that is not finite or of the wrong sign; no memory."""


def run_source(step: ca.Function, weights: ca.Function, read: ca.Function, positive: range) -> str:
    """Return the source; raises `NoCounterpart` if an operation has none.

    Parameters
    ----------
    step : casadi.Function
        (states, path, numbers, [h; p]) -> (states after a step, rates before it).
    weights : casadi.Function
        (time, [begin; h; last]) -> the first of four steps, and weights of their values and of their rates times h.
    read : casadi.Function
        (states, path, numbers, p) -> results.
    positive : range
        Indices of the results that must be positive.
    """
    weigh = vector_part("sc_weigh", weights, (True, False))
    reading = vector_part("sc_read", read, (True, True, False, False))
    signs = ", ".join(str(int(k in positive)) for k in range(read.numel_out(0)))
    defined = {"STEP": step.name(), "STATES": step.numel_in(0), "PATH": step.numel_in(1), "COLUMNS": read.numel_out(0),
               "SIGNS": signs, "OUTSIDE": OUTSIDE, "UNSOUND": UNSOUND, "NO_MEMORY": NO_MEMORY}  # fmt: skip
    names = "".join(f"#define {name} {value}\n" for name, value in defined.items())
    return code_generator("step", [step]).dump() + HEAD + weigh + reading + names + _DRIVER


_DRIVER = f"""#include <stdlib.h>
static int any(bits found) {{
 long long sum = 0;
 for (int i = 0; i < LANES; ++i) sum |= found[i];
 return sum != 0;
}}
static int outside(const double *t, long count, double begin, double end) {{
 bits found = {{0}};
 for (long next = 0; next < count; next += LANES) {{
  const vec x = load(t + (next + LANES <= count ? next : count - LANES));
  found |= ~((bits)(x >= begin) & (bits)(x <= end));
 }}
 return any(found);
}}
static int unsound(const double *values, long count, int positive) {{
 bits found = {{0}};
 for (long next = 0; next < count; next += LANES) {{
  const vec x = load(values + (next + LANES <= count ? next : count - LANES));
  found |= (bits)(x - x != 0.0);
  if (positive) found |= ~(bits)(x > 0.0);
 }}
 return any(found);
}}
static void between(const double *values, long apart, const double *first, long count, double *x) {{
 const double *w = first + count;
 for (long i = 0; i < STATES; ++i, values += apart, x += count)
  for (long k = 0; k < count; ++k) {{
   const double *v = values + (long)first[k], *r = v + STATES*apart;
   const double a = v[0]*w[k] + r[0]*w[4*count + k], b = v[1]*w[count + k] + r[1]*w[5*count + k];
   const double c = v[2]*w[2*count + k] + r[2]*w[6*count + k], d = v[3]*w[3*count + k] + r[3]*w[7*count + k];
   x[k] = (a + c) + (b + d);
  }}
}}
int {NAME}(const long *sizes, const double *const *in, const double *t, const double *path, long row, long lane,
           long count, double *out) {{
 static const int signs[] = {{SIGNS}};
 const long last = sizes[1], apart = last + 2, none[4] = {{0}};
 const double begin = in[4][0], h = in[3][0];
 if (outside(t, count, begin, in[4][1])) return OUTSIDE;
 double *values = malloc(sizeof(double)*(2*STATES*apart + ({1 + 2 * NODES} + STATES)*count));
 if (!values) return NO_MEMORY;
 double *rates = values + STATES*apart, *first = rates + STATES*apart, *x = first + {1 + 2 * NODES}*count;
 sc_weigh(1, count, (const double *const[]){{t, (const double[]){{begin, h, (double)(last + 1 - {NODES})}}}},
          (const long[]){{count, 0}}, none, (double *const[]){{first}}, count);
 int wrong = 0;
 for (long c = 0; c < sizes[0]; ++c, out += COLUMNS*count) {{
  const double *start = in[0] + c*sizes[3], *numbers = in[2] + c*sizes[5], *settings = in[3] + c*sizes[6];
  double now[STATES], next[STATES], rate[STATES], column[PATH];
  for (long i = 0; i < STATES; ++i) values[i*apart] = now[i] = start[i];
  for (long k = 0; k <= last; ++k) {{
   for (long i = 0; i < PATH; ++i) column[i] = in[1][c*sizes[4] + i*sizes[2] + k];
   STEP((const double *[]){{now, column, numbers, settings}}, (double *[]){{next, rate}}, 0, 0, 0);
   for (long i = 0; i < STATES; ++i) {{
    now[i] = values[i*apart + k + 1] = next[i];
    rates[i*apart + k] = rate[i]*h;
   }}
  }}
  between(values, apart, first, count, x);
  sc_read(1, count, (const double *const[]){{x, path + c*lane, numbers, settings + 1}},
          (const long[]){{count, row, 0, 0}}, none, (double *const[]){{out}}, count);
  for (long i = 0; i < COLUMNS; ++i) wrong |= unsound(out + i*count, count, signs[i]);
 }}
 free(values);
 return wrong ? UNSOUND : 0;
}}
"""
