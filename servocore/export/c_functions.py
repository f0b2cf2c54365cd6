"""CasADi functions as C source, the size of their working memory, their operations, and their tangents."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import cast

import casadi as ca

from servocore.numerics.machine_code import code_generator
from servocore.numerics.newton import MAX_ITERATIONS, QUICK_ITERATIONS


def c_source(name: str, functions: Iterable[ca.Function]) -> tuple[str, str]:
    """Return header and C source of functions, in files with this name."""
    generator = code_generator(name, functions, with_header=True, casadi_int="int")
    with tempfile.TemporaryDirectory(prefix="servocore_") as folder:
        generator.generate(f"{folder}/")
        header, source = (Path(folder, f"{name}.{ending}").read_text(encoding="utf-8") for ending in "hc")
    # Products of dense matrices run down columns, inlined with constant sizes: compilers vectorize these. Every number
    # is the same sum in the same order, so results are equal to the bit.
    return header, _QUIET + _PRODUCT.sub(_QUICK_PRODUCT, source)


_QUIET = """\
#ifdef __GNUC__ /* generated functions of one signature, and helpers, not all of which use or are used */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
#if defined(__cplusplus) || defined(_MSC_VER)
#define CASADI_RESTRICT __restrict
#else
#define CASADI_RESTRICT restrict
#endif

"""


_PRODUCT = re.compile(r"^void casadi_mtimes_dense\(.*?^}\n", re.MULTILINE | re.DOTALL)
_QUICK_PRODUCT = """\
static inline void casadi_mtimes_dense(const casadi_real* CASADI_RESTRICT x, casadi_int nrow_x, casadi_int ncol_x,
    const casadi_real* CASADI_RESTRICT y, casadi_int ncol_y, casadi_real* CASADI_RESTRICT z, casadi_int tr) {
  casadi_int i, j, k;
  if (tr) {
    for (i=0; i<ncol_y; ++i)
      for (j=0; j<ncol_x; ++j)
        for (k=0; k<nrow_x; ++k)
          z[j + i*ncol_x] += x[k + j*nrow_x] * y[k + i*nrow_x];
  } else {
    for (i=0; i<ncol_y; ++i)
      for (k=0; k<ncol_x; ++k)
        for (j=0; j<nrow_x; ++j)
          z[j + i*nrow_x] += x[j + k*nrow_x] * y[k + i*ncol_x];
  }
}
"""


def scratch_of(functions: Collection[ca.Function]) -> dict[str, int]:
    """Return the size of the working memory for any of some functions, by kind."""
    sizes = {"arguments": "sz_arg", "results": "sz_res", "integers": "sz_iw", "numbers": "sz_w"}
    return {kind: max(getattr(function, size)() for function in functions) for kind, size in sizes.items()}


def tangent(name: str, arguments: Sequence[ca.MX], results: Sequence[ca.MX], by: Sequence[ca.MX]) -> ca.Function:
    """Compile (arguments, directions of some of them) -> derivatives of the results along them."""
    x, directions = ca.veccat(*by), [ca.MX.sym(f"d{k}", *each.shape) for k, each in enumerate(by)]
    along = ca.veccat(*directions)
    found = [ca.densify(ca.jtimes(each, x, along)) if each.numel() else each for each in results]
    return ca.Function(name, [*arguments, *directions], found)


# Operations, iterations of Newton's method included: bounds for real-time hosts ---------------------------------------

_FREE = (ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER)


def operations(function: ca.Function, at_most: bool) -> int:
    """Return how many floating-point operations a call takes; an elementary function counts as one.

    Parameters
    ----------
    function : casadi.Function
        Of the kinds that exported models consist of.
    at_most : bool
        With all permitted iterations of Newton's method, and where functions branch with the longest way; otherwise
        with a single iteration, and no damped ones.
    """
    kind = function.class_name()
    if kind == "SXFunction":
        return sum(function.instruction_id(k) not in _FREE for k in range(function.n_instructions()))
    if kind == "MXFunction":
        return sum(_instruction(function, k, at_most) for k in range(function.n_instructions()))
    if kind == "FastNewton":
        step = function.get_function("jac_g_x")
        n, first = function.numel_out(0), "careful" not in function.name()
        times = (QUICK_ITERATIONS if first else MAX_ITERATIONS - QUICK_ITERATIONS) if at_most else 1
        return times * (operations(step, at_most) + _solved(n))
    if kind == "Switch":
        found = function.info()
        every = *cast("list[ca.Function]", found["f"]), cast("ca.Function", found["f_def"])
        ways = [each for each in every if not each.is_null()]
        return (max if at_most else min)(operations(each, at_most) for each in ways)
    return sum(function.nnz_out(k) for k in range(function.n_out()))  # copies


def _instruction(function: ca.Function, k: int, at_most: bool) -> int:
    number = function.instruction_id(k)
    if number in _FREE:
        return 0
    node = function.instruction_MX(k)
    if number == ca.OP_CALL:
        return operations(node.which_function(), at_most)
    if number == ca.OP_SOLVE:
        return _solved(node.numel())
    if number == ca.OP_MTIMES:
        return 2 * node.numel() * node.dep(1).size2()
    return node.nnz()


def _solved(n: int) -> int:
    """Return the operations of a QR factorization of n equations, and of a solution by it."""
    return 4 * n**3 // 3 + 3 * n**2
