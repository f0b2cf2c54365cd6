"""A scene as a `FlatSystem` of python-control, for its planners and its design methods.

python-control needs two maps between state and inputs, (x, u), and the flat flag, the outputs with their
derivatives. The reverse map is the exact inversion. The forward map differentiates the outputs along the plant,
y' = L_f y, with inputs that stay, as at the ends of a manoeuvre.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from servocore.errors import IntegrationFailed, InvalidModel, InvalidSetting, extra
from servocore.model.scene import Scene, require_scene
from servocore.numerics.compiled_calls import Array, Call
from servocore.numerics.memoization import made_once
from servocore.problem import Problem, ResolvedSystem
from servocore.stepping.forward_dynamics import forward_rate
from servocore.structure.inversion import inversion

Parameters = Mapping[str, float] | None


def to_control(scene: Scene, model: str | None = None) -> Any:
    """Return a scene as a flat system of python-control.

    Its states are the coordinates and then their velocities, its inputs those of the scene, its outputs the flat
    outputs, its parameters those of the scene; all by name and in SI units. Thus `control.flatsys.point_to_point` and
    `control.flatsys.solve_flat_ocp` plan for it, and `control.linearize`, `control.lqr` and
    `control.input_output_response` take it as the nonlinear system that it is.

    Parameters
    ----------
    scene : Scene
        Without internal dynamics; its path does not matter.
    model : str, optional
        Model of the scene. When not given, the first one whose coordinates are independent, if there is one.

    Returns
    -------
    control.flatsys.FlatSystem
        ``reverse`` returns state and inputs for a flag on the branch of the model's guess, angles in the range that the
        guess has; it raises `IntegrationFailed` where there is no answer. ``forward`` takes the inputs as constant.

    Raises
    ------
    InvalidModel
        If the scene has internal dynamics or depends on time, or holonomic constraints are redundant.
    InvalidSetting
        If python-control is not installed.

    Examples
    --------
    >>> import control
    >>> import servocore as sc
    >>> crane = sc.to_control(sc.scenes.rotary_crane())
    >>> start, end = (crane.reverse([[x, 0, 0, 0, 0] for x in r]) for r in ((5, 0, -5), (-2, 2, -2)))
    >>> plan = control.flatsys.point_to_point(crane, [0, 20], *start, *end, basis=control.flatsys.PolyFamily(10))
    >>> states, inputs = plan.eval([0.0, 10.0, 20.0])
    >>> inputs.shape
    (3, 3)
    """
    flatsys = extra("control.flatsys")
    require_scene(scene, "to_control")
    problem = Problem.of(scene, model or scene.independent_model)
    if not problem.flat:
        raise InvalidModel(f"{scene.name} has internal dynamics: its state does not follow from the outputs")
    if problem.system.time.numel():
        raise InvalidModel(f"{scene.name} depends on time: python-control's flat systems do not")
    problem.system.require_independent_constraints()
    quantities, system = problem.system.coordinates.quantities, problem.system
    return flatsys.FlatSystem(
        *_maps(problem),
        name=scene.name,
        inputs=[quantity.name for quantity in system.inputs],
        outputs=[quantity.name for quantity in system.outputs],
        states=[f"{quantity.name}{suffix}" for suffix in ("", "_dot") for quantity in quantities],
        params=dict(zip(system.parameters.names, problem.p.tolist(), strict=True)),
    )


def _maps(problem: Problem) -> tuple[Callable[..., Any], ...]:
    """Return the maps of python-control's `FlatSystem`: forward, reverse, derivative of the state (q, v), outputs."""
    functions = _flag(problem.resolved), _flow(problem.resolved), inversion(problem.array).function
    flag_of, flow, inverse = map(Call, functions)
    order, states, places = problem.array.reference_order, 2 * len(problem.system.coordinates), motion_places(problem)

    def given(params: Parameters) -> Array:
        names, p = problem.system.parameters.names, problem.p
        return np.array([params.get(name, p[k]) for k, name in enumerate(names)], dtype=float) if params else p

    def forward(x: npt.ArrayLike, u: npt.ArrayLike, params: Parameters = None) -> list[Array]:
        """Return each output with its derivatives, for a state and inputs that stay."""
        (flag,) = flag_of(*_vectors(x, u), given(params))
        return [row.copy() for row in flag]

    def reverse(zflag: Sequence[npt.ArrayLike], params: Parameters = None) -> tuple[Array, Array]:
        """Return state and inputs for each output with its derivatives."""
        gamma = np.array([np.asarray(flag_of_output, dtype=float) for flag_of_output in zflag])
        if gamma.ndim != 2 or gamma.shape[1] <= order:
            raise InvalidSetting(f"a flag has derivatives up to order {order} of each output")
        unknowns, _, residual = inverse(gamma[:, : order + 1], given(params))
        if not np.isfinite(residual).all() or not np.isfinite(unknowns).all():
            raise IntegrationFailed(f"no state belongs to the outputs {gamma[:, 0].tolist()} and their derivatives")
        chosen = unknowns[places]
        return chosen[:states], chosen[states:]

    def rate(_: float, x: npt.ArrayLike, u: npt.ArrayLike, params: Parameters = None) -> Array:
        return flow(*_vectors(x, u), given(params))[0]

    def outputs(_: float, x: npt.ArrayLike, u: npt.ArrayLike, params: Parameters = None) -> Array:
        return flow(*_vectors(x, u), given(params))[1]

    return forward, reverse, rate, outputs


def _vectors(x: npt.ArrayLike, u: npt.ArrayLike) -> tuple[Array, Array]:
    return np.ravel(np.asarray(x, dtype=float)), np.ravel(np.asarray(u, dtype=float))


def motion_places(problem: Problem) -> list[int]:
    """Return the places of q, v and u among the unknowns of the derivative array."""
    system, n = problem.system, len(problem.system.coordinates)
    motion = [(j, order) for order in (0, 1) for j in range(n)]
    return problem.array.places([*motion, *((n + system.lam.numel() + k, 0) for k in range(len(system.inputs)))])


def free_motion(resolved: ResolvedSystem) -> tuple[ca.MX, ca.MX, ca.MX, ca.MX, ca.Function]:
    """Return symbols of x, u and p, the derivative of the state, and the outputs as a function of (x, p)."""
    system = resolved.system
    n, m = len(system.coordinates), len(system.inputs)
    x, u, p = ca.MX.sym("x", 2 * n), ca.MX.sym("u", m), ca.MX.sym("p", system.p.numel())
    x_dot = forward_rate(system, held=False)(x, u, ca.DM.zeros(len(system.outputs)), p)[0]
    return x, u, p, x_dot, ca.Function("sc_outputs", [ca.vertcat(system.q, system.v), system.p], [system.output])


@made_once
def _flow(resolved: ResolvedSystem) -> ca.Function:
    x, u, p, x_dot, outputs = free_motion(resolved)
    return ca.Function("sc_flow", [x, u, p], [ca.densify(x_dot), ca.densify(outputs(x, p))])


@made_once
def _flag(resolved: ResolvedSystem) -> ca.Function:
    """Compile (x, u, p) -> the outputs and their derivatives along the plant with constant inputs."""
    x, u, p, x_dot, outputs = free_motion(resolved)
    flag: list[ca.MX] = [outputs(x, p)]
    for _ in range(resolved.array.reference_order):
        flag.append(ca.jtimes(flag[-1], x, x_dot))
    return ca.Function("sc_flag", [x, u, p], [ca.densify(ca.horzcat(*flag))])
